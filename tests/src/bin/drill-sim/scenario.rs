//! Small runs: a warehouse of 12 x 12 cells, few cases, episodes of few steps.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use case_book::{BookFile, BookRequest};
use conditions::Mismatch;
use conditions::settings::RunSettings;
use orchestrator::books::Books;
use orchestrator::external_memory::ExternalMemory;
use orchestrator::plan::PlannedEpisode;
use orchestrator::selection::SelectedCases;
use settings::{Layer, resolve};
use sim_proc::worlds::Worlds;
use warehouse::case_book::write_books;
use warehouse::case_file::CASES_FILE;
use warehouse::{CATALOGUE_FILE, CaseSet, GeneratedWorld, LAYOUT_FILE, StreamSet};

use crate::external;

/// The case book, written in this process.
fn write(request: &BookRequest) -> Result<Books> {
    let books = write_books(request)?;
    Ok(Books {
        cases: BookFile::new(books.cases)?,
        demonstrations: BookFile::new(books.demonstrations)?,
        streams: books.streams,
        elsewhere: books.elsewhere,
    })
}

/// The seed of the warehouse.
const WORLD_SEED: u64 = 3;

/// Cells of the warehouse, along each side.
const SIDE: usize = 12;

const COMMON: &str = r#"
cases = ["all"]
runs = 1
window = [3]
horizon = 3
keyframes = 8
max-steps = 7
frame-size = 64
encoder = "dinov2-s14"
"#;

/// Name and suite of each; those called `external...` have an external memory, too.
const SUITES: [(&str, &str); 5] = [
    (
        "paper",
        r#"
memory = ["working", "full-context", "episodic"]
starts = ["original", "new"]
routes = ["unchanged"]
demos = ["original"]
limit = 2
"#,
    ),
    (
        "blocked",
        r#"
memory = ["episodic"]
starts = ["new"]
routes = ["blocked"]
demos = ["original", "4"]
limit = 3
"#,
    ),
    (
        "stream",
        r#"
memory = ["episodic", "adaptive"]
arms = ["frozen", "learning"]
starts = ["new"]
routes = ["unchanged"]
demos = ["original"]

[stream]
streams = 1
blocks = 2
cases-per-block = 1
events = ["close"]
rounds = 2
orders = ["drawn"]
feedback = "success"
evaluate = false
"#,
    ),
    (
        "external",
        r#"
memory = ["episodic"]
starts = ["original", "new"]
routes = ["unchanged"]
demos = ["original", "4"]
limit = 2
"#,
    ),
    (
        "external-stream",
        r#"
memory = ["working"]
arms = ["frozen", "learning"]
starts = ["new"]
routes = ["unchanged"]
demos = ["original"]

[stream]
streams = 1
blocks = 2
cases-per-block = 1
events = ["close"]
rounds = 2
orders = ["drawn"]
feedback = "success"
evaluate = true
"#,
    ),
];

/// A run that trials execute.
pub(crate) struct Scenario {
    pub(crate) name: &'static str,
    pub(crate) settings: RunSettings,
    pub(crate) memories: Vec<ExternalMemory>,
    pub(crate) selected: SelectedCases,
    pub(crate) episodes: Vec<PlannedEpisode>,
    pub(crate) worlds: Worlds,
    pub(crate) assets: PathBuf,
}

impl Scenario {
    /// All scenarios, with their files in `folder`.
    pub(crate) fn all(folder: &Path) -> Result<Vec<Self>> {
        let assets = folder.join("assets");
        fs::create_dir_all(&assets)?;
        let world = GeneratedWorld::generate(WORLD_SEED, SIDE, SIDE, None)?;
        let cases = CaseSet::generate(&world.warehouse, WORLD_SEED, 10)?;
        let texts = [world.layout, world.catalogue, cases.to_toml(&world.warehouse.catalogue)];
        for (file, text) in [LAYOUT_FILE, CATALOGUE_FILE, CASES_FILE].into_iter().zip(texts) {
            fs::write(assets.join(file), text)?;
        }
        SUITES.iter().map(|(name, suite)| Self::new(name, suite, folder, &assets)).collect()
    }

    fn new(name: &'static str, suite: &str, folder: &Path, assets: &Path) -> Result<Self> {
        let file = folder.join(format!("{name}.toml"));
        fs::write(&file, format!("{COMMON}{suite}"))?;
        let text = |path: &Path| path.display().to_string();
        let flags = [
            ("suite", text(&file)),
            // The digest policy uses what memory supplies, as this one does.
            ("policy", "grounded".to_owned()),
            ("assets", text(assets)),
            ("out", text(&folder.join("run"))),
            ("step-timeout", "30".to_owned()),
            ("start-timeout", "60".to_owned()),
        ];
        let is_external = name.starts_with("external");
        let command = is_external.then_some(("memory-cmd", external::NAME));
        let flags = flags.iter().map(|(key, value)| (*key, &**value)).chain(command);
        let layer = Layer::flags(flags)?;
        let mut settings = resolve([layer]).context(name)?.settings;
        let selected = SelectedCases::written_by(write, &settings).context(name)?;
        let memories = if is_external { vec![external::memory()?] } else { Vec::new() };
        let told = memories.iter().map(|memory| (memory.name, memory.description.learns));
        settings.add_external_memories(&told.collect::<Vec<_>>());
        let episodes = selected.with_episodes(&settings, |episodes| episodes.collect());
        let (warehouse, cases) = CaseSet::with_warehouse(Some(assets))?;
        let states = match &selected.books.streams {
            Some(text) => StreamSet::parse(text, &warehouse, &cases)?.states(&warehouse)?,
            None => Vec::new(),
        };
        let mismatches: Vec<Mismatch> = settings.mismatches().collect();
        let worlds = Worlds::new(&warehouse, &cases, states, &mismatches);
        let assets = assets.to_owned();
        Ok(Self { name, settings, memories, selected, episodes, worlds, assets })
    }
}
