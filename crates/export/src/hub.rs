//! Results as Hugging Face's Hub reads them from a model's repository: `.eval_results/*.yaml`
//! (<https://huggingface.co/docs/hub/eval-results>).

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Result, bail};
use results::conditions::Frames;
use results::date::date;
use results::log::RunLog;

use crate::files::{is_file, write_text};
use crate::leaderboard::{Board, Entry, Score};

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
/// When the run is not complete, or the system refuses.
pub fn write_results(
    log: &RunLog,
    dataset: &HubDataset,
    source: Option<&str>,
    out: &Path,
) -> Result<PathBuf> {
    let entry = Entry::of(log)?;
    let run = log.dir.display();
    if entry.is_incomplete() {
        bail!(
            "{run} has {} of {} episodes, and results are published of complete runs only: the run's command \
             resumes it",
            entry.finished,
            entry.planned
        );
    }
    let path = match is_file(out, "yaml") {
        true => out.to_owned(),
        false => out.join(format!("memtransfer-{}.yaml", entry.suite())),
    };
    let frames = log.manifest.settings.frames;
    let text = yaml(&entry, frames, log.began_unix_s(), dataset, source)?;
    write_text(&path, &text)?;
    Ok(path)
}

/// The id of a task: the suite and the condition, `rq1_episodic_new_unchanged_original`; in a control run the kind of its frames
/// follows.
fn task_id(entry: &Entry, score: &Score, frames: Frames) -> String {
    let id = format!("{}_{}", entry.suite(), score.condition.replace('/', "_"));
    match frames {
        Frames::Rendered => id,
        control => format!("{id}_frames-{control}"),
    }
}

fn yaml(
    entry: &Entry,
    frames: Frames,
    began: Option<u64>,
    dataset: &HubDataset,
    source: Option<&str>,
) -> Result<String> {
    // A JSON string is a YAML string.
    let quoted = |text: &str| serde_json::to_string(text);
    let board = Board::new(std::slice::from_ref(entry));
    let protocol = board.sections.first().map_or("", |section| section.id.as_str());
    let version = entry.protocol.get("version").and_then(|version| version.as_str());
    let mut text = String::new();
    for score in &entry.scores {
        let figure = |name: &str, of| Some((score.figures.get(name)?, of));
        let figure = figure("sr", "episodes").or_else(|| figure("success", "sequences"));
        let Some((figure, counted)) = figure else { continue };
        let mut notes = format!(
            "success rate in percent, n = {} {counted}; MemTransfer {}, protocol {protocol}; policy {}",
            score.count,
            version.unwrap_or("of unknown version"),
            entry.policy.label()
        );
        if frames != Frames::Rendered {
            write!(notes, "; a control: frames {frames}")?;
        }
        if let Some((low, high)) = figure.low.zip(figure.high) {
            write!(notes, "; 95 % interval {low:.1} to {high:.1}")?;
        }
        writeln!(text, "- dataset:")?;
        writeln!(text, "    id: {}", quoted(&dataset.0)?)?;
        writeln!(text, "    task_id: {}", quoted(&task_id(entry, score, frames))?)?;
        writeln!(text, "  value: {:.2}", figure.mean)?;
        if let Some(began) = began {
            writeln!(
                text,
                "  date: {}",
                quoted(date(began).split(' ').next().unwrap_or_default())?
            )?;
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
    use results::log::testing::{log, record, sequence, stream_log};

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
