//! `memtransfer show`: an episode step by step, or one step as the policy received it.

mod text;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use case_book::act::EpisodeParts;
use clap::Args;
use domain::names::UnknownName;
use domain::prompt_log::RecordedItem;
use run_log::policy::PolicyLabel;
use run_log::step_view::{RecordedPrompt, look_up};
use run_log::{EpisodeRecord, RunLog};
use scores::FailurePoints;
use serde::Serialize;
use settings::cases_of_run;
use viewer::logged_image;
use world_client::{EpisodeEvent, EpisodeTimeline, RunWorld, TimelineStep};

use super::{Exit, WorldCommandArgs, print, print_json};

/// Maximum number of cases that a message names.
const MOST_NAMED: usize = 8;

#[derive(Debug, Args)]
#[command(after_help = "\
Without a step, this prints what happened in the episode, where a failed one got into a loop and
first acts unlike a success of the same case, and for each step the pose, the feedback, the action
and what was retrieved. Of a step in a run with --log-prompts, it prints the prompt, its
images and the answer. `memtransfer view` shows the same as pages.

Examples:
  memtransfer show runs/quick-grounded t01-01 --condition episodic,new
  memtransfer show runs/quick-grounded t01-01 0 --condition episodic,new
  memtransfer show runs/quick-grounded t01-01 12 --condition episodic,new --json
  memtransfer show runs/quick-grounded t01-01 12 --condition working,new --images views/")]
pub(super) struct ShowArgs {
    /// The run's folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// The case, for example t03-07, or the key of an episode, as the log has it
    #[arg(value_name = "CASE|KEY")]
    case: String,
    /// The step: how many were taken before, so 0 is the first
    #[arg(value_name = "STEP")]
    step: Option<u32>,
    /// The condition, or words of it, separated by commas, that identify it
    #[arg(long, value_name = "CONDITION")]
    condition: Option<String>,
    /// Which repetition, from 1 [default: the first that is finished]
    #[arg(long = "run", value_name = "N")]
    repetition: Option<u32>,
    /// Write the images of the step's prompt into DIR
    #[arg(long, value_name = "DIR", requires = "step")]
    images: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    world: WorldCommandArgs,
}

pub(super) fn run(args: &ShowArgs) -> Result<Exit> {
    let log = RunLog::read(&args.run)?;
    let record = args.episode(&log)?;
    let world = RunWorld::new(&log, &args.world.program()?.access())?;
    let parts = EpisodeParts { reference: true, ..EpisodeParts::default() };
    let timeline = EpisodeTimeline::new(&world, record, &log.episodes.iter().collect(), parts)?;
    let Some(step) = args.step else {
        let shown = ShownEpisode {
            key: &record.key,
            policy: log.manifest.policy_label(),
            reference: record.reference,
            events: &timeline.events,
            points: timeline.points.as_ref(),
            steps: timeline.decisions(),
        };
        match args.json {
            true => print_json(&shown)?,
            false => print(&text::episode(&shown))?,
        }
        return Ok(Exit::Complete);
    };
    let prompt = look_up(&log, record, step)?;
    let logged = timeline.decisions().get(step as usize).context("there is no such step")?;
    let shown = ShownStep { key: &record.key, step, steps: record.steps, logged, prompt };
    match args.json {
        true => print_json(&shown)?,
        false => print(&text::step(&shown))?,
    }
    let Some(folder) = &args.images else { return Ok(Exit::Complete) };
    let Some(prompt) = &shown.prompt else {
        bail!(
            "{} has no prompt log of this step, so there are no images. Prompts are logged while episodes run: give \
             the run's command again with --log-prompts, --cases {} and another --out",
            args.run.display(),
            args.case
        );
    };
    write_images(folder, &args.run, prompt)?;
    Ok(Exit::Complete)
}

/// A whole episode.
#[derive(Serialize)]
struct ShownEpisode<'a> {
    key: &'a str,
    policy: PolicyLabel,
    reference: u32,
    events: &'a [EpisodeEvent],
    /// Since when it failed; absent for a success.
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<&'a FailurePoints>,
    steps: &'a [TimelineStep<'a>],
}

/// A step.
#[derive(Serialize)]
struct ShownStep<'a> {
    key: &'a str,
    step: u32,
    /// Steps of the whole episode.
    steps: u32,
    #[serde(flatten)]
    logged: &'a TimelineStep<'a>,
    /// What the prompt log has; absent where there is nothing.
    prompt: Option<RecordedPrompt>,
}

impl ShowArgs {
    /// The requested episode.
    fn episode<'a>(&self, log: &'a RunLog) -> Result<&'a EpisodeRecord> {
        if let Some(record) = log.episodes.iter().find(|record| record.key == self.case) {
            return Ok(record);
        }
        let of_case: Vec<&EpisodeRecord> =
            log.episodes.iter().filter(|record| record.case == self.case).collect();
        if of_case.is_empty() {
            return Err(self.no_such_case(log));
        }
        let condition = |record: &EpisodeRecord| record.condition().to_string();
        let mut found = of_case.clone();
        if let Some(asked) = &self.condition {
            let has_words = |record: &&EpisodeRecord| record.condition().has_words(asked);
            // A condition in full does not stand for its variations.
            let exact = found.iter().copied().filter(|record| condition(record) == *asked);
            let exact: Vec<&EpisodeRecord> = exact.collect();
            found = match exact.is_empty() {
                true => found.into_iter().filter(has_words).collect(),
                false => exact,
            };
        }
        let among = if found.is_empty() { &of_case } else { &found };
        let mut conditions: Vec<String> = among.iter().map(|record| condition(record)).collect();
        conditions.dedup();
        if found.is_empty() || conditions.len() > 1 {
            let matching =
                if found.is_empty() { "none of which is that one" } else { "all of which match" };
            bail!(
                "{} ran under {} conditions, {matching}; choose one with --condition:\n  {}",
                self.case,
                conditions.len(),
                conditions.join("\n  ")
            );
        }
        if found.len() > 1 && found[0].stream.is_some() {
            let keys: Vec<&str> = found.iter().map(|record| record.key.as_str()).collect();
            bail!(
                "{} has {} episodes in these streams; give the key of one in place of the case:\n  {}",
                self.case,
                keys.len(),
                keys.join("\n  ")
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

    /// Why the run has no finished episode of the case: it is not finished, not part of the run, or does not exist.
    fn no_such_case(&self, log: &RunLog) -> anyhow::Error {
        let (case, run, settings) = (&self.case, self.run.display(), &log.manifest.settings);
        let program = self.world.program();
        let Ok(world) = program.and_then(|program| RunWorld::new(log, &program.access())) else {
            return anyhow!("{run} has no finished episode of {case}");
        };
        let description = world.description();
        let ids = description.case_ids();
        let Some(index) = ids.iter().position(|id| id == case) else {
            return UnknownName::new("case", case, ids).into();
        };
        if settings.stream.is_some() {
            return anyhow!(
                "{run} has no finished episode of {case}; `memtransfer ls streams` lists what streams have"
            );
        }
        let planned =
            cases_of_run(&description.world, &description.cases, settings).unwrap_or_default();
        if planned.contains(&index) {
            anyhow!("no episode of {case} is finished yet in {run}: the run's command resumes it")
        } else {
            let chosen: Vec<&str> = planned.iter().take(MOST_NAMED).map(|&at| ids[at]).collect();
            let more = if planned.len() > MOST_NAMED { ", ..." } else { "" };
            anyhow!(
                "{case} is not one of the cases of {run}, which its --cases and --limit chose: {}{more}",
                chosen.join(", ")
            )
        }
    }
}

/// Writes the images of a request, named by their place in it.
fn write_images(folder: &Path, run: &Path, prompt: &RecordedPrompt) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let request = &prompt.entry.request;
    let mut named = vec![("now".to_owned(), &request.frame)];
    for (index, past) in request.window.iter().enumerate() {
        named.push((format!("window-{:02}", index + 1), &past.frame));
    }
    for (number, item) in (1..).zip(&request.items) {
        let steps = match item {
            RecordedItem::Text { .. } | RecordedItem::Plan { .. } => continue,
            RecordedItem::Frame { frame, .. } => {
                named.push((format!("memory-{number}"), frame));
                continue;
            }
            RecordedItem::Segment { steps, .. } => steps.as_slice(),
            RecordedItem::Trajectory { steps, .. } => prompt.trajectory(steps),
        };
        for (step, seen) in steps.iter().enumerate() {
            if let Some(frame) = &seen.frame {
                named.push((format!("memory-{number}-{step:03}"), frame));
            }
        }
    }
    for (name, hash) in &named {
        let Some(source) = prompt.images.get(*hash) else { continue };
        let target = folder.join(format!("{name}.png"));
        let (bytes, _) = logged_image(run, source)?
            .with_context(|| format!("{} is missing", source.display()))?;
        durable::output::write(&target, bytes)
            .with_context(|| format!("cannot write {}", target.display()))?;
    }
    say!("wrote {} images to {}", named.len(), folder.display());
    Ok(())
}
