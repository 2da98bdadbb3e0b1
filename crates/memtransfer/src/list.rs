//! `memtransfer ls`: lists cases, tasks, items, suites, conditions, streams and runs.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use super::{Exit, WorldArgs, print, print_json, world_program};
use anyhow::{Context, bail};
use case_book::act::WorldDescription;
use case_book::{BookRequest, CaseFacts, StreamsRequest};
use clap::{Args, Subcommand};
use conditions::Condition;
use conditions::settings::{RunSettings, StreamSettings};
use domain::{Route, Start};
use report::table::table;
use run_log::RunLog;
use run_log::date::date;
use scores::score;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use settings::{Layer, SHIPPED_SUITES, resolve, select_cases};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memtransfer ls cases
  memtransfer ls cases --suite quick
  memtransfer ls items --json | jq '.[] | select(.category == \"barrels\")'
  memtransfer ls runs")]
pub(super) struct ListArgs {
    #[command(subcommand)]
    what: ListWhat,
    /// Print JSON
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum ListWhat {
    /// Cases: instruction, starting poses, lengths of the reference routes
    Cases {
        #[command(flatten)]
        world: WorldArgs,
        /// Only the cases that a run of this suite, by name or file, selects
        #[arg(long, value_name = "NAME|FILE")]
        suite: Option<String>,
    },
    /// The demonstrations of other tasks in each case's mixed sets
    Histories(WorldArgs),
    /// The ten types of tasks
    Tasks(WorldArgs),
    /// The items of the warehouse, with the cells in front of them
    Items(WorldArgs),
    /// The shipped suites: purpose and size
    Suites,
    /// The conditions of a suite, as values of the flags of `memtransfer run`
    Conditions {
        /// A suite, by name or file
        #[arg(long, default_value = "quick", value_name = "NAME|FILE")]
        suite: String,
    },
    /// The streams of a suite: what happens before each block, and the block's cases
    Streams {
        /// A suite of streams, by name or file
        #[arg(long, default_value = "stream", value_name = "NAME|FILE")]
        suite: String,
        /// The seed that the streams are drawn from [default: the suite's]
        #[arg(long)]
        seed: Option<u64>,
    },
    /// The runs in a folder: policy, date, progress and success rate
    Runs {
        /// The folder of run folders [default: runs]
        #[arg(value_name = "DIR")]
        dir: Option<PathBuf>,
    },
}

/// A list as a table and as JSON.
struct Listing {
    header: Vec<&'static str>,
    /// Columns from this one on hold numbers.
    numbers: usize,
    rows: Vec<Vec<Value>>,
}

pub(super) fn run(args: &ListArgs) -> anyhow::Result<Exit> {
    let listing = match &args.what {
        ListWhat::Cases { world, suite: None } => {
            cases(&world_program()?.describe(&world.flags())?.cases)?
        }
        ListWhat::Cases { world, suite: Some(suite) } => {
            let assets = world.assets.as_ref().map(|dir| dir.display().to_string());
            let assets = assets.as_deref().map(|dir| ("assets", dir));
            let flags = [("suite", suite.as_str())].into_iter().chain(assets);
            cases(&selected_cases(&resolve([Layer::flags(flags)?])?.settings)?)?
        }
        ListWhat::Histories(world) => histories(world)?,
        ListWhat::Tasks(world) => tasks(&world_program()?.describe(&world.flags())?),
        ListWhat::Items(world) => items(world)?,
        ListWhat::Suites => suites()?,
        ListWhat::Conditions { suite } => conditions(suite)?,
        ListWhat::Streams { suite, seed } => streams(suite, *seed)?,
        ListWhat::Runs { dir } => runs(dir.as_deref())?,
    };
    if args.json {
        print_json(&listing.objects())?;
    } else {
        print(&listing.table())?;
    }
    Ok(Exit::Complete)
}

impl Listing {
    fn objects(&self) -> Vec<Value> {
        let object = |row: &Vec<Value>| {
            self.header.iter().map(|key| key.replace(' ', "_")).zip(row.iter().cloned()).collect()
        };
        self.rows.iter().map(object).map(Value::Object).collect()
    }

    fn table(&self) -> String {
        let mut table = table(&self.header, self.numbers);
        let text = |value: &Value| match value {
            Value::Null => "-".to_owned(),
            Value::String(text) => text.clone(),
            other => other.to_string(),
        };
        for row in &self.rows {
            table.add_row(row.iter().map(text));
        }
        table.to_string()
    }
}

/// The cases that a run selects.
fn selected_cases(settings: &RunSettings) -> anyhow::Result<Vec<CaseFacts>> {
    let world = WorldArgs { assets: settings.assets.clone() };
    let world = world_program()?.describe(&world.flags())?;
    let selected = select_cases(&world.case_ids(), &settings.cases, settings.limit)?;
    Ok(selected.into_iter().map(|index| world.cases[index].clone()).collect())
}

fn cases(cases: &[CaseFacts]) -> anyhow::Result<Listing> {
    let row = |case: &CaseFacts| {
        let reference = |start, route| {
            let found = case.reference(start, route);
            found.with_context(|| format!("{} has no reference", case.id))
        };
        let original = reference(Start::Original, Route::Unchanged)?;
        let new = reference(Start::New, Route::Unchanged)?;
        Ok(vec![
            json!(case.id),
            json!(case.instruction),
            json!(original.begin.to_string()),
            json!(new.begin.to_string()),
            json!(original.length),
            json!(new.length),
            json!(reference(Start::New, Route::Blocked)?.length),
        ])
    };
    Ok(Listing {
        header: vec![
            "case",
            "instruction",
            "original start",
            "new start",
            "original steps",
            "new steps",
            "blocked steps",
        ],
        numbers: 4,
        rows: cases.iter().map(row).collect::<anyhow::Result<_>>()?,
    })
}

/// The rows of a list that only the world can make.
pub(super) fn list<T: DeserializeOwned>(
    what: &str,
    arguments: impl IntoIterator<Item = OsString>,
) -> anyhow::Result<Vec<T>> {
    let arguments: Vec<OsString> = [what.into()].into_iter().chain(arguments).collect();
    let (rows, _) = world_program()?.print("list", &arguments)?;
    serde_json::from_str(&rows).context("sim-proc is another version")
}

fn histories(world: &WorldArgs) -> anyhow::Result<Listing> {
    let header = vec!["case", "kind", "history", "its instruction", "shared poses", "conflicts"];
    Ok(Listing { header, numbers: 4, rows: list("histories", world.flags())? })
}

fn tasks(world: &WorldDescription) -> Listing {
    let rows = world.world.tasks.iter().map(|task| {
        let of_type = || world.cases.iter().filter(|case| case.task == task.number);
        vec![
            json!(format!("t{:02}", task.number)),
            json!(task.name),
            json!(task.group),
            json!(of_type().next().map(|case| &case.instruction)),
            json!(of_type().count()),
        ]
    });
    Listing {
        header: vec!["task", "name", "group", "example", "cases"],
        numbers: 4,
        rows: rows.collect(),
    }
}

fn items(world: &WorldArgs) -> anyhow::Result<Listing> {
    let header = vec!["type", "category", "aisle", "rack", "standpoint", "item"];
    Ok(Listing { header, numbers: 5, rows: list("items", world.flags())? })
}

fn suites() -> anyhow::Result<Listing> {
    // A suite begins with a comment about its purpose.
    let about = |text: &str| {
        let comment = text.lines().take_while(|line| line.starts_with('#'));
        let about: Vec<&str> = comment
            .map(|line| line.trim_start_matches(['#', ' ']))
            .take_while(|line| !line.is_empty())
            .collect();
        about.join(" ")
    };
    let mut rows = Vec::new();
    let world = world_program()?.describe(&[])?;
    for (name, text) in SHIPPED_SUITES {
        let settings = resolve([Layer::flags([("suite", *name)])?])?.settings;
        let cases = select_cases(&world.case_ids(), &settings.cases, settings.limit)?.len();
        let conditions = settings.runs();
        let runs: u32 = conditions.iter().map(|(_, runs)| runs).sum();
        let each = settings.stream.as_ref().map_or(cases, StreamSettings::all_episodes);
        rows.push(vec![
            json!(name),
            json!(about(text)),
            json!(conditions.len()),
            json!(runs as usize * each),
        ]);
    }
    Ok(Listing { header: vec!["suite", "about", "conditions", "episodes"], numbers: 2, rows })
}

/// The runs in a folder; without one in `runs`, which the first run makes.
fn runs(given: Option<&Path>) -> anyhow::Result<Listing> {
    let dir = given.unwrap_or(Path::new("runs"));
    let mut rows = Vec::new();
    if dir.join("manifest.json").exists() {
        rows.push(run_row(dir));
    } else if given.is_some() || dir.exists() {
        let entries = std::fs::read_dir(dir);
        let entries = entries.with_context(|| format!("cannot list {}", dir.display()))?;
        let mut folders = entries
            .map(|entry| entry.map(|entry| entry.path()))
            .collect::<Result<Vec<PathBuf>, _>>()?;
        folders.retain(|folder| folder.join("manifest.json").exists());
        folders.sort();
        rows = folders.iter().map(|folder| run_row(folder)).collect();
    }
    let header =
        vec!["run", "suite", "policy", "started", "state", "finished", "planned", "given up", "SR"];
    Ok(Listing { header, numbers: 5, rows })
}

fn conditions(suite: &str) -> anyhow::Result<Listing> {
    let settings = resolve([Layer::flags([("suite", suite)])?])?.settings;
    if settings.stream.is_some() {
        bail!(
            "{suite} is a suite of streams: `memtransfer ls streams --suite {suite}` lists its blocks"
        );
    }
    let rows = settings.runs().into_iter().map(|(condition, runs)| {
        let Condition { memory, start, route, demonstrations, variation, arm: _ } = condition;
        vec![
            json!(memory.to_string()),
            json!(start.to_string()),
            json!(route.to_string()),
            json!(demonstrations.to_string()),
            json!(variation.segment.to_string()),
            json!(variation.hint.to_string()),
            json!(variation.window),
            json!(runs),
        ]
    });
    let header = vec!["memory", "starts", "routes", "demos", "segment", "hint", "window", "runs"];
    Ok(Listing { header, numbers: 6, rows: rows.collect() })
}

/// The blocks of a suite's streams; a row for each event, or one for a block without.
fn streams(suite: &str, seed: Option<u64>) -> anyhow::Result<Listing> {
    let seed = seed.map(|seed| seed.to_string());
    let flags = [("suite", Some(suite)), ("seed", seed.as_deref())];
    let flags = flags.into_iter().filter_map(|(name, text)| Some((name, text?)));
    let settings = resolve([Layer::flags(flags)?])?.settings;
    let stream = settings.stream.as_ref();
    let stream = stream.with_context(|| format!("the suite {suite} has no [stream] table"))?;
    let among = selected_cases(&settings)?;
    let request = BookRequest {
        assets: settings.assets.clone(),
        cases: among.into_iter().map(|case| case.id).collect(),
        streams: Some(StreamsRequest {
            rules: stream.rules(),
            seed: settings.seed,
            planned: false,
        }),
        ..BookRequest::default()
    };
    let mut rows = Vec::new();
    let blocks: Vec<(usize, usize, Vec<String>, Vec<String>)> =
        list("streams", [serde_json::to_string(&request)?.into()])?;
    for (stream, block, events, cases) in blocks {
        let row = |event| vec![json!(stream), json!(block), event, json!(cases.join(" "))];
        if events.is_empty() {
            rows.push(row(Value::Null));
        }
        rows.extend(events.into_iter().map(|event| row(json!(event))));
    }
    Ok(Listing { header: vec!["stream", "block", "event before it", "cases"], numbers: 4, rows })
}

/// A run's row; of a run that cannot be read, the reason.
fn run_row(folder: &Path) -> Vec<Value> {
    let name = json!(folder.display().to_string());
    let log = match RunLog::read(folder) {
        Ok(log) => log,
        Err(error) => {
            let mut row = vec![name, Value::Null, Value::Null, Value::Null];
            row.push(json!(error.to_string()));
            row.resize(9, Value::Null);
            return row;
        }
    };
    let scores = score(&log);
    let state = if scores.finished >= scores.planned { "complete" } else { "incomplete" };
    let successes = log.episodes.iter().filter(|record| record.is_success()).count();
    let finished = log.episodes.len();
    // Episodes of streams have no rate in common.
    let has_rate = finished > 0 && log.manifest.settings.stream.is_none();
    let sr = has_rate.then(|| format!("{:.1}", 100.0 * successes as f64 / finished as f64));
    vec![
        name,
        json!(log.manifest.settings.suite.word()),
        json!(log.manifest.policy_label().to_string()),
        json!(log.sessions.first().map(|session| date(session.unix_s))),
        json!(state),
        json!(scores.finished),
        json!(scores.planned),
        json!(log.errors.len()),
        json!(sr),
    ]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use conditions::PolicyKind;
    use rigs::records::manifest;
    use run_log::{RunFolder, SessionEvent};

    use super::*;

    #[test]
    fn a_run_is_listed_with_the_name_of_its_policy_and_a_date() {
        let dir = tempfile::tempdir().unwrap();
        let mut manifest = manifest();
        manifest.settings.policy = PolicyKind::External;
        let facts = BTreeMap::from([("policy".to_owned(), "top-three".to_owned())]);
        manifest.processes.insert("policy".to_owned(), facts);
        let opened = RunFolder::open(&dir.path().join("run"), manifest, false).unwrap();
        let mut folder = opened.folder;
        folder.note(SessionEvent::Failed { generation: 1, reason: "test".to_owned() }).unwrap();
        drop(folder);
        let listing = runs(Some(dir.path())).unwrap();
        let cell = |name| {
            let column = listing.header.iter().position(|header| *header == name).unwrap();
            listing.rows[0][column].as_str().unwrap().to_owned()
        };
        assert_eq!(cell("policy"), "external (top-three)");
        let year = cell("started").split_once('-').unwrap().0.parse::<u32>().unwrap();
        assert!((2024..2100).contains(&year), "{}", cell("started"));
    }
}
