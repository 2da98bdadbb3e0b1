//! Verbs of `memtransfer` that only the world can answer: checks, maps, generated files, lists.

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use case_book::BookRequest;
use domain::Mixture;
use serde_json::{Value, json};
use warehouse::validate::ConstraintResult;
use warehouse::{
    CaseSet, Elsewhere, GeneratedWorld, Overlap, StreamSet, TrajectoryKind, Warehouse, map,
};

use crate::first_views::{first_views, shown_targets};

/// The folder of the world's files.
#[derive(Debug, clap::Args)]
pub struct AssetsArgs {
    /// The folder with layout.toml, catalogue.toml and cases.toml, instead of what is compiled in.
    #[arg(long, value_name = "DIR")]
    assets: Option<PathBuf>,
}

impl AssetsArgs {
    fn load(&self) -> Result<(Warehouse, CaseSet)> {
        Ok(CaseSet::with_warehouse(self.assets.as_deref())?)
    }
}

/// Arguments of `sim-proc validate`.
#[derive(Debug, clap::Args)]
pub struct ValidateArgs {
    #[command(flatten)]
    world: AssetsArgs,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Checks every constraint on warehouse and cases by replay, and the first views by rendering them. Status 1 when one is
/// violated.
///
/// # Errors
/// Assets that cannot be used.
pub fn validate(args: &ValidateArgs) -> Result<ExitCode> {
    let (warehouse, cases) = args.world.load()?;
    let mut report = warehouse::validate(&warehouse, &cases);
    let views = first_views(&warehouse, &cases);
    report.lines.push(ConstraintResult {
        constraint: "rendered: no pixel of a target in the first views",
        checked: views.len(),
        violations: shown_targets(&warehouse, &views)
            .context("the first views cannot be rendered")?,
    });
    print(&match args.json {
        true => serde_json::to_string_pretty(&report)?,
        false => {
            let cases = cases.cases.len();
            let trajectories = cases * TrajectoryKind::ALL.len();
            let violations = report.violations();
            format!("{report}{cases} cases, {trajectories} trajectories, {violations} violations")
        }
    })?;
    Ok(if report.is_clean() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Arguments of `sim-proc map`.
#[derive(Debug, clap::Args)]
pub struct MapArgs {
    /// The case, by id.
    case: Option<String>,
    /// The other warehouse, drawn from this seed.
    #[arg(long, value_name = "SEED", conflicts_with = "case")]
    elsewhere: Option<u64>,
    #[command(flatten)]
    world: AssetsArgs,
}

/// Prints the warehouse, a case or the other warehouse from above, as SVG.
///
/// # Errors
/// Assets that cannot be used, an unknown case.
pub fn draw_map(args: &MapArgs) -> Result<()> {
    let (warehouse, cases) = args.world.load()?;
    print(&match (&args.case, args.elsewhere) {
        (Some(id), _) => {
            let case = cases.case(id).with_context(|| format!("there is no case {id}"))?;
            map::svg(&warehouse, case)
        }
        (None, Some(seed)) => {
            map::floor_svg(Elsewhere::generate(&warehouse, &cases, seed)?.warehouse())
        }
        (None, None) => map::floor_svg(&warehouse),
    })
}

/// Arguments of `sim-proc generate`.
#[derive(Debug, clap::Args)]
pub struct GenerateArgs {
    #[arg(long)]
    seed: u64,
    /// Number of cases.
    #[arg(long)]
    count: usize,
    /// Columns and rows: generate a warehouse, too.
    #[arg(long, num_args = 2)]
    size: Option<Vec<usize>>,
    /// Parallel aisles in each of its banks of racks.
    #[arg(long, requires = "size")]
    aisles: Option<usize>,
    #[command(flatten)]
    world: AssetsArgs,
}

/// Prints generated files as JSON: `cases`, and of a warehouse `layout`, `catalogue` and what it consists of in words,
/// `about`.
///
/// # Errors
/// A warehouse or cases that cannot be generated.
pub fn generate(args: &GenerateArgs) -> Result<()> {
    let Some(&[width, height]) = args.size.as_deref() else {
        // An existing case file is not read: it is to be replaced.
        let warehouse = match &args.world.assets {
            None => Warehouse::shipped(),
            Some(dir) => Warehouse::load(dir)?,
        };
        let cases = CaseSet::generate(&warehouse, args.seed, args.count)?;
        return print(&json!({ "cases": cases.to_toml(&warehouse.catalogue) }).to_string());
    };
    let world = GeneratedWorld::generate(args.seed, width, height, args.aisles)?;
    let GeneratedWorld { layout, catalogue, warehouse, .. } = world;
    let cases = CaseSet::generate(&warehouse, args.seed, args.count)?;
    let about = format!(
        "{width} x {height} cells, {} aisles, {} items in {} categories, {} cases",
        warehouse.layout.aisles().len(),
        warehouse.items.len(),
        warehouse.catalogue.categories.len(),
        cases.cases.len()
    );
    let cases = cases.to_toml(&warehouse.catalogue);
    let files = json!({ "layout": layout, "catalogue": catalogue, "cases": cases, "about": about });
    print(&files.to_string())
}

/// Arguments of `sim-proc list`.
#[derive(Debug, clap::Args)]
pub struct ListArgs {
    #[command(subcommand)]
    what: ListWhat,
}

#[derive(Debug, clap::Subcommand)]
enum ListWhat {
    /// The demonstrations of other tasks in each case's mixed sets: case, kind, history, instruction, shared poses, conflicts.
    Histories(AssetsArgs),
    /// The items: type, category, aisle, rack, standpoint, number.
    Items(AssetsArgs),
    /// The blocks of streams: stream, block, events before it, cases.
    Streams {
        /// What is drawn: a request for a case book, as JSON.
        request: String,
    },
}

/// Prints a list as JSON: an array for each row.
///
/// # Errors
/// Assets that cannot be used, streams that cannot be drawn.
pub fn list(args: &ListArgs) -> Result<()> {
    let rows: Vec<Value> = match &args.what {
        ListWhat::Histories(world) => {
            let (warehouse, cases) = world.load()?;
            histories(&warehouse, &cases)
        }
        ListWhat::Items(world) => items(&world.load()?.0),
        ListWhat::Streams { request } => {
            streams(&serde_json::from_str(request).context("this is no request for streams")?)?
        }
    };
    print(&serde_json::to_string(&rows)?)
}

fn histories(warehouse: &Warehouse, cases: &CaseSet) -> Vec<Value> {
    let listed = cases.cases.iter().enumerate().flat_map(|(index, case)| {
        let of = |mixture: Mixture| case.mixed(mixture).map(|history| (mixture, history));
        Mixture::ALL.into_iter().flat_map(of).map(move |(mixture, history)| {
            let source = cases.cases.get(history.case);
            let overlap = Overlap::of(warehouse, cases, index, history);
            json!([
                case.id,
                mixture.name(),
                source.map(|source| format!("{} {}", source.id, history.kind.name())),
                source.map(|source| source.task.instruction(&warehouse.catalogue)),
                overlap.map(|overlap| overlap.shared_poses),
                overlap.map(|overlap| overlap.conflicts),
            ])
        })
    });
    listed.collect()
}

fn items(warehouse: &Warehouse) -> Vec<Value> {
    let row = |item: &warehouse::Item| {
        let item_type = &warehouse.catalogue.types[item.item_type];
        json!([
            item_type.name,
            warehouse.catalogue.categories[item_type.category].name,
            warehouse.layout.aisle_name(item.standpoint),
            item.rack.to_string(),
            item.standpoint.to_string(),
            item.id,
        ])
    };
    warehouse.items.iter().map(row).collect()
}

fn streams(request: &BookRequest) -> Result<Vec<Value>> {
    let (warehouse, cases) = CaseSet::with_warehouse(request.assets.as_deref())?;
    let asked = request.streams.as_ref().context("the request has no streams")?;
    let among: Vec<usize> = request.cases.iter().filter_map(|id| cases.index(id)).collect();
    let set = StreamSet::draw(&warehouse, &cases, &among, asked.seed, &asked.rules)?;
    let blocks = set.streams.iter().enumerate().flat_map(|(number, stream)| {
        stream.blocks.iter().enumerate().map(move |(place, block)| (number, place, block))
    });
    let rows = blocks.map(|(number, place, block)| {
        let events = block.events.iter().map(|event| event.describe(&warehouse));
        let ids = block.cases.iter().map(|&case| cases.cases[case as usize].id.as_str());
        json!([number, place, events.collect::<Vec<_>>(), ids.collect::<Vec<_>>()])
    });
    Ok(rows.collect())
}

fn print(text: &str) -> Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{}", text.trim_end_matches('\n'))?;
    stdout.flush().context("cannot write to standard output")
}
