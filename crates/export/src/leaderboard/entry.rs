//! The entry of a run in a leaderboard.

use std::collections::BTreeMap;

use anyhow::{Context, Result, bail, ensure};
use results::conditions::{Condition, PolicyKind};
use results::date::date;
use results::log::RunLog;
use results::policy::{PolicyLabel, PolicyRole};
use results::score::{ConditionScore, Estimate, Interval, Spread, StreamScore, score};
use results::settings::FREE_KEYS;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The figures that lie between 0 and a largest value, with that value.
const LIMITS: [(&str, f64); 7] = [
    ("sr", 100.0),
    ("follow", 100.0),
    ("recovery", 100.0),
    ("success", 100.0),
    ("acc", 100.0),
    ("spl", 1.0),
    ("t_ndtw", 1.0),
];

/// Changes when programs that read the old entries cannot read the new ones.
const FORMAT: u32 = 1;

/// What a comparison needs to know about a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The format of the entry.
    #[serde(rename = "memtransfer_leaderboard")]
    pub format: u32,
    /// The name of the run.
    pub run: String,
    /// When it began: UTC date and time.
    pub date: Option<String>,
    /// What ran.
    pub policy: EntryPolicy,
    /// What must agree in runs that are compared.
    pub protocol: BTreeMap<String, Value>,
    /// The commit of the program.
    pub commit: Option<String>,
    /// The version of the wire.
    pub wire_version: u32,
    /// The settings that can change a result.
    pub settings: BTreeMap<String, Value>,
    /// BLAKE3 hashes of what the run depended on, and of its records (`episodes`).
    pub hashes: BTreeMap<String, String>,
    /// SHA-256 of the documents that memory supplied, by name.
    pub documents: BTreeMap<String, String>,
    /// The versions of external memories, by name.
    pub memories: BTreeMap<String, String>,
    /// Episodes of the whole run.
    pub planned: usize,
    /// Those that finished.
    pub finished: usize,
    /// Those that were given up because of a fault that is not the policy's.
    pub given_up: usize,
    /// The scores, one for each condition.
    pub scores: Vec<Score>,
}

/// A policy.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EntryPolicy {
    /// Its kind, with the name of a model or of an external policy.
    pub name: String,
    /// Whether it is a scripted stand-in for a model.
    pub stand_in: bool,
    /// What its figures stand for; absent for a model, and in entries of earlier versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    role: Option<PolicyRole>,
}

impl EntryPolicy {
    fn new(PolicyLabel { name, role }: PolicyLabel) -> Self {
        Self { name, stand_in: role == Some(PolicyRole::StandIn), role }
    }

    /// The policy as every output names it.
    pub fn label(&self) -> PolicyLabel {
        let bound = match self.name.parse() {
            Ok(PolicyKind::Random) => Some(PolicyRole::LowerBound),
            Ok(PolicyKind::Expert) => Some(PolicyRole::UpperBound),
            Ok(PolicyKind::Grounded | PolicyKind::Openai | PolicyKind::External) | Err(_) => None,
        };
        let stand_in = self.stand_in.then_some(PolicyRole::StandIn);
        PolicyLabel { name: self.name.clone(), role: self.role.or(stand_in).or(bound) }
    }
}

/// The figures of one condition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// The condition: `episodic/new/unchanged/original`.
    pub condition: String,
    /// Episodes, or sequences of streams, that the figures are of.
    pub count: usize,
    /// As many as the whole run has.
    pub planned: usize,
    /// The figures, by name; one that was not measured is absent.
    pub figures: BTreeMap<String, EntryFigure>,
}

/// A figure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EntryFigure {
    /// Its mean.
    pub mean: f64,
    /// The sample standard deviation over repetitions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std: Option<f64>,
    /// The lower end of the 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low: Option<f64>,
    /// The upper end of the 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high: Option<f64>,
}

impl EntryFigure {
    fn new(mean: f64, std: Option<f64>, interval: Option<Interval>) -> Self {
        let (low, high) = interval.map(|interval| (interval.low, interval.high)).unzip();
        Self { mean, std, low, high }
    }
}

impl From<Spread> for EntryFigure {
    fn from(spread: Spread) -> Self {
        Self::new(spread.mean, spread.std, spread.interval)
    }
}

impl From<Estimate> for EntryFigure {
    fn from(estimate: Estimate) -> Self {
        Self::new(estimate.mean, None, estimate.interval)
    }
}

impl Entry {
    /// The entry of the run `log`.
    ///
    /// # Errors
    /// When it is a unit of a plan, whose figures are those of a few of the run's episodes.
    pub fn of(log: &RunLog) -> Result<Self> {
        let manifest = &log.manifest;
        if let Some(unit) = &manifest.unit {
            bail!(
                "{} is unit {} of a plan, a part of a run: use what `memtransfer merge` makes of all units",
                log.dir.display(),
                unit.number
            );
        }
        let scores = score(log);
        let streams = scores.streams.iter().flat_map(|streams| &streams.conditions);
        let mut hashes = manifest.hashes.clone();
        let mut hasher = blake3::Hasher::new();
        for record in &log.episodes {
            hasher.update(&serde_json::to_vec(record)?).update(b"\n");
        }
        hashes.insert("episodes".to_owned(), hasher.finalize().to_hex().to_string());
        let Value::Object(settings) = serde_json::to_value(&manifest.settings)? else {
            bail!("settings that are no table; this is a mistake in the program, please report it");
        };
        let changes_results = |(key, _): &(String, Value)| !FREE_KEYS.contains(&key.as_str());
        let settings = settings.into_iter().filter(changes_results).collect();
        let documents = manifest.documents.iter();
        let memories = manifest.memories.iter();
        Ok(Self {
            format: FORMAT,
            run: log.name.clone(),
            date: log.began_unix_s().map(date),
            policy: EntryPolicy::new(manifest.policy_label()),
            protocol: manifest.protocol(),
            commit: manifest.commit.clone(),
            wire_version: manifest.wire_version,
            settings,
            hashes,
            documents: documents.map(|(name, one)| (name.clone(), one.sha256.clone())).collect(),
            memories: memories.map(|(name, one)| (name.to_string(), one.version.clone())).collect(),
            planned: scores.planned,
            finished: scores.finished,
            given_up: scores.errored,
            scores: scores
                .conditions
                .iter()
                .map(of_condition)
                .chain(streams.map(of_stream))
                .collect(),
        })
    }

    /// Reads an entry.
    ///
    /// # Errors
    /// When the text is none, one of another format, or has figures that no run can have.
    pub fn parse(text: &str) -> Result<Self> {
        let value: Value = serde_json::from_str(text).context("no JSON")?;
        match value.get("memtransfer_leaderboard").and_then(Value::as_u64) {
            Some(format) if format == u64::from(FORMAT) => {}
            Some(format) => bail!("format {format}, this program reads {FORMAT}"),
            None => bail!(
                "no entry of a leaderboard; `memtransfer export RUN --format leaderboard` writes one"
            ),
        }
        let entry: Self =
            serde_json::from_value(value).context("a damaged entry of a leaderboard")?;
        entry.check().context("a wrong entry of a leaderboard")?;
        Ok(entry)
    }

    fn check(&self) -> Result<()> {
        let Self { planned, finished, scores, .. } = self;
        ensure!(finished <= planned, "{finished} episodes finished of {planned}");
        for Score { condition, count, planned, figures } in scores {
            ensure!(count <= planned, "{condition}: {count} of {planned}");
            for (name, &EntryFigure { mean, low, high, .. }) in figures {
                let limit = LIMITS.iter().find(|(limited, _)| limited == name);
                let is_possible = |value: f64| {
                    limit.is_none_or(|(_, most)| (-1e-9..=most + 1e-9).contains(&value))
                };
                ensure!(
                    [Some(mean), low, high].into_iter().flatten().all(is_possible),
                    "{condition}: {name} is {mean}, which no run can have"
                );
            }
        }
        Ok(())
    }

    /// The name of the suite.
    pub fn suite(&self) -> &str {
        self.protocol.get("suite").and_then(Value::as_str).unwrap_or("unknown")
    }

    /// Whether both are entries of the same run in the same state.
    pub fn is_of_same_run(&self, other: &Self) -> bool {
        let facts =
            |entry: &Self| (entry.run.clone(), entry.hashes.clone(), entry.settings.clone());
        facts(self) == facts(other)
    }

    /// Whether episodes are missing.
    pub fn is_incomplete(&self) -> bool {
        self.finished < self.planned
    }
}

fn figures<const N: usize>(of: [(&str, Option<EntryFigure>); N]) -> BTreeMap<String, EntryFigure> {
    of.into_iter().filter_map(|(name, figure)| Some((name.to_owned(), figure?))).collect()
}

fn of_condition(score: &ConditionScore) -> Score {
    let spread = |spread: Option<Spread>| spread.map(EntryFigure::from);
    Score {
        condition: score.condition.to_string(),
        count: score.episodes,
        planned: score.planned,
        figures: figures([
            ("sr", spread(Some(score.sr))),
            ("spl", spread(Some(score.spl))),
            ("follow", spread(score.blocked.and_then(|blocked| blocked.follow))),
            ("recovery", spread(score.blocked.and_then(|blocked| blocked.recovery))),
            ("steps", score.mean_steps.map(|mean| EntryFigure::new(mean, None, None))),
            ("images_per_request", spread(score.images_per_request)),
            ("tokens_per_100", spread(score.tokens_per_100)),
        ]),
    }
}

fn of_stream(score: &StreamScore) -> Score {
    let estimate = |estimate: Option<Estimate>| estimate.map(EntryFigure::from);
    Score {
        condition: score.condition.to_string(),
        count: score.sequences,
        planned: score.planned,
        figures: figures([
            ("success", estimate(score.success)),
            ("acc", estimate(score.average)),
            ("bwt", estimate(score.backward)),
            ("fwt", estimate(score.forward)),
            ("forgetting", estimate(score.forgetting)),
            ("t_ndtw", estimate(score.t_ndtw)),
        ]),
    }
}

impl Score {
    /// Its condition, if this program knows it.
    pub fn condition(&self) -> Option<Condition> {
        Condition::logged(&self.condition).ok()
    }
}

#[cfg(test)]
mod tests {
    use results::log::UnitId;
    use results::log::testing::{log, record, stream_log, stream_record};

    use super::*;

    #[test]
    fn an_entry_is_read_as_it_is_written_and_depends_on_every_record() {
        let one = Entry::of(&log(vec![record("t01-01", true), record("t01-02", false)])).unwrap();
        let text = serde_json::to_string(&one).unwrap();
        assert!(Entry::parse(&text).unwrap().is_of_same_run(&one));
        assert!(!one.settings.contains_key("out") && one.settings.contains_key("horizon"));
        assert_eq!(one.scores[0].figures["sr"].mean, 50.0);
        assert!(one.scores[0].figures["sr"].low.is_some() && !one.is_incomplete());
        assert_eq!(one.suite(), "quick");
        let mut unit = log(vec![record("t01-01", true)]);
        unit.manifest.unit = Some(UnitId { plan: String::new(), number: 3 });
        assert!(Entry::of(&unit).unwrap_err().to_string().contains("is unit 3 of a plan"));
        let other = Entry::of(&log(vec![record("t01-01", true), record("t01-02", true)])).unwrap();
        assert!(!other.is_of_same_run(&one));
        let newer = text.replace("\"memtransfer_leaderboard\":1", "\"memtransfer_leaderboard\":2");
        assert!(Entry::parse(&newer).unwrap_err().to_string().contains("format 2"));
        assert!(Entry::parse("[]").is_err() && Entry::parse("no").is_err());
        for (from, to, said) in [
            ("\"mean\":50.0", "\"mean\":250.0", "sr is 250, which no run can have"),
            ("\"finished\":2", "\"finished\":20", "20 episodes finished of 2"),
            ("\"count\":2", "\"count\":2000", "2000 of"),
        ] {
            let changed = text.replacen(from, to, 1);
            assert_ne!(changed, text, "{from}");
            let error = format!("{:#}", Entry::parse(&changed).unwrap_err());
            assert!(error.contains("a wrong entry") && error.contains(said), "{error}");
        }
    }

    #[test]
    fn entries_of_earlier_versions_name_what_is_no_model() {
        for (policy, label) in [
            (r#"{"name":"grounded","stand_in":true}"#, "grounded, scripted stand-in"),
            (r#"{"name":"external (mine)","stand_in":true}"#, "external (mine), scripted stand-in"),
            (r#"{"name":"random","stand_in":false}"#, "random, lower bound"),
            (r#"{"name":"expert","stand_in":false}"#, "expert, upper bound"),
            (r#"{"name":"openai (m)","stand_in":false}"#, "openai (m)"),
        ] {
            let policy: EntryPolicy = serde_json::from_str(policy).unwrap();
            assert_eq!(policy.label().to_string(), label);
            assert_eq!(EntryPolicy::new(policy.label()).label(), policy.label());
        }
    }

    #[test]
    fn streams_have_figures_of_their_own() {
        let entry = Entry::of(&stream_log(vec![stream_record("a", true)], [2, 1, 2])).unwrap();
        assert!(entry.scores.iter().all(|score| !score.figures.contains_key("sr")));
    }
}
