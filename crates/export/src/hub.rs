//! Results as Hugging Face's Hub reads them from a model's repository: `.eval_results/*.yaml`
//! (<https://huggingface.co/docs/hub/eval-results>).

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Result, bail};
use conditions::{Condition, Frames};
use run_log::RunLog;
use run_log::date::date;
use run_log::memory_label::author_words;
use scores::{ConditionScore, Interval, Scores, StreamScore, score};

use crate::files::{is_file, write_text};

/// The id of the benchmark's data set on the Hub: `ORGANISATION/NAME`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HubDataset(String);

impl FromStr for HubDataset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let is_name = |name: &str| {
            !name.is_empty()
                && name.chars().all(|one| one.is_ascii_alphanumeric() || "-_.".contains(one))
        };
        match text.split_once('/') {
            Some((organisation, name)) if is_name(organisation) && is_name(name) => {
                Ok(Self(text.to_owned()))
            }
            _ => Err("expected the id of a data set, for example my-team/memtransfer".to_owned()),
        }
    }
}

/// Writes the success rate of every condition of `log` to the file `out`, or into the folder `out`. Returns the file.
///
/// # Errors
/// When the run is a unit of a plan or not complete, or the system refuses.
pub fn write_results(
    log: &RunLog,
    dataset: &HubDataset,
    source: Option<&str>,
    out: &Path,
) -> Result<PathBuf> {
    let run = log.dir.display();
    if let Some(unit) = &log.manifest.unit {
        bail!(
            "{run} is unit {} of a plan, a part of a run: use what `memtransfer merge` makes of all units",
            unit.number
        );
    }
    let scores = score(log);
    if scores.finished < scores.planned {
        bail!(
            "{run} has {} of {} episodes, and results are published of complete runs only: the run's command \
             resumes it",
            scores.finished,
            scores.planned
        );
    }
    let path = match is_file(out, "yaml") {
        true => out.to_owned(),
        false => out.join(format!("memtransfer-{}.yaml", log.manifest.settings.suite.word())),
    };
    write_text(&path, &yaml(log, &success_rates(&scores), dataset, source)?)?;
    Ok(path)
}

/// The success rate of a condition, in percent.
struct SuccessRate {
    condition: Condition,
    /// Episodes or sequences, in words.
    count: String,
    mean: f64,
    interval: Option<Interval>,
}

fn success_rates(scores: &Scores) -> Vec<SuccessRate> {
    let of_episodes = |score: &ConditionScore| SuccessRate {
        condition: score.condition,
        count: format!("{} episodes", score.episodes),
        mean: score.sr.mean,
        interval: score.sr.interval,
    };
    let of_streams = |score: &StreamScore| {
        let success = score.success?;
        Some(SuccessRate {
            condition: score.condition,
            count: format!("{} sequences", score.sequences),
            mean: success.mean,
            interval: success.interval,
        })
    };
    let streams = scores.streams.iter().flat_map(|streams| &streams.conditions);
    scores.conditions.iter().map(of_episodes).chain(streams.filter_map(of_streams)).collect()
}

fn yaml(
    log: &RunLog,
    rates: &[SuccessRate],
    dataset: &HubDataset,
    source: Option<&str>,
) -> Result<String> {
    // A JSON string is a YAML string.
    let quoted = |text: &str| serde_json::to_string(text);
    let manifest = &log.manifest;
    let frames = manifest.settings.frames;
    let began = log.began_unix_s().map(date);
    let mut text = String::new();
    for SuccessRate { condition, count, mean, interval } in rates {
        // The suite and the condition; in a control run the kind of its frames follows.
        let mut task_id =
            format!("{}/{condition}", manifest.settings.suite.word()).replace('/', "_");
        let mut notes = format!(
            "success rate in percent, n = {count}; MemTransfer {}, protocol {}; policy {}",
            manifest.version,
            log.protocol_id(),
            manifest.policy_label()
        );
        if frames != Frames::Rendered {
            write!(task_id, "_frames-{frames}")?;
            write!(notes, "; a control: frames {frames}")?;
        }
        let authors = manifest.document_authors(condition.memory);
        if !authors.is_empty() {
            write!(notes, "; documents: {}", author_words(&authors))?;
        }
        if let Some(Interval { low, high }) = interval {
            write!(notes, "; 95 % interval {low:.1} to {high:.1}")?;
        }
        writeln!(text, "- dataset:")?;
        writeln!(text, "    id: {}", quoted(&dataset.0)?)?;
        writeln!(text, "    task_id: {}", quoted(&task_id)?)?;
        writeln!(text, "  value: {mean:.2}")?;
        if let Some(day) = began.as_ref().and_then(|began| began.split(' ').next()) {
            writeln!(text, "  date: {}", quoted(day)?)?;
        }
        if let Some(source) = source {
            writeln!(text, "  source:\n    url: {}", quoted(source)?)?;
        }
        writeln!(text, "  notes: {}", quoted(&notes)?)?;
    }
    if text.is_empty() {
        bail!("the run has no success rate");
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use domain::StreamOrder;
    use rigs::records::{log, record, sequence, stream_log};

    use super::*;

    #[test]
    fn a_complete_run_has_a_result_for_each_condition() {
        let dir = tempfile::tempdir().unwrap();
        let dataset: HubDataset = "team/memtransfer".parse().unwrap();
        let mut log = log(vec![record("t01-01", true), record("t01-02", false)]);
        log.manifest.episodes = 3;
        let refused = write_results(&log, &dataset, None, dir.path()).unwrap_err();
        assert!(refused.to_string().contains("2 of 3 episodes"), "{refused}");
        log.manifest.episodes = 2;
        let path = write_results(&log, &dataset, Some("team/\"x\""), dir.path()).unwrap();
        assert!(path.ends_with("memtransfer-quick.yaml"), "{}", path.display());
        let text = std::fs::read_to_string(path).unwrap();
        let protocol = text.split("protocol ").nth(1).and_then(|rest| rest.get(..8)).unwrap();
        insta::assert_snapshot!(text.replace(protocol, "ID"), @r#"
        - dataset:
            id: "team/memtransfer"
            task_id: "quick_episodic_original_unchanged_original"
          value: 50.00
          source:
            url: "team/\"x\""
          notes: "success rate in percent, n = 2 episodes; MemTransfer 1.2.3, protocol ID; policy grounded, scripted stand-in; 95 % interval 0.0 to 100.0"
        "#);
        log.manifest.settings.frames = Frames::Blank;
        let path = write_results(&log, &dataset, None, dir.path()).unwrap();
        let text = std::fs::read_to_string(path).unwrap();
        assert!(
            text.contains("\"quick_episodic_original_unchanged_original_frames-blank\""),
            "{text}"
        );
        assert!(text.contains("; a control: frames blank; 95 %"), "{text}");
        let condition = ("episodic/new/unchanged/original/learning".parse().unwrap(), 1);
        let streams = stream_log(
            sequence(condition, (0, StreamOrder::Drawn), &[(0, &["t01-01"])], 1, |_, _| true),
            [1, 1, 1],
        );
        let path = write_results(&streams, &dataset, None, dir.path()).unwrap();
        let text = std::fs::read_to_string(path).unwrap();
        assert!(text.contains("n = 1 sequences; "), "{text}");
        for wrong in ["", "team", "a/b/c", "a/ b", "/x"] {
            assert!(wrong.parse::<HubDataset>().is_err(), "{wrong}");
        }
    }
}
