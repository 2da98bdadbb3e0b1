//! Run folders, and what is made of them.

use std::cell::RefCell;
use std::fs;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;
use std::sync::OnceLock;

use orchestrator::status::LiveStatus;
use orchestrator::units::UnitPlan;
use report::Published;
use run_log::latency::LatencyRecord;
use run_log::step_view::PromptLog;
use run_log::{
    Manifest, PlannedFacts, RunFolder, RunLog, UnitEpisode, UnitFolders, merge, read_journal,
    unit_folder,
};
use scores::compare::compare_runs;
use scores::score;
use serde_json::Value;
use viewer::Site;
use warehouse::RunWorlds;
use warehouse::act::Stage;
use world_client::{Asker, RecordedRun, WorldAccess, WorldFiles, WorldProgram};

use crate::files::with_files;
use crate::input::files;

/// A run of six episodes, cut down to what its pages show.
const RUN: &[u8] = include_bytes!("../../corpus/run-folder/quick");

/// The files of [`RUN`].
fn given() -> &'static [(&'static str, &'static [u8])] {
    static FILES: OnceLock<Vec<(&str, &[u8])>> = OnceLock::new();
    FILES.get_or_init(|| files(RUN))
}

const JOURNALS: [&str; 8] = [
    "manifest.json",
    "episodes.jsonl",
    "timings.jsonl",
    "requests.jsonl",
    "errors.jsonl",
    "sessions.jsonl",
    "latency.jsonl",
    "status.json",
];

/// Of so many inputs, one has its scores and pages made while fuzzing: they take many times as long as reading.
const SHOWN: u64 = 16;

/// Whether what is made of the run in `input` is looked at, too. Always in tests.
fn is_shown(input: &[u8]) -> bool {
    let mut hasher = DefaultHasher::new();
    input.hash(&mut hasher);
    !cfg!(feature = "libfuzzer") || hasher.finish().is_multiple_of(SHOWN)
}

/// A run is refused, or scored; its report has no element that a text of the run has made.
pub(crate) fn run(input: &[u8]) {
    with_files(given(), &JOURNALS, input, |folder| {
        let _ = LiveStatus::read(folder).map(|status| status.map(|status| status.line()));
        let _ = read_journal::<LatencyRecord>(&folder.join("latency.jsonl"), |_| Ok(()));
        let Ok(log) = RunLog::read(folder) else { return };
        for record in &log.episodes {
            record.check(log.manifest.settings.max_steps).unwrap();
        }
        if is_shown(input) {
            let scores = score(&log);
            assert!(scores.finished <= log.episodes.len());
            let _ = report::summary(&log);
            // Of another folder: a run is not compared with itself.
            let again = RunLog { dir: folder.join("again"), ..log.clone() };
            let _ = compare_runs(&log, &again);
            let page = report::page(&report::document(std::slice::from_ref(&log), &published()));
            is_harmless(&page.unwrap());
        }
        // It is opened for writing, and what is read afterwards is the same.
        let manifest = log.manifest.clone();
        if let Ok(opened) = RunFolder::open(folder, manifest, false) {
            let kept: Vec<_> = opened.finished.iter().map(|record| &record.key).collect();
            if !kept.is_empty() {
                assert_eq!(kept.len(), log.episodes.len());
                assert!(log.episodes.iter().all(|record| kept.contains(&&record.key)));
            }
            drop(opened);
            let again = RunLog::read(folder).unwrap();
            assert!(again.damaged.is_empty(), "{:?}", again.damaged);
        }
    });
}

fn published() -> Published {
    Published::paper().unwrap()
}

/// A page that no text of a run has given a script or a handler.
pub(super) fn is_harmless(page: &str) {
    let page = page.to_lowercase();
    for bad in ["<script", "<img src=x", "<iframe", "javascript:"] {
        assert!(!page.contains(bad), "the page has {bad}");
    }
}

/// A plan is refused, or its units are within it, and it is written and read back equal.
pub(crate) fn plan(input: &[u8]) {
    let path = Path::new("plan.json");
    let Ok(read) = UnitPlan::parse(input, path) else { return };
    for number in [0, 1, read.plan.units - 1, read.plan.units, u32::MAX] {
        if let Ok((_, episodes)) = read.unit(number) {
            assert!(episodes.end <= read.plan.manifest.episodes as usize);
        }
    }
    let text = serde_json::to_vec_pretty(&read.plan).unwrap();
    assert_eq!(UnitPlan::parse(&text, path).unwrap().plan, read.plan);
    let made = UnitPlan::new(read.plan.manifest.clone(), 7);
    assert!(made.units > 0 || made.manifest.episodes == 0);
}

/// Two units, each a run folder. They are refused, or merged into a run that is read without damage.
pub(crate) fn merged(input: &[u8]) {
    let units = [unit_folder(0), unit_folder(1)];
    let names: Vec<String> = units
        .iter()
        .flat_map(|unit| JOURNALS.map(|file| format!("{unit}/{file}")))
        .chain(["plan.json".to_owned()])
        .collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let first: Vec<(String, &[u8])> =
        given().iter().map(|(name, content)| (format!("{}/{name}", units[0]), *content)).collect();
    let first: Vec<(&str, &[u8])> =
        first.iter().map(|(name, content)| (name.as_str(), *content)).collect();
    with_files(&first, &names, input, |folder| {
        let Ok(mut manifest) = Manifest::read(&folder.join(&units[0])) else { return };
        let out = folder.join("merged");
        let folders = UnitFolders(vec![folder.to_owned()]);
        let plan = manifest.unit.as_ref().map_or(String::new(), |unit| unit.plan.clone());
        manifest.unit = None;
        let _ = folders.check(2, &plan, &mut manifest);
        let episodes: Vec<UnitEpisode> = (0..2)
            .filter_map(|unit| {
                Some((unit, RunLog::read(&folder.join(&units[unit as usize])).ok()?))
            })
            .flat_map(|(unit, log)| {
                log.episodes.into_iter().map(move |record| {
                    let facts = PlannedFacts::of(&record);
                    UnitEpisode { key: record.key, unit, facts }
                })
            })
            .collect();
        let count = episodes.len() as u64;
        if let Ok(merged) = merge(&manifest, &folders, episodes, &out) {
            assert_eq!(merged, count);
            let log = RunLog::read(&out).unwrap();
            assert!(log.episodes.len() as u64 <= count);
        }
    });
}

/// The program that renders views is not there: a view is an error.
fn program() -> WorldProgram {
    WorldProgram {
        path: "/nonexistent/sim-proc".into(),
        arguments: Vec::new(),
        world_cmd: None,
        variable: ("UNUSED", ""),
    }
}

/// The worlds of a run, in this process.
fn access() -> WorldAccess {
    WorldAccess::new(|log| {
        let WorldFiles { assets, streams, elsewhere } = WorldFiles::of(log);
        let [assets, streams, elsewhere] = [&assets, &streams, &elsewhere].map(Option::as_deref);
        let mut stage = Stage::new(RunWorlds::read(assets, streams, elsewhere)?);
        Ok(Asker::new(move |request| Ok(stage.answer(request))))
    })
}

fn site(folder: &Path) -> Option<Site> {
    Site::new(vec![RecordedRun::read(folder, &access()).ok()?], &program(), true).ok()
}

/// Files beside a run that no page may show.
const SECRET: &str = "a secret beside the run";

/// A run is refused, or every page of it is data that the front end can read, and shows nothing from outside of the run.
pub(crate) fn viewer_run(input: &[u8]) {
    let names =
        [&JOURNALS[..], &["streams.json", "prompts/session-1/", "prompts/documents/"]].concat();
    with_files(given(), &names, input, |folder| {
        let outside = folder.with_file_name("secret");
        for extension in ["txt", "json", "png"] {
            let file = outside.with_extension(extension);
            if !file.exists() {
                fs::write(file, format!("\"{SECRET}\"")).unwrap();
            }
        }
        let Ok(run) = RecordedRun::read(folder, &access()) else { return };
        let mut prompts = PromptLog::of(&run.log);
        for timings in run.log.timings.iter().take(3) {
            let _ = prompts.entry(timings, 0);
        }
        if !is_shown(input) {
            return;
        }
        let episodes = run.log.episodes.len().min(3);
        let Ok(mut site) = Site::new(vec![run], &program(), true) else { return };
        let mut paths: Vec<String> =
            ["run.js", "report.html", "new.json?from=0", "maps/0.svg", "maps/1.svg"]
                .map(|file| format!("run1/{file}"))
                .into();
        for number in 0..episodes {
            paths.push(format!("run1/episodes/{number}.js"));
            paths.push(format!("run1/prompts/{number}.js"));
        }
        for path in &paths {
            let Ok(Some(file)) = site.file(path) else { continue };
            let text = String::from_utf8(file.bytes).unwrap();
            assert!(!text.contains(SECRET), "{path} shows a file from outside of the run");
            match file.kind {
                "text/javascript" => is_data(&text),
                "application/json" => drop(serde_json::from_str::<Value>(&text).unwrap()),
                _ => is_harmless(&text),
            }
        }
    });
}

/// A script that passes one value to the front end, and does nothing else.
fn is_data(script: &str) {
    let call = script.strip_prefix("memtransfer.receive(").unwrap();
    let arguments = call.strip_suffix(");\n").unwrap();
    let read: Value = serde_json::from_str(&format!("[{arguments}]")).unwrap();
    assert_eq!(read.as_array().unwrap().len(), 2);
}

/// A path is that of a file of the site or of none, and never one outside of it.
pub(crate) fn viewer_path(input: &[u8]) {
    thread_local! {
        static SITE: RefCell<Option<(Site, tempfile::TempDir)>> = const { RefCell::new(None) };
    }
    let Ok(path) = str::from_utf8(input) else { return };
    SITE.with_borrow_mut(|made| {
        let (site, _) = made.get_or_insert_with(|| {
            let folder = tempfile::tempdir().unwrap();
            let run = folder.path().join("run");
            fs::create_dir(&run).unwrap();
            fs::write(folder.path().join("secret"), SECRET).unwrap();
            for (name, content) in given() {
                fs::write(run.join(name), content).unwrap();
            }
            fs::write(run.join("secret.txt"), SECRET).unwrap();
            (site(&run).unwrap(), folder)
        });
        if let Ok(Some(file)) = site.file(path) {
            let secret = SECRET.as_bytes();
            assert!(!file.bytes.windows(secret.len()).any(|part| part == secret), "{path}");
            let place = path.split('?').next().unwrap_or_default();
            assert!(!place.contains(".."), "{path:?} leads out of the site, and is answered");
        }
    });
}
