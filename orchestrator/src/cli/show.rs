//! `memtransfer show`: one step of an episode, as the policy was given it.

mod page;
mod text;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Args;

use super::{Exit, print, print_json};
use results::log::{EpisodeRecord, RunLog};
use results::names::UnknownName;
use results::step_view::{Prompt, look_up};

#[derive(Debug, Args)]
#[command(after_help = "\
What the policy was shown, said to a model and heard back is there for runs with --log-prompts; of
others the log knows poses, actions and what was retrieved.

Examples:
  memtransfer show runs/quick-grounded t01-01 0 --condition episodic,new
  memtransfer show runs/quick-grounded t01-01 12 --condition episodic,new --html step.html
  memtransfer show runs/quick-grounded t01-01 12 --condition working,new --images views/")]
pub(super) struct ShowArgs {
    /// The run's folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// The case, for example t03-07
    #[arg(value_name = "CASE")]
    case: String,
    /// The step: how many were taken before, so 0 is the first
    #[arg(value_name = "STEP")]
    step: u32,
    /// The condition, or words of it, separated by commas, that no other one has together
    #[arg(long, value_name = "CONDITION")]
    condition: Option<String>,
    /// Which repetition, from 1 [default: the first that is finished]
    #[arg(long = "run", value_name = "N")]
    repetition: Option<u32>,
    /// Write the images into DIR, in the order in which they were shown
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Write one page with everything, images included, to FILE
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ShowArgs) -> Result<Exit> {
    let log = RunLog::read(&args.run)?;
    let shown = look_up(&log, args.episode(&log)?, args.step)?;
    if args.json {
        print_json(&shown)?;
    } else {
        print(&text::render(&shown))?;
    }
    if args.images.is_none() && args.html.is_none() {
        return Ok(Exit::Complete);
    }
    let Some(prompt) = &shown.prompt else {
        bail!(
            "there are no images: the run has no prompt log of this step (memtransfer run --log-prompts)"
        );
    };
    if let Some(folder) = &args.images {
        write_images(folder, prompt)?;
    }
    if let Some(file) = &args.html {
        let page = page::render(&shown, prompt)?;
        fs::write(file, page).with_context(|| format!("cannot write {}", file.display()))?;
        eprintln!("wrote {}", file.display());
    }
    Ok(Exit::Complete)
}

impl ShowArgs {
    /// The one episode that is asked for.
    fn episode<'a>(&self, log: &'a RunLog) -> Result<&'a EpisodeRecord> {
        let of_case = |record: &&EpisodeRecord| record.case == self.case;
        let walked: Vec<&EpisodeRecord> = log.episodes.iter().filter(of_case).collect();
        if walked.is_empty() {
            let mut cases: Vec<&str> = log.episodes.iter().map(|r| r.case.as_str()).collect();
            cases.dedup();
            cases.sort_unstable();
            cases.dedup();
            return Err(UnknownName::new(
                "case (among those that are finished)",
                &self.case,
                cases,
            )
            .into());
        }
        let asked_for = |record: &&EpisodeRecord| match &self.condition {
            None => true,
            Some(asked) => {
                let condition = record.condition().to_string();
                let words: Vec<&str> = condition.split('/').collect();
                condition == *asked
                    || asked.split([',', '/']).all(|word| words.contains(&word.trim()))
            }
        };
        let mut found: Vec<&EpisodeRecord> = walked.iter().copied().filter(asked_for).collect();
        // A condition in full is that one, and not those that vary from it.
        let exact =
            |record: &&EpisodeRecord| Some(record.condition().to_string()) == self.condition;
        if found.iter().any(exact) {
            found.retain(exact);
        }
        let mut conditions: Vec<String> = if found.is_empty() { &walked } else { &found }
            .iter()
            .map(|r| r.condition().to_string())
            .collect();
        conditions.dedup();
        if found.is_empty() || conditions.len() > 1 {
            bail!(
                "{} was walked under {} conditions{}; choose one with --condition:\n  {}",
                self.case,
                conditions.len(),
                if found.is_empty() {
                    ", none of which is that one"
                } else {
                    " that this could mean"
                },
                conditions.join("\n  ")
            );
        }
        found.sort_by_key(|record| record.run);
        let chosen = match self.repetition {
            None => found.first().copied(),
            Some(run) => found.iter().copied().find(|record| record.run == run),
        };
        chosen.with_context(|| {
            let runs: Vec<String> = found.iter().map(|record| record.run.to_string()).collect();
            format!("that repetition is not finished; choose one with --run: {}", runs.join(", "))
        })
    }
}

/// Writes the images of a request, named by their place in it.
fn write_images(folder: &Path, prompt: &Prompt) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let request = &prompt.entry.request;
    let remembered =
        request.segment.iter().map(|segment| &segment.steps).chain(&prompt.demonstrations);
    let mut named = vec![("now".to_owned(), &request.frame)];
    for (index, past) in request.window.iter().enumerate() {
        named.push((format!("window-{:02}", index + 1), &past.frame));
    }
    for (walk, steps) in remembered.enumerate() {
        for (step, seen) in steps.iter().enumerate() {
            if let Some(frame) = &seen.frame {
                named.push((format!("memory-{}-{step:03}", walk + 1), frame));
            }
        }
    }
    for (name, hash) in &named {
        let Some(source) = prompt.images.get(*hash) else { continue };
        let target = folder.join(format!("{name}.png"));
        fs::copy(source, &target)
            .with_context(|| format!("cannot copy {} to {}", source.display(), target.display()))?;
    }
    eprintln!("wrote {} images to {}", named.len(), folder.display());
    Ok(())
}
