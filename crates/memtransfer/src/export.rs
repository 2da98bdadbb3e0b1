//! `memtransfer export`: a run as files for other programs.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::builder::TypedValueParser;
use clap::{Args, ValueEnum};
use conditions::key::EpisodeKey;
use conditions::settings::CaseSelector;
use domain::shell_word;
use export::{
    EpisodeFormat, Episodes, HubDataset, TableFormat, Timing, write_results, write_tables,
};
use run_log::{RunLog, RunParts};
use scores::Successes;
use settings::select_cases;
use world_client::{FirstEpisodes, RecordedRun, Selection, WorldAccess};

use super::{Exit, WorldCommandArgs, print, warn_of_damage};

/// Episodes of MCAP and MP4, unless some are chosen.
const FEW: Selection = Selection::First(10);

#[derive(Debug, Args)]
#[command(after_help = "\
Formats:
  mcap          views, poses, events, decisions and what memory supplied, for Foxglove and Rerun
  mp4           the views as a video; needs ffmpeg
  csv, parquet  two tables, `episodes` and `steps`, for pandas, DuckDB or a spreadsheet
  hugging-face  the success rates as `.eval_results` YAML for a model's page on the Hub

With mcap and mp4, --out is a file for all chosen episodes, one after the other, or a folder with a
file for each. Views are rendered from the log's poses, so the run needs no images. docs/exports.md
has every channel, column and key.

Examples:
  memtransfer export runs/quick-grounded --format mcap --out episodes
  memtransfer export runs/quick-grounded --format mp4 --cases t01-01 --condition episodic,new \\
      --out t01-01.mp4
  memtransfer export runs/quick-grounded --format parquet --out tables
  memtransfer export runs/quick-grounded --format hugging-face --dataset my-team/memtransfer \\
      --out .eval_results")]
pub(super) struct ExportArgs {
    /// The run's folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// The format
    #[arg(long, value_enum)]
    format: Format,
    /// The file or folder to write; files of the same names are replaced
    #[arg(long, value_name = "PATH")]
    out: PathBuf,
    /// Only episodes of these cases or tasks: t01-01,t03
    #[arg(long, value_name = "CASES", value_delimiter = ',')]
    cases: Vec<CaseSelector>,
    /// Only episodes of this condition, or of all whose names have these words: episodic,new
    #[arg(long, value_name = "CONDITION")]
    condition: Option<String>,
    /// The number of episodes, failures first, or `all` [default: all; 10 for mcap and mp4 without --cases and --condition]
    #[arg(long, value_name = "N|all")]
    episodes: Option<Selection>,
    /// With mcap and mp4: steps a second [default: 2]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=60))]
    fps: Option<u32>,
    /// With mcap and mp4: width and height of a view in pixels, a multiple of 64 [default: 448]
    #[arg(long, value_name = "PIXELS", value_parser = view_edge())]
    size: Option<u16>,
    /// With hugging-face: the id of the benchmark's data set on the Hub
    #[arg(long, value_name = "TEAM/NAME", required_if_eq("format", "hugging-face"))]
    dataset: Option<HubDataset>,
    /// With hugging-face: the address of what the results come from, for example of the published log
    #[arg(long, value_name = "URL")]
    source: Option<String>,
    #[command(flatten)]
    world: WorldCommandArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Mcap,
    Mp4,
    Csv,
    Parquet,
    HuggingFace,
}

impl Format {
    /// The extension of its files.
    const fn extension(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Mp4 => "mp4",
            Self::Csv => "csv",
            Self::Parquet => "parquet",
            Self::HuggingFace => "yaml",
        }
    }
}

/// Reads the width and height of a view.
pub(super) fn view_edge() -> impl TypedValueParser<Value = u16> {
    clap::value_parser!(u16).range(64..=2048).try_map(renderable)
}

/// The simulator renders rows of whole blocks of 64 pixels.
fn renderable(size: u16) -> Result<u16, &'static str> {
    if size.is_multiple_of(64) { Ok(size) } else { Err("expected a multiple of 64") }
}

pub(super) fn run(args: &ExportArgs) -> Result<Exit> {
    args.check()?;
    let files = match args.format {
        Format::Mcap => args.write_episodes(EpisodeFormat::Mcap)?,
        Format::Mp4 => args.write_episodes(EpisodeFormat::Mp4)?,
        Format::Csv => args.write_tables(TableFormat::Csv)?,
        Format::Parquet => args.write_tables(TableFormat::Parquet)?,
        Format::HuggingFace => {
            let dataset = args.dataset.as_ref().context("--format hugging-face needs --dataset")?;
            let log = RunLog::read(&args.run)?;
            warn_of_damage(&log.damaged);
            vec![write_results(&log, dataset, args.source.as_deref(), &args.out)?]
        }
    };
    let paths: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    print(&paths.join("\n"))?;
    Ok(Exit::Complete)
}

impl ExportArgs {
    /// Refuses flags that the format does not have, and a file that is named as one of another format.
    fn check(&self) -> Result<()> {
        let (shows, chooses) = match self.format {
            Format::Mcap | Format::Mp4 => (true, true),
            Format::Csv | Format::Parquet => (false, true),
            Format::HuggingFace => (false, false),
        };
        let is_hub = self.format == Format::HuggingFace;
        let given = [
            ("--fps", self.fps.is_some(), shows, "mcap and mp4"),
            ("--size", self.size.is_some(), shows, "mcap and mp4"),
            ("--cases", !self.cases.is_empty(), chooses, "mcap, mp4, csv and parquet"),
            ("--condition", self.condition.is_some(), chooses, "mcap, mp4, csv and parquet"),
            ("--episodes", self.episodes.is_some(), chooses, "mcap, mp4, csv and parquet"),
            ("--dataset", self.dataset.is_some(), is_hub, "hugging-face"),
            ("--source", self.source.is_some(), is_hub, "hugging-face"),
        ];
        if let Some((flag, .., formats)) =
            given.iter().find(|(_, is_given, is_known, _)| *is_given && !is_known)
        {
            bail!("{flag} is for the formats {formats}");
        }
        let extension = self.out.extension().unwrap_or_default().to_ascii_lowercase();
        let named = Format::value_variants().iter().find(|one| *one.extension() == *extension);
        if named.is_some_and(|named| *named != self.format) {
            bail!(
                "--out {} has the extension of another format: this one writes .{} files",
                self.out.display(),
                self.format.extension()
            );
        }
        Ok(())
    }

    fn write_episodes(&self, format: EpisodeFormat) -> Result<Vec<PathBuf>> {
        let program = self.world.program()?;
        let is_chosen = !self.cases.is_empty() || self.condition.is_some();
        let ChosenRun { mut run, parts } =
            self.choose(&program.access(), if is_chosen { Selection::All } else { FEW })?;
        run.log = parts.whole()?;
        for notice in &run.notices {
            say!("{notice}");
        }
        let timing = Timing { steps_per_s: self.fps.unwrap_or(2), edge: self.size.unwrap_or(448) };
        Episodes::new(run, &program, timing)?.write(format, &self.out)
    }

    fn write_tables(&self, format: TableFormat) -> Result<Vec<PathBuf>> {
        let ChosenRun { run, parts } =
            self.choose(&self.world.program()?.access(), Selection::All)?;
        write_tables(&run, &parts, format, &self.out)
    }

    /// The run with the chosen episodes alone, the `default` ones unless a number was given.
    fn choose(&self, access: &WorldAccess, default: Selection) -> Result<ChosenRun> {
        let mut parts = RunParts::open(&self.run, self.scratch())?;
        warn_of_damage(&parts.head().damaged);
        let mut run = RecordedRun::of(parts.head().clone(), Successes::default(), access)?;
        let mut before = 0;
        for record in parts.episodes() {
            run.successes.extend([&record?]);
            before += 1;
        }
        let mut count = before;
        if !self.cases.is_empty() || self.condition.is_some() {
            let ids = run.world.description().case_ids();
            let cases = match &self.cases[..] {
                [] => None,
                cases => Some(select_cases(&ids, cases)?),
            };
            let cases: Option<BTreeSet<&str>> =
                cases.map(|cases| cases.into_iter().map(|case| ids[case]).collect());
            let is_chosen = |key: &EpisodeKey| {
                cases.as_ref().is_none_or(|cases| cases.contains(key.case.as_str()))
                    && self.condition.as_ref().is_none_or(|words| key.condition.has_words(words))
            };
            parts
                .head_mut()
                .errors
                .retain(|error| EpisodeKey::read(&error.key).is_some_and(|key| is_chosen(&key)));
            count = 0;
            parts.retain(|record| {
                let is_chosen = is_chosen(&record.own_key());
                count += usize::from(is_chosen);
                is_chosen
            })?;
        }
        if let Selection::First(most) = self.episodes.unwrap_or(default) {
            let mut first = FirstEpisodes::new(most);
            for record in parts.episodes() {
                first.add(&record?, false);
            }
            let (chosen, mut number) = (first.numbers(), 0..);
            parts.retain(|_| number.next().is_some_and(|number| chosen.contains(&number)))?;
            parts.head_mut().errors.clear();
            count = chosen.len();
        }
        if count == 0 {
            bail!(
                "{} has {before} finished episodes, and none of them was chosen: `memtransfer view {}` lists them",
                self.run.display(),
                shell_word(&self.run)
            );
        }
        if count < before {
            say!("{count} of {before} episodes");
        }
        Ok(ChosenRun { run, parts })
    }

    /// A folder in the file system of `--out`, which has room for as much.
    fn scratch(&self) -> &Path {
        let folders = self.out.ancestors().filter(|folder| *folder != Path::new(""));
        folders.into_iter().find(|folder| folder.is_dir()).unwrap_or(Path::new("."))
    }
}

/// A run and the episodes of it that are chosen.
struct ChosenRun {
    /// The run, whose log has no episodes, with its successes, chosen or not.
    run: RecordedRun,
    /// The chosen episodes.
    parts: RunParts,
}
