//! Which episodes a run consists of: conditions x runs x cases, each with a stable key and its own seed.
//!
//! Pure: the same settings and cases give the same list on every machine. Which of them are finished is in the
//! run folder ([`results::log`]).

use results::conditions::Condition;
use results::key::EpisodeKey;

/// One episode of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlannedEpisode {
    /// Names it in the log: unique in a run.
    pub key: EpisodeKey,
    /// Index of its case in the case file.
    pub case_index: usize,
    /// The seed for random choices of the policy.
    pub seed: u64,
}

/// The episodes of a run, in the order in which they are started.
///
/// Run by run, case by case, the conditions of a case next to each other: so any beginning of the list
/// is a fair sample of the whole (a running success rate and the time left mean something), and the
/// views of a case are used while they are resident.
///
/// Each condition comes with the number of its runs. `cases` are indices into `ids`, the ids of all cases.
pub fn plan(
    conditions: &[(Condition, u32)],
    cases: &[usize],
    ids: &[&str],
    master_seed: u64,
) -> Vec<PlannedEpisode> {
    let most_runs = conditions.iter().map(|(_, runs)| *runs).max().unwrap_or(0);
    let mut episodes = Vec::new();
    for run in 1..=most_runs {
        for &case_index in cases {
            for &(condition, _) in conditions.iter().filter(|(_, runs)| run <= *runs) {
                let case = ids[case_index].to_owned();
                let key = EpisodeKey { condition, run, place: None, case };
                let seed = seed_of(master_seed, &key);
                episodes.push(PlannedEpisode { key, case_index, seed });
            }
        }
    }
    episodes
}

/// The seed of an episode: the first 8 bytes, as a little-endian number, of the BLAKE3 hash of
/// `memtransfer episode seed v1`, a zero byte, the master seed as 8 little-endian bytes, and the key as it
/// is written.
///
/// It depends on nothing but these, so neither the number of lanes nor which other episodes are run
/// changes what an episode draws.
pub fn seed_of(master_seed: u64, key: &EpisodeKey) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"memtransfer episode seed v1\0");
    hasher.update(&master_seed.to_le_bytes());
    hasher.update(key.to_string().as_bytes());
    let hash = hasher.finalize();
    let first = hash.as_bytes().first_chunk::<8>();
    first.copied().map_or(0, u64::from_le_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn conditions() -> Vec<(Condition, u32)> {
        let written = [
            ("working/original/unchanged/none", 2),
            ("working/new/unchanged/none", 2),
            ("episodic/original/unchanged/original", 2),
            ("episodic/new/unchanged/original", 1),
        ];
        written.map(|(condition, runs)| (condition.parse().unwrap(), runs)).to_vec()
    }

    #[test]
    fn a_plan_goes_case_by_case_through_the_conditions() {
        let episodes = plan(&conditions(), &[0, 2], &["a", "b", "c"], 1);
        let keys: Vec<String> = episodes.iter().map(|e| e.key.to_string()).collect();
        insta::assert_snapshot!(keys[..5].join("\n"), @"
        working/original/unchanged/none/run1/a
        working/new/unchanged/none/run1/a
        episodic/original/unchanged/original/run1/a
        episodic/new/unchanged/original/run1/a
        working/original/unchanged/none/run1/c
        ");
        assert_eq!((keys.len(), keys.iter().filter(|key| key.contains("/run2/")).count()), (14, 6));
        let (mut unique, mut seeds) = (keys, episodes.iter().map(|e| e.seed).collect::<Vec<_>>());
        unique.sort();
        unique.dedup();
        seeds.sort();
        seeds.dedup();
        assert_eq!((unique.len(), seeds.len()), (14, 14));
    }

    #[test]
    fn seeds_follow_the_documented_formula() {
        let key = plan(&conditions(), &[0], &["t01-01"], 1).remove(0).key;
        let mut text = b"memtransfer episode seed v1\0".to_vec();
        text.extend(7_u64.to_le_bytes());
        text.extend(b"working/original/unchanged/none/run1/t01-01");
        let hash = blake3::hash(&text);
        assert_eq!(seed_of(7, &key).to_le_bytes(), hash.as_bytes()[..8]);
        insta::assert_snapshot!(seed_of(7, &key), @"7419264810186364379");
    }
}
