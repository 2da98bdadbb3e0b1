//! Documents built by the whole program from rendered views, compared with the warehouse, and supplied in a
//! run. A test may know the map; the builder does not.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use domain::{Cell, Demonstrations, Pose};
use memtransfer_tests::{Bench, Ended, eventually};
use plates::Plate;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use warehouse::sight::sees;
use warehouse::{CaseSet, TrajectoryKind, Warehouse};

use crate::real_server::stored;

/// A line under "Items": standpoint, letter of the heading, and the plate's digits.
type Bay = ((Cell, char), String);

/// A place where an item is reached, the plate there, and how the item may be called.
struct Truth {
    warehouse: Warehouse,
    cases: CaseSet,
    bays: BTreeMap<(Cell, char), (Plate, String, String)>,
}

impl Truth {
    fn new() -> Self {
        let warehouse = Warehouse::shipped();
        let bays = warehouse.items.iter().map(|item| {
            let item_type = &warehouse.catalogue.types[item.item_type];
            let category = &warehouse.catalogue.categories[item_type.category];
            let place = (item.standpoint, item.viewing_heading().letter());
            let plate = Plate::new(&category.name, &item_type.name);
            (place, (plate, item_type.name.clone(), category.name.clone()))
        });
        let bays = bays.collect();
        Self { warehouse, cases: CaseSet::shipped(), bays }
    }

    /// Every pose of the demonstrations of `selection`.
    fn poses(&self, selection: Demonstrations) -> BTreeSet<Pose> {
        let histories = (0..self.cases.cases.len())
            .flat_map(|case| self.cases.histories(case, selection))
            .collect::<BTreeSet<_>>();
        let demonstrated = |of| self.cases.demonstrated(&self.warehouse, of).unwrap();
        histories.into_iter().flat_map(|of| demonstrated(of).replay().poses).collect()
    }

    /// Where the experts of `selection` reached items that were asked for.
    fn targets(&self, selection: Demonstrations) -> BTreeSet<Cell> {
        let mut targets = BTreeSet::new();
        for case in &self.cases.cases {
            let wanted = case.task.targets(&self.warehouse);
            for kind in selection.own().filter_map(TrajectoryKind::demonstration) {
                let replay = case.replay(&self.warehouse, kind);
                let cells = replay.goal_steps.iter().map(|&step| replay.poses[step as usize].cell);
                let is_target = |cell: &Cell| wanted.iter().any(|item| item.standpoint == *cell);
                targets.extend(cells.filter(is_target));
            }
        }
        targets
    }
}

/// The document whose file name is `name` and an address.
fn document(folder: &Path, name: &str) -> (Value, String) {
    let json = fs::read_to_string(stored(folder, name).unwrap()).unwrap();
    let value: Value = serde_json::from_str(&json).unwrap();
    (value["provenance"].clone(), value["text"].as_str().unwrap().to_owned())
}

fn section<'a>(text: &'a str, heading: &str) -> Vec<&'a str> {
    let after = text.split_once(&format!("## {heading}\n")).unwrap().1;
    let section = after.split_once("\n## ").map_or(after, |(section, _)| section);
    section.lines().filter(|line| !line.is_empty()).collect()
}

fn cell(text: &str) -> Cell {
    let (x, y) = text.trim_matches(['(', ')']).split_once(", ").unwrap();
    Cell::new(x.parse().unwrap(), y.parse().unwrap())
}

/// The bays of a summary, with the names of their items.
fn items(summary: &str) -> Vec<(Bay, String)> {
    let mut items = Vec::new();
    for line in section(summary, "Items") {
        let (label, rest) = line.strip_prefix("- ").unwrap().split_once(" [plate ").unwrap();
        let (digits, places) = rest.split_once("]: ").unwrap();
        for place in places.split("; ") {
            let (at, face) =
                place.strip_prefix("stand at ").unwrap().split_once(" facing ").unwrap();
            let bay = ((cell(at), face.chars().next().unwrap()), digits.to_owned());
            items.push((bay, label.to_owned()));
        }
    }
    items
}

/// The cells of the lines under "Passages".
fn passages(summary: &str) -> BTreeSet<Cell> {
    let mut cells = BTreeSet::new();
    for line in section(summary, "Passages") {
        let (what, range) = line.strip_prefix("- ").unwrap().split_once(": ").unwrap();
        let at: u8 = what.split_once(' ').unwrap().1.parse().unwrap();
        let (from, to) = range.split_once(' ').unwrap().1.split_once('-').unwrap();
        for along in from.parse::<u8>().unwrap()..=to.parse().unwrap() {
            let is_column = what.starts_with("column");
            cells.insert(if is_column { Cell::new(at, along) } else { Cell::new(along, at) });
        }
    }
    cells
}

fn digits(plate: Plate) -> String {
    let of = |bands: &[u8]| bands.iter().map(u8::to_string).collect::<String>();
    format!("{}-{}", of(&plate.0[..3]), of(&plate.0[3..]))
}

#[test]
fn documents_contain_what_their_demonstrations_show_and_nothing_else() {
    let (bench, truth) = (Bench::new(), Truth::new());
    let build =
        ["memory", "build", "--demos", "original,4", "--plates", "on", "--out", "documents"];
    let built = bench.run(&build).expect(0);
    assert!(built.stderr.contains("4 built, 0 current"), "{}", built.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
    let folder = bench.out("documents");

    for selection in [Demonstrations::ORIGINAL, Demonstrations::ALL] {
        let (provenance, summary) = document(&folder, &format!("summary-{selection}"));
        let poses = truth.poses(selection);
        assert_eq!(provenance["views"].as_u64(), Some(poses.len() as u64));
        assert_eq!(provenance["trajectories"].as_u64(), Some(100 * selection.own().count() as u64));

        // Every item exists, is called by its own name, and is in sight of a demonstration.
        let items = items(&summary);
        for ((place, said), label) in &items {
            let (plate, item_type, category) = &truth.bays[place];
            assert_eq!(*said, digits(*plate), "{selection}: {place:?}");
            let names = [item_type.clone(), format!("{category} item"), "item".to_owned()];
            assert!(names.contains(label), "{selection}: {label} is a {item_type}");
            let item = truth
                .warehouse
                .items
                .iter()
                .find(|item| (item.standpoint, item.viewing_heading().letter()) == *place);
            let in_sight = |pose: &Pose| sees(&truth.warehouse, *pose, item.unwrap());
            assert!(poses.iter().any(in_sight), "{selection}: {place:?} was in no frame");
        }
        // Passages are cells that were walked; nothing comes from the references alone.
        let walked: BTreeSet<Cell> = poses.iter().map(|pose| pose.cell).collect();
        assert_eq!(passages(&summary), walked);

        let told: BTreeSet<Cell> = items.iter().map(|(((cell, _), _), _)| *cell).collect();
        let targets = truth.targets(selection);
        let missed: Vec<_> = targets.difference(&told).collect();
        assert!(targets.len() > 50, "{} targets", targets.len());
        assert!(
            20 * missed.len() <= targets.len(),
            "{selection}: missed {missed:?} of {}",
            targets.len()
        );
        let routes = section(&summary, "Routes");
        assert!(routes.iter().all(|route| !route.contains("reached a target")), "{selection}");
        let starts: BTreeSet<String> = truth
            .cases
            .cases
            .iter()
            .flat_map(|case| {
                selection.own().filter_map(TrajectoryKind::demonstration).map(|kind| {
                    let Pose { cell, heading } = case.trajectory(kind).start;
                    format!("from {cell} facing {}:", heading.letter())
                })
            })
            .collect();
        assert!(routes.iter().all(|route| starts.iter().any(|start| route.contains(start))));

        let (_, semantic) = document(&folder, &format!("semantic-{selection}"));
        assert!(!semantic.contains("stand at") && !semantic.contains("Find "), "{semantic}");
        for category in &truth.warehouse.catalogue.categories {
            let of = |line: &&&str| line.starts_with(&format!("- {} [plate ", category.name));
            assert!(
                section(&semantic, "Where kinds of items stand").iter().filter(of).count() <= 3
            );
        }
    }

    let again = bench.run(&build).expect(0);
    assert!(again.stderr.contains("0 built, 4 current"), "{}", again.stderr);
    // They are current for frames that look like theirs.
    let list = ["memory", "ls", "--documents", "documents", "--json"];
    for (plates, state) in [("on", "current"), ("off", "outdated")] {
        let listed = bench.run(&[&list[..], &["--plates", plates]].concat()).expect(0);
        let listed: Vec<Value> = serde_json::from_str(&listed.stdout).unwrap();
        assert!(listed.len() == 4 && listed.iter().all(|document| document["state"] == state));
    }
    let show = ["memory", "show", "summary", "4", "--documents", "documents", "--plates", "on"];
    assert_eq!(bench.run(&show).expect(0).stdout, document(&folder, "summary-4").1);

    supplied_in_a_run(&bench, &folder);
}

/// A signal while a run builds its documents is answered with what was kept and how to go on.
#[test]
fn a_run_that_is_stopped_while_it_builds_documents_says_so() {
    let bench = Bench::new();
    let mut command = bench.command(&["run", "--policy", "random", "--memory", "summary"]);
    let cache = bench.out("cache");
    let child = command.args(["--limit", "1"]).env("MEMTRANSFER_CACHE", &cache).spawn().unwrap();
    eventually("the build to begin", || cache.join("documents/logs").exists().then_some(()));
    let pid = Pid::from_child(&child);
    kill_process(pid, Signal::TERM).unwrap();
    let ended = Ended::of(child).expect(128 + 15);
    for said in ["stopped by SIGTERM while documents were being built", "--memory summary"] {
        assert!(ended.stderr.contains(said), "{}", ended.stderr);
    }
    assert!(!ended.stderr.contains("documents: done"), "{}", ended.stderr);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// A run reads the documents, copies them, records which they were, and resumes with its own copies.
fn supplied_in_a_run(bench: &Bench, folder: &Path) {
    let mut args = vec!["run", "--policy", "random", "--memory", "hybrid", "--demos", "original"];
    args.extend(["--starts", "new", "--limit", "1", "--max-steps", "5", "--out", "out"]);
    args.extend(["--documents", "./documents", "--plates", "on"]);
    bench.run(&args).expect(0);
    let read = |name: &str| {
        let text = fs::read_to_string(bench.out("out").join(name)).unwrap();
        serde_json::from_str::<Value>(&text).unwrap()
    };
    let manifest = read("manifest.json");
    for kind in ["summary", "semantic"] {
        let (provenance, text) = document(folder, &format!("{kind}-original"));
        let facts = &manifest["documents"][&format!("{kind}/original")];
        assert_eq!(facts["sha256"], provenance["text_sha256"]);
        assert_eq!(
            (&facts["builder"], facts["bytes"].as_u64()),
            (&Value::from("extractive"), Some(text.len() as u64),)
        );
        assert_eq!(read(&format!("documents/{kind}-original.json"))["text"], text);
    }
    // What the run was supplied with is its own; a document that was changed there is not supplied.
    fs::remove_dir_all(folder).unwrap();
    bench.run(&args).expect(0);
    // A dry run of the finished run has the same settings and documents.
    let dry = bench.run(&[&args[..], &["--dry-run"]].concat()).expect(0);
    assert!(dry.stdout.contains("\n0 of 1 episodes"), "{}", dry.stdout);
    let late = bench.run(&[&args[..], &["--log-prompts"]].concat()).expect(0);
    assert!(late.stderr.contains("nothing is logged, because all 1 episodes"), "{}", late.stderr);
    let own = bench.out("out").join("documents/summary-original.json");
    let changed = fs::read_to_string(&own).unwrap().replacen("Items", "Itens", 1);
    fs::write(&own, changed).unwrap();
    let refused = bench.run(&args).expect(2);
    assert!(refused.stderr.contains("memtransfer memory build"), "{}", refused.stderr);
}
