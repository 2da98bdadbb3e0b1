//! The example worlds, which others wrote, in short runs: `examples/worlds`.

use std::process::Command;

use memtransfer_tests::{Bench, Ended, needs, records, repository, sorted_log, words};
use serde_json::Value;

#[test]
fn the_page_of_worlds_shows_the_corridor() {
    let page = std::fs::read_to_string(repository("docs/own-world.md")).unwrap();
    let corridor = repository("python/examples/corridor_world.py");
    let corridor = std::fs::read_to_string(corridor).unwrap();
    assert!(page.contains(&format!("```python\n{corridor}```")), "the page shows another text");
}

/// The text of a document of a run.
fn document(bench: &Bench, out: &str, name: &str) -> String {
    let file = bench.out(out).join("documents").join(name);
    let document: Value = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    document["text"].as_str().unwrap().to_owned()
}

#[test]
fn documents_of_the_corridor_are_written_in_its_words() {
    let bench = Bench::new();
    let script = repository("python/examples/corridor_world.py");
    let world = format!("{} {}", needs::python().display(), script.display());
    let mut run = bench.command(&["run", "--world-cmd", &world, "--out", "out"]);
    run.args(words("--policy imitate --memory summary,semantic,hybrid --cases reach-7"));
    run.args(words("--frame-size 64 --max-steps 30")).env("PYTHONPATH", repository("python"));
    let ended = Ended::run(&mut run).expect(0);
    assert_eq!(records(&bench.out("out")).len(), 2 * 3);
    let summary = document(&bench, "out", "summary-original.json");
    let semantic = document(&bench, "out", "semantic-original.json");
    let visited = "\n## \"Walk to cell 7, then to cell 6.\"\n- start: You are in cell 2.\n- walk east 5\n\
                   - sub-goal 1 of 2: You are in cell 7.\n- walk west\n- sub-goal 2 of 2: You are in cell 6.\n";
    assert!(summary.contains(visited), "{summary}");
    assert!(semantic.contains("- walk west, 2 of 24 actions: cell 100 %\n"), "{semantic}");
    // A request under hybrid memory has both, and no images of memory.
    let bytes = (summary.len() + semantic.len()).to_string();
    let supplied = ["Hybrid", "(extractive)", "2.00", "0.00", &bytes];
    let mut lines = ended.stdout.lines().map(|line| line.split_whitespace().take(5));
    assert!(lines.any(|cells| cells.eq(supplied)), "{}", ended.stdout);
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

/// How the example world `name` is started.
fn world_command(name: &str) -> String {
    let script = repository(&format!("examples/worlds/{name}/world.py"));
    format!("{} {}", needs::world_python(name).display(), script.display())
}

/// `memtransfer run` in the example world `name`, of two cases on small frames, not started yet.
fn run(bench: &Bench, name: &str, cases: &str, line: &str) -> Command {
    let mut command =
        bench.command(&["run", "--world-cmd", &world_command(name), "--cases", cases]);
    command.args(words("--frame-size 64 --max-steps 60 --starts original,new"));
    command.args(words("--routes unchanged,blocked"));
    command.args(words(line)).env("PYTHONPATH", repository("python"));
    command
}

/// How the episodes of a run with this memory ended that began at `start` on `route`.
fn endings<'a>(records: &'a [Value], memory: &str, start: &str, route: &str) -> Vec<&'a str> {
    let is_of = |record: &&Value| {
        record["memory"] == memory && record["start"] == start && record["route"] == route
    };
    records.iter().filter(is_of).map(|record| record["ending"].as_str().unwrap()).collect()
}

#[test]
fn demonstrations_of_minigrid_are_imitated_and_its_log_depends_on_no_lanes() {
    demonstrations_are_imitated("minigrid", "g1-2-pick-up,g1-5-unlock");
}

/// Lanes of Miniworld draw in one process, with lists of drawing commands that they share.
#[test]
fn demonstrations_of_miniworld_are_imitated_and_its_log_depends_on_no_lanes() {
    demonstrations_are_imitated("miniworld", "b0-1-go-to,b2-4-pick-up");
}

/// Lanes of Meta-World share the model of a table, and the renderer.
#[test]
fn demonstrations_of_meta_world_are_imitated_and_its_log_depends_on_no_lanes() {
    demonstrations_are_imitated("metaworld", "push-8,press-14");
}

/// In a run of two cases, which is the same with one lane and with eight, and which `validate` confirms.
fn demonstrations_are_imitated(name: &str, cases: &str) {
    let bench = Bench::new();
    let line = "--policy imitate --memory full-context,episodic";
    // A memory of another process, which knows nothing of any world.
    let top_k = repository("examples/memories/top-k/memory.py");
    let top_k = format!("{} {}", needs::world_python(name).display(), top_k.display());
    for lanes in ["1", "8"] {
        let line = format!("{line} --lanes {lanes} --out {lanes}");
        let mut run = run(&bench, name, cases, &line);
        Ended::run(run.args(["--memory-cmd", &top_k])).expect(0);
    }
    let imitated = records(&bench.out("8"));
    assert_eq!(imitated.len(), 2 * 3 * 3);
    for memory in ["full-context", "episodic", "top-k"] {
        let demonstrated = endings(&imitated, memory, "original", "unchanged");
        assert_eq!(demonstrated, ["complete"; 2], "{memory}");
    }
    assert_eq!(sorted_log(&bench.out("1")), sorted_log(&bench.out("8")));
    // A log is true: every episode is acted out again.
    let world = world_command(name);
    let mut validate = bench.command(&["validate", "8"]);
    validate.env("MEMTRANSFER_WORLD_CMD", world).env("PYTHONPATH", repository("python"));
    let valid = Ended::run(&mut validate).expect(0).stdout;
    assert_eq!(valid, "18 episodes, 0 differences, 0 damaged lines\n");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn the_expert_of_minigrid_completes_every_reference() {
    the_expert_completes_every_reference("minigrid", "g0-3-put-next,g2-4-open");
}

#[test]
fn the_expert_of_miniworld_completes_every_reference() {
    the_expert_completes_every_reference("miniworld", "b0-5-put-next,b2-3-visit");
}

#[test]
fn the_expert_of_meta_world_completes_every_reference() {
    the_expert_completes_every_reference("metaworld", "reach-1,pick-place-10");
}

fn the_expert_completes_every_reference(name: &str, cases: &str) {
    let bench = Bench::new();
    let line = "--policy expert --memory working --out out";
    Ended::run(&mut run(&bench, name, cases, line)).expect(0);
    let records = records(&bench.out("out"));
    for (start, route) in [("original", "unchanged"), ("new", "unchanged"), ("new", "blocked")] {
        assert_eq!(endings(&records, "working", start, route), ["complete"; 2], "{start} {route}");
    }
    assert!(records.iter().all(|record| record["steps"] == record["reference"]), "{records:?}");
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn miniworld_draws_the_floor_below_and_red_first() {
    // Two metres east of the start stands a red box.
    let script = "import numpy, world\n\
        simulator = world.Miniworld()\n\
        simulator.begin(next(iter(simulator.cases())).data, (0, 5, 0), None)\n\
        pixels = numpy.zeros((64, 64, 4), numpy.uint8)\n\
        simulator.render(pixels)\n\
        red, green, blue, alpha = numpy.moveaxis(pixels.astype(int), -1, 0)\n\
        box = (red > 110) & (green + blue < 80)\n\
        print(box[:32].sum() == 0, box[32:].sum() > 100, (blue > red + 50).sum() == 0, (alpha == 255).all())";
    let mut python = Command::new(needs::world_python("miniworld"));
    python.args(["-B", "-c", script]).current_dir(repository("examples/worlds/miniworld"));
    python.env("PYTHONPATH", repository("python"));
    assert_eq!(Ended::run(&mut python).expect(0).stdout, "True True True True\n");
}

/// The corridor of `docs/own-world.md`, changed by the lines of a class body; started as a command.
fn corridor(bench: &Bench, body: &str) -> String {
    let script = bench.out("world.py");
    let path = repository("python/examples");
    let indented: String = body.lines().map(|line| format!("    {line}\n")).collect();
    let text = format!(
        "import sys\nsys.path.insert(0, {path:?})\nfrom corridor_world import *\n\nclass Changed(Corridor):\n{indented}    pass\n\nmain(Changed)\n"
    );
    std::fs::write(&script, text).unwrap();
    format!("{} {}", needs::world_python("minigrid").display(), script.display())
}

/// `memtransfer` with these arguments and the world that `command` starts.
fn ask(bench: &Bench, command: &str, line: &str) -> Ended {
    let mut verb = bench.command(&words(line));
    verb.env("MEMTRANSFER_WORLD_CMD", command).env("PYTHONPATH", repository("python"));
    Ended::run(&mut verb)
}

const SHORT: &str = "run --policy imitate --memory working,episodic --frame-size 64 --max-steps 30 --routes unchanged,blocked";

/// One case has no blocked route, and the world is not deterministic.
const UNEVEN: &str = "\
deterministic = False
state = [Field('step')]
state_sentence = 'You are in cell {step}.'
def cases(self):
    for case in super().cases():
        if case.id == 'visit-8':
            del case.trajectories['blocked']
        yield case";

#[test]
fn verbs_treat_a_world_of_ones_own_like_the_warehouse() {
    let bench = Bench::new();
    let world = corridor(&bench, UNEVEN);
    let ended = ask(&bench, &world, &format!("{SHORT} --out r")).expect(0);
    let left_out = "1 of 4 cases have no blocked route: their episodes on it are left out\n";
    assert_eq!(ended.stderr.matches(left_out).count(), 1, "{}", ended.stderr);
    let is_blocked = |record: &&Value| record["route"] == "blocked";
    let all = records(&bench.out("r"));
    assert_eq!((all.len(), all.iter().filter(is_blocked).count()), (22, 6));
    let varies = "The world corridor is not deterministic";
    assert!(ended.stdout.contains(varies), "{}", ended.stdout);
    let key = "episodic/new/blocked/original/run1/reach-7";
    for (line, expected) in [
        ("ls", "action         b walk west"),
        ("ls", "4, 3 of them with a blocked route"),
        ("ls cases", "visit-8  Walk to cell 8, then"),
        ("ls tasks", "two places"),
        ("score r", varies),
        ("report r", "report.html"),
        ("validate", "4 checked    0 violated"),
        ("validate r", "22 episodes, 0 differences"),
        (&format!("show r {key} 1"), "Retrieved  view 1 of the demonstration `original`"),
        ("view r --out pages", "index.html"),
        ("export r --format mcap --episodes 2 --out mcap", ".mcap"),
        ("export r --format csv --out tables", "steps.csv"),
        ("memory build --demos original --kind summary --out documents", "summary/original"),
        ("render --case reach-7 --trajectory blocked --size 64 --out views", "views/006.png"),
    ] {
        let printed = ask(&bench, &world, line).expect(0).stdout;
        assert!(printed.contains(expected), "{line}: {printed}");
    }
    let read = |name: &str| std::fs::read_to_string(bench.out(name)).unwrap();
    assert!(read("r/report/report.html").contains(varies));
    let columns = read("tables/steps.csv");
    assert!(columns.lines().next().unwrap().contains(",step,state_step,"), "{columns}");
    let views = std::fs::read_dir(bench.out("pages/run1/views")).unwrap().count();
    assert!(views > 10, "{views} views");
    for line in ["map", "generate", "ls items", "ls streams", "render --pose 3,12,N"] {
        let refused = ask(&bench, &world, line).expect(2).stderr;
        assert!(refused.contains("--world-cmd") || refused.contains("--case"), "{line}: {refused}");
    }
    assert_eq!(bench.leftovers(), Vec::<String>::new());
}

#[test]
fn a_policy_that_answers_in_the_words_of_the_warehouse_ends_the_run() {
    let bench = Bench::new();
    let world = corridor(&bench, "");
    let policy = bench.out("policy.py");
    let text = "from memtransfer import Action, Policy, run\n\nclass Ahead(Policy):\n    name = 'ahead'\n\n    \
                def act(self, requests):\n        return [Action.FORWARD for _ in requests]\n\nrun(Ahead())\n";
    std::fs::write(&policy, text).unwrap();
    let python = needs::world_python("minigrid");
    let mut run = bench.command(&words("run --memory working --frame-size 64 --out r"));
    run.args(["--policy-cmd", &format!("{} {}", python.display(), policy.display())]);
    run.env("MEMTRANSFER_WORLD_CMD", &world).env("PYTHONPATH", repository("python"));
    let ended = Ended::run(&mut run).expect(1);
    let message = "an action of the warehouse that the world corridor does not have: return the number (0 to 1)";
    assert!(ended.stderr.contains(message), "{}", ended.stderr);
    assert!(!ended.stderr.contains("starting again"), "{}", ended.stderr);
}
