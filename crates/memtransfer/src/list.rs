//! `memtransfer ls`: lists cases, tasks, items, suites, conditions, streams and runs, and prints the template of the prompt.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use super::{Exit, WorldArgs, print, print_json};
use anyhow::{Context, bail, ensure};
use case_book::act::WorldDescription;
use case_book::{BookRequest, CaseFacts, StreamsRequest, WorldDeclaration};
use clap::{Args, Subcommand};
use conditions::Condition;
use conditions::settings::{RunSettings, StreamSettings};
use domain::{Route, Start};
use prompt::Template;
use report::table::table;
use run_log::RunLog;
use run_log::date::date;
use scores::score;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use settings::{Layer, SHIPPED_SUITES, cases_of_run, resolve};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memtransfer ls cases
  memtransfer ls cases --suite quick
  memtransfer ls --world-cmd ./my-world
  memtransfer ls items --json | jq '.[] | select(.category == \"barrels\")'
  memtransfer ls prompt > mine.toml
  memtransfer ls runs")]
pub(super) struct ListArgs {
    #[command(subcommand)]
    what: Option<ListWhat>,
    #[command(flatten)]
    world: WorldArgs,
    /// Print JSON
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum ListWhat {
    /// The world: what agents do, are told and see in it, and what it can do (the default)
    World,
    /// Cases: instruction, starting poses, lengths of the reference routes
    Cases {
        /// Only the cases that a run of this suite, by name or file, selects
        #[arg(long, value_name = "NAME|FILE")]
        suite: Option<String>,
    },
    /// The demonstrations of other tasks in each case's mixed sets
    Histories,
    /// The types of tasks
    Tasks,
    /// The items of the warehouse, with the cells in front of them
    Items,
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
    /// The built-in template of the prompt, to start one of your own from for `run --prompt`
    Prompt,
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
    let (world, describe) = (&args.world, || args.world.program()?.describe(&args.world.flags()));
    let listing = match args.what.as_ref().unwrap_or(&ListWhat::World) {
        ListWhat::World => the_world(&describe()?),
        ListWhat::Cases { suite: None } => {
            let world = describe()?;
            cases(&world.world.declaration, &world.cases)
        }
        ListWhat::Cases { suite: Some(suite) } => {
            let assets = world.assets.as_ref().map(|dir| dir.display().to_string());
            let assets = assets.as_deref().map(|dir| ("assets", dir));
            let settings = resolve([suite_layer(suite, assets)?])?.settings;
            ensure!(
                settings.own_world().is_none() || world.other.command().is_some(),
                "the suite {suite} names another world, which has to be asked: if you trust its program, give the command \
                 that starts it as --world-cmd"
            );
            let (declaration, selected) = selected_cases(&settings, world)?;
            cases(&declaration, &selected)
        }
        ListWhat::Histories => histories(world)?,
        ListWhat::Tasks => tasks(&describe()?),
        ListWhat::Items => items(world)?,
        ListWhat::Suites => suites()?,
        ListWhat::Conditions { suite } => conditions(suite)?,
        ListWhat::Streams { suite, seed } => streams(suite, *seed, world)?,
        ListWhat::Prompt => {
            // As the file is, whose end is a line end.
            print(Template::BUILT_IN_FILE.trim_end())?;
            return Ok(Exit::Complete);
        }
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

/// The settings of a suite. A policy that runs in any world is named, because nothing here depends on it.
fn suite_layer(suite: &str, assets: Option<(&str, &str)>) -> anyhow::Result<Layer> {
    Layer::flags([("suite", suite), ("policy", "imitate")].into_iter().chain(assets))
}

/// What the world says of itself, and the cases that a run with `settings` selects in it.
fn selected_cases(
    settings: &RunSettings,
    world: &WorldArgs,
) -> anyhow::Result<(WorldDeclaration, Vec<CaseFacts>)> {
    let WorldArgs { other, .. } = world;
    let world = WorldArgs { assets: settings.assets.clone(), other: other.clone() };
    let world = world.program()?.describe(&world.flags())?;
    let selected = cases_of_run(&world.world, &world.cases, settings)?;
    let selected = selected.into_iter().map(|index| world.cases[index].clone()).collect();
    Ok((world.world.declaration, selected))
}

/// A row for each part of what a world says of itself.
fn the_world(world: &WorldDescription) -> Listing {
    let WorldDescription { world: facts, cases, .. } = world;
    let WorldDeclaration { name, version, actions, state, feedback, .. } = &facts.declaration;
    let mut rows = vec![
        vec![json!("name"), json!(name)],
        vec![json!("version"), json!(version)],
        vec![
            json!("deterministic"),
            json!(if facts.declaration.is_deterministic { "yes" } else { "no" }),
        ],
    ];
    let mut add = |part: &str, text: String| rows.push(vec![json!(part), json!(text)]);
    for action in actions {
        add("action", format!("{} {}", action.letter, action.words));
    }
    for field in state {
        add("state", [std::slice::from_ref(&field.name), &field.words[..]].concat().join(" "));
    }
    for sentence in feedback {
        add("feedback", sentence.clone());
    }
    for group in &facts.groups {
        let is_in = |case: &&CaseFacts| facts.group_of(case.task) == Some(group.name.as_str());
        let count = cases.iter().filter(is_in).count();
        add("task group", format!("{}: {count} cases", group.name));
    }
    let has = |route| move |case: &&CaseFacts| case.reference(Start::New, route).is_some();
    let blocked = cases.iter().filter(has(Route::Blocked)).count();
    add("cases", format!("{}, {blocked} of them with a blocked route", cases.len()));
    Listing { header: vec!["part", "the world says"], numbers: 2, rows }
}

fn cases(world: &WorldDeclaration, cases: &[CaseFacts]) -> Listing {
    let row = |case: &CaseFacts| {
        let reference = |start, route| case.reference(start, route);
        let begin = |start| Some(world.state_text(&reference(start, Route::Unchanged)?.begin));
        let length = |start, route| Some(reference(start, route)?.length);
        vec![
            json!(case.id),
            json!(case.instruction),
            json!(begin(Start::Original)),
            json!(begin(Start::New)),
            json!(length(Start::Original, Route::Unchanged)),
            json!(length(Start::New, Route::Unchanged)),
            json!(length(Start::New, Route::Blocked)),
        ]
    };
    Listing {
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
        rows: cases.iter().map(row).collect(),
    }
}

/// The rows of a list that only the warehouse can make.
pub(super) fn list<T: DeserializeOwned>(
    world: &WorldArgs,
    what: &str,
    arguments: impl IntoIterator<Item = OsString>,
) -> anyhow::Result<Vec<T>> {
    let arguments: Vec<OsString> = [what.into()].into_iter().chain(arguments).collect();
    let (rows, _) = world.warehouse()?.print("list", &arguments)?;
    serde_json::from_str(&rows).context("sim-proc is another version")
}

fn histories(world: &WorldArgs) -> anyhow::Result<Listing> {
    let header = vec!["case", "kind", "history", "its instruction", "shared poses", "conflicts"];
    Ok(Listing { header, numbers: 4, rows: list(world, "histories", world.flags())? })
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
    Ok(Listing { header, numbers: 5, rows: list(world, "items", world.flags())? })
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
    // They are those of the warehouse.
    let world = WorldArgs::default().program()?.describe(&[])?;
    for (name, text) in SHIPPED_SUITES {
        let settings = resolve([Layer::flags([("suite", *name)])?])?.settings;
        let cases = cases_of_run(&world.world, &world.cases, &settings)?.len();
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
    let settings = resolve([suite_layer(suite, None)?])?.settings;
    if settings.stream.is_some() {
        bail!(
            "{suite} is a suite of streams: `memtransfer ls streams --suite {suite}` lists its blocks"
        );
    }
    let rows = settings.runs().into_iter().map(|(condition, runs)| {
        let Condition { memory, start, route, demonstrations, variation, mismatch, arm } =
            condition;
        vec![
            json!(memory.to_string()),
            json!(start.to_string()),
            json!(route.to_string()),
            json!(demonstrations.to_string()),
            json!(variation.segment.to_string()),
            json!(variation.hint.to_string()),
            json!(mismatch.to_string()),
            json!(arm.word()),
            json!(variation.window),
            json!(runs),
        ]
    });
    let header = vec![
        "memory", "starts", "routes", "demos", "segment", "hint", "mismatch", "arms", "window",
        "runs",
    ];
    Ok(Listing { header, numbers: 8, rows: rows.collect() })
}

/// The blocks of a suite's streams; a row for each event, or one for a block without.
fn streams(suite: &str, seed: Option<u64>, world: &WorldArgs) -> anyhow::Result<Listing> {
    world.warehouse()?;
    let seed = seed.map(|seed| seed.to_string());
    let flags = [("suite", Some(suite)), ("seed", seed.as_deref())];
    let flags = flags.into_iter().filter_map(|(name, text)| Some((name, text?)));
    let settings = resolve([Layer::flags(flags)?])?.settings;
    let stream = settings.stream.as_ref();
    let stream = stream.with_context(|| format!("the suite {suite} has no [stream] table"))?;
    let (_, among) = selected_cases(&settings, world)?;
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
        list(world, "streams", [serde_json::to_string(&request)?.into()])?;
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
