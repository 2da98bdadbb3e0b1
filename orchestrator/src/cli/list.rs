//! `memtransfer ls`: what there is.

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, Subcommand};
use serde_json::{Value, json};
use warehouse::{Mixture, Overlap, Start, Task};

use super::{Exit, WorldArgs, print, print_json};
use crate::settings::{Layer, Origin, load_suite, resolve, select_cases, shipped_suites};
use crate::world::World;
use results::log::RunLog;
use results::score::score;
use results::table::table;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  memtransfer ls cases
  memtransfer ls items --json | jq '.[] | select(.category == \"barrels\")'
  memtransfer ls runs")]
pub(super) struct ListArgs {
    #[command(subcommand)]
    what: What,
    /// Print JSON
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The cases: what is asked, and how long the references are
    Cases(WorldArgs),
    /// The demonstrations of other tasks that each case's mixed sets hold
    Histories(WorldArgs),
    /// The ten types of tasks
    Tasks(WorldArgs),
    /// The items in the warehouse, with where one stands to reach them
    Items(WorldArgs),
    /// The shipped suites: what each is for, and how much it runs
    Suites,
    /// The runs in a folder: how far each is, and how well it went
    Runs {
        /// The folder of run folders
        #[arg(default_value = "runs", value_name = "DIR")]
        dir: PathBuf,
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
        What::Cases(world) => cases(&world.load()?),
        What::Histories(world) => histories(&world.load()?),
        What::Tasks(world) => tasks(&world.load()?),
        What::Items(world) => items(&world.load()?),
        What::Suites => suites()?,
        What::Runs { dir } => runs(dir)?,
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

fn cases(world: &World) -> Listing {
    let rows = world.cases.cases.iter().map(|case| {
        let length = |start| json!(case.replay(&world.warehouse, start).length);
        vec![
            json!(case.id),
            json!(case.task.instruction(&world.warehouse.catalogue)),
            json!(case.original.start.to_string()),
            json!(case.test.start.to_string()),
            length(Start::Original),
            length(Start::Test),
            length(Start::Blocked),
        ]
    });
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
        rows: rows.collect(),
    }
}

fn histories(world: &World) -> Listing {
    let World { warehouse, cases, .. } = world;
    let listed = cases.cases.iter().enumerate().flat_map(|(index, case)| {
        let of = |mixture: Mixture| case.mixed(mixture).map(|history| (mixture, history));
        Mixture::ALL.into_iter().flat_map(of).map(move |(mixture, history)| {
            let source = cases.cases.get(history.case);
            let overlap = Overlap::of(warehouse, cases, index, history);
            vec![
                json!(case.id),
                json!(mixture.name()),
                json!(source.map(|source| format!("{} {}", source.id, history.start.name()))),
                json!(source.map(|source| source.task.instruction(&warehouse.catalogue))),
                json!(overlap.map(|overlap| overlap.shared_poses)),
                json!(overlap.map(|overlap| overlap.conflicts)),
            ]
        })
    });
    Listing {
        header: vec!["case", "kind", "history", "its instruction", "shared poses", "conflicts"],
        numbers: 4,
        rows: listed.collect(),
    }
}

fn tasks(world: &World) -> Listing {
    let cases = &world.cases.cases;
    let rows = (1..=10).map(|number| {
        let of_type = || cases.iter().filter(|case| case.task.number() == number);
        let example = of_type().next();
        vec![
            json!(format!("t{number:02}")),
            json!(Task::type_name(number)),
            json!(example.map(|case| case.task.group().name())),
            json!(example.map(|case| case.task.instruction(&world.warehouse.catalogue))),
            json!(of_type().count()),
        ]
    });
    Listing {
        header: vec!["task", "name", "group", "example", "cases"],
        numbers: 4,
        rows: rows.collect(),
    }
}

fn items(world: &World) -> Listing {
    let World { warehouse, .. } = world;
    let rows = warehouse.items.iter().map(|item| {
        let item_type = &warehouse.catalogue.types[item.item_type];
        vec![
            json!(item_type.name),
            json!(warehouse.catalogue.categories[item_type.category].name),
            json!(warehouse.layout.aisle_name(item.standpoint)),
            json!(item.rack.to_string()),
            json!(item.standpoint.to_string()),
            json!(item.id),
        ]
    });
    Listing {
        header: vec!["type", "category", "aisle", "rack", "standpoint", "item"],
        numbers: 5,
        rows: rows.collect(),
    }
}

fn suites() -> anyhow::Result<Listing> {
    // A suite opens with a comment that says what it is for.
    let about = |text: &str| {
        let comment = text.lines().take_while(|line| line.starts_with('#'));
        let about: Vec<&str> = comment
            .map(|line| line.trim_start_matches(['#', ' ']))
            .take_while(|line| !line.is_empty())
            .collect();
        about.join(" ")
    };
    let mut rows = Vec::new();
    let world = World::load(None)?;
    for (name, text) in shipped_suites() {
        let suite = (*name).parse()?;
        let layers =
            [(Origin::Default, Layer::defaults()), (Origin::Suite, load_suite(&suite, None)?)];
        let settings = resolve(layers)?.settings;
        let cases = select_cases(&world.case_ids(), &settings.cases, settings.limit)?.len();
        let conditions = settings.runs();
        let runs: u32 = conditions.iter().map(|(_, runs)| runs).sum();
        rows.push(vec![
            json!(name),
            json!(about(text)),
            json!(conditions.len()),
            json!(runs as usize * cases),
        ]);
    }
    Ok(Listing { header: vec!["suite", "about", "conditions", "episodes"], numbers: 2, rows })
}

fn runs(dir: &Path) -> anyhow::Result<Listing> {
    let mut rows = Vec::new();
    if dir.exists() {
        let entries = std::fs::read_dir(dir);
        let entries = entries.with_context(|| format!("cannot list {}", dir.display()))?;
        let mut folders = entries
            .map(|entry| entry.map(|entry| entry.path()))
            .collect::<Result<Vec<PathBuf>, _>>()?;
        folders.retain(|folder| folder.join("manifest.json").exists());
        folders.sort();
        rows = folders.iter().map(|folder| run_row(folder)).collect();
    }
    let header = vec!["run", "suite", "policy", "state", "finished", "planned", "given up", "SR"];
    Ok(Listing { header, numbers: 4, rows })
}

/// A run that cannot be read is listed all the same, with the reason.
fn run_row(folder: &Path) -> Vec<Value> {
    let name = json!(folder.display().to_string());
    let log = match RunLog::read(folder) {
        Ok(log) => log,
        Err(error) => {
            let mut row = vec![name, Value::Null, Value::Null, json!(error.to_string())];
            row.resize(8, Value::Null);
            return row;
        }
    };
    let scores = score(&log);
    let state = if scores.finished >= scores.planned { "complete" } else { "not complete" };
    let successes = log.episodes.iter().filter(|record| record.is_success()).count();
    let counted = scores.finished + scores.errored;
    let sr = (counted > 0).then(|| format!("{:.1}", 100.0 * successes as f64 / counted as f64));
    vec![
        name,
        json!(log.manifest.settings.suite.word()),
        json!(log.manifest.settings.policy),
        json!(state),
        json!(scores.finished),
        json!(scores.planned),
        json!(scores.errored),
        json!(sr),
    ]
}
