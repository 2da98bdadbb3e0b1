//! The program from outside: its messages about bad input, and its exit status. `validate` needs the simulator beside it.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use conditions::PolicyKind;
use orchestrator::units::UnitPlan;
use rigs::records;
use run_log::RunFolder;
use tempfile::TempDir;

/// `memtransfer ARGUMENTS` in `dir`, away from this machine's settings.
fn memtransfer(dir: &Path, arguments: &str) -> Output {
    memtransfer_with(dir, arguments, &[])
}

/// The same with these variables.
fn memtransfer_with(dir: &Path, arguments: &str, variables: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_memtransfer"));
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("MEMTRANSFER_")) {
        command.env_remove(name);
    }
    command.args(arguments.split_whitespace()).current_dir(dir).envs(variables.iter().copied());
    command.env("MEMTRANSFER_RUN_DIR", dir.join("live")).output().unwrap()
}

fn dir() -> TempDir {
    tempfile::Builder::new().prefix("mt").tempdir_in("/dev/shm").unwrap()
}

/// Copies the shipped assets to `dir/assets`.
fn assets(dir: &Path) {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
    fs::create_dir(dir.join("assets")).unwrap();
    for file in ["layout.toml", "catalogue.toml", "cases.toml", "models.toml"] {
        fs::copy(shipped.join(file), dir.join("assets").join(file)).unwrap();
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Runs it, expects exit status 2, nothing on stdout and no run folder; returns its message.
fn refused(dir: &Path, arguments: &str) -> String {
    let output = memtransfer(dir, arguments);
    assert!(output.stdout.is_empty(), "{arguments}");
    assert!(!dir.join("runs").exists(), "{arguments} left a run folder");
    message(&output, arguments)
}

/// The message of a command that ended with exit status 2.
fn message(output: &Output, arguments: &str) -> String {
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments}: {said}");
    said
}

#[test]
fn bad_input_gets_one_clear_message_and_exit_status_2() {
    let dir = dir();
    fs::write(dir.path().join("typo.toml"), "lane = 3").unwrap();
    let in_group = "[[group]]\nname = \"new\"\nstart = [\"new\"]";
    fs::write(dir.path().join("typo-in-group.toml"), in_group).unwrap();
    fs::write(dir.path().join("broken.toml"), "runs = = 3").unwrap();
    for (arguments, said) in [
        ("run --suite quik", "did you mean `quick`?"),
        ("run --suite ./missing.toml", "cannot read suite ./missing.toml"),
        ("run --suite typo.toml", "suite typo.toml: unknown key `lane`: did you mean `lanes`?"),
        ("run --suite broken.toml", "suite broken.toml: TOML parse error at line 1"),
        ("run --policy ground", "did you mean `grounded`?"),
        ("run --memory episodik", "did you mean `episodic`?"),
        ("run --demos orginal", "did you mean `original`?"),
        ("run --frames blanc", "did you mean `blank`?"),
        ("run --segment image", "did you mean `images`?"),
        ("run --hint of", "did you mean `off`?"),
        ("run --documents modle", "did you mean `model`?"),
        (
            "run --suite typo-in-group.toml",
            "suite typo-in-group.toml, group 1: unknown key `start`: did you mean `starts`?",
        ),
        ("conformance --policy-cmd a --memory-cmd b", "one program is checked at a time"),
        ("plan --out .", "give the plan's file, such as --out ./plan.json"),
        ("merge --plan plan.json units --out typo.toml", "typo.toml is a file"),
        ("run --suite rq1 --window 20", "lower --window or --keyframes"),
        ("run --memory episodic --demos none", "no condition is left"),
        ("run --memory none", "no memory is left"),
        (
            "run --memory external --dry-run",
            "a dry run starts no program, and a memory of your own tells its name when it starts: without it no condition",
        ),
        ("run --frame-budget 4000000000 --dry-run", "not a whole number from 1 to 1048576"),
        ("run --elsewhere w --dry-run", "--elsewhere is the warehouse of --demos elsewhere"),
        ("run --policy openai --model m --max-cost 3 --dry-run", "--max-cost needs prices"),
        ("plan --out p.json --workers 5", "--slurm"),
        ("top --json --memory nope", "cannot be used with"),
        (
            "export r --format mcap --out y.mp4",
            "y.mp4 has the extension of another format: this one writes .mcap",
        ),
        ("export r --format csv --out y.YAML", "another format: this one writes .csv files"),
        ("run --suite stream --arms learning --memory episodic", "no memory is left that learns"),
        ("run --arms learning", "--arms learning is for a suite of streams"),
        ("run --provider gpu", "unknown execution provider `gpu`"),
        ("run --limit -1", "--limit: -1 is not a whole number"),
        ("profile --lanes 0", "0 is not in 1..=1024"),
        ("memory ls --frame-size 7", "frame-size"),
        ("run --cases t03-7", "did you mean `t03-07`?"),
        ("run --cases 1-200", "unknown case `1-200`: did you mean `1-100`?"),
        ("run --limit 0", "no case is left"),
        ("run --suite stream --limit 0", "no case is left"),
        ("run --lanes 0", "--lanes: 0 is not a whole number from 1 to 1024"),
        ("run --frame-size 100", "--frame-size: 100 is not a multiple of 64 from 64 to 4096"),
        ("run --starts original --routes blocked", "a blocked route needs the new start"),
        ("run --lames 3", "--lanes"),
        ("run --assets nowhere", "cannot read nowhere/layout.toml"),
        ("validate --assets nowhere", "cannot read nowhere/layout.toml"),
        ("score nowhere", "nowhere holds no run"),
        ("map t03-7", "did you mean `t03-07`?"),
        ("generate --count 0", "--count is 0"),
        ("memory build --demos none", "a document needs demonstrations"),
        ("memory build --demos orignal", "did you mean `original`?"),
        ("memory build --kind sumary", "a kind is summary or semantic"),
        ("memory build --model m", "--model needs --builder model"),
        ("memory build --reasoning low", "--model needs --builder model"),
        ("memory build --builder model", "--builder model needs --model NAME"),
        ("memory build --builder model --reasoning lo", "did you mean `low`?"),
        ("memory build --builder model --extra-body []", "it is not a JSON object such as"),
        ("memory show summary", "<DEMOS>"),
    ] {
        let found = refused(dir.path(), arguments);
        assert!(found.contains(said), "{arguments}: {found}");
    }
}

#[test]
fn broken_assets_are_named_with_file_and_place() {
    for (file, from, to, said) in [
        ("layout.toml", "\nplan =", "\nplam =", "layout.toml: "),
        ("cases.toml", "\nseed =", "\nsead =", "cases.toml: "),
        ("catalogue.toml", "\nstock =", "\nstick =", "catalogue.toml: "),
    ] {
        let dir = dir();
        assets(dir.path());
        let path = dir.path().join("assets").join(file);
        let whole = fs::read_to_string(&path).unwrap();
        assert!(whole.contains(from), "{file}");
        fs::write(&path, whole.replacen(from, to, 1)).unwrap();
        let found = refused(dir.path(), "run --dry-run --assets assets");
        assert!(found.contains(said), "{found}");
    }
}

#[test]
fn a_world_with_a_wrong_case_is_found_by_validate() {
    let dir = dir();
    assets(dir.path());
    let path = dir.path().join("assets/cases.toml");
    let text_of = fs::read_to_string(&path).unwrap();
    // The first trajectory loses its last action.
    let line = text_of.lines().find(|line| line.starts_with("original")).unwrap();
    let shorter = format!("{}\"", &line[..line.len() - 2]);
    fs::write(&path, text_of.replacen(line, &shorter, 1)).unwrap();
    let output = memtransfer(dir.path(), "validate --assets assets");
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stdout).contains("FAIL"), "{}", text(&output.stdout));

    // The first case's histories change places.
    let names = [
        ("irrelevant =", "swapped ="),
        ("confusable =", "irrelevant ="),
        ("swapped =", "confusable ="),
    ];
    let swapped = names.iter().fold(text_of, |text, (from, to)| text.replacen(from, to, 1));
    fs::write(&path, swapped).unwrap();
    let output = memtransfer(dir.path(), "validate --assets assets");
    assert_eq!(output.status.code(), Some(1));
    for constraint in ["irrelevant: the history", "confusable: at a shared pose", "are regenerated"]
    {
        let found = text(&output.stdout);
        let line = found.lines().find(|line| line.contains(constraint)).unwrap();
        assert!(line.starts_with("FAIL"), "{found}");
    }
}

#[test]
fn a_target_in_a_first_view_is_found_by_rule_and_by_rendering() {
    let dir = dir();
    assets(dir.path());
    let path = dir.path().join("assets/cases.toml");
    let cases = fs::read_to_string(&path).unwrap();
    let (from, to) = ("test = \"0,2,W ", "test = \"12,26,W ");
    let of_case = cases.find("id = \"t09-07\"").unwrap();
    let (before, after) = cases.split_at(of_case);
    assert!(after.contains(from));
    fs::write(&path, before.to_owned() + &after.replacen(from, to, 1)).unwrap();
    let output = memtransfer(dir.path(), "validate --assets assets");
    assert_eq!(output.status.code(), Some(1));
    let found = text(&output.stdout);
    for constraint in ["test: no target in the first view", "rendered: no pixel of a target"] {
        let line = found.lines().find(|line| line.contains(constraint)).unwrap();
        assert!(line.starts_with("FAIL"), "{found}");
    }
    assert!(
        found.contains("t09-07 test: 460 pixels of a target are in view from 12,26,W"),
        "{found}"
    );
}

#[test]
fn the_shipped_world_is_validated_in_a_hundred_columns() {
    let dir = dir();
    let said = text(&memtransfer(dir.path(), "validate").stdout);
    assert!(said.ends_with("100 cases, 600 trajectories, 0 violations\n"), "{said}");
    assert!(said.lines().all(|line| line.chars().count() <= 100), "{said}");
}

#[test]
fn a_generated_world_is_valid_runs_and_is_the_same_again() {
    let dir = dir();
    let generate = |out: &str| {
        let arguments = format!("generate world --seed 5 --size 14x16 --cases 20 --out {out}");
        let output = memtransfer(dir.path(), &arguments);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let said = text(&output.stderr);
        assert!(said.starts_with("14 x 16 cells, ") && said.contains(" 20 cases in "), "{said}");
        ["layout.toml", "catalogue.toml", "cases.toml"].map(|file| {
            let folder = out.split(' ').next().unwrap();
            fs::read_to_string(dir.path().join(folder).join(file)).unwrap()
        })
    };
    let files = generate("one");
    assert_eq!(generate("two"), files);
    // Its own folder may be written again, one with other files may not.
    assert_eq!(generate("one"), files);
    fs::write(dir.path().join("two/notes.txt"), "").unwrap();
    let said = refused(dir.path(), "generate world --seed 5 --size 14x16 --out two");
    assert!(said.contains("has other files, \"notes.txt\" for one"), "{said}");
    // What someone has edited stays, until --force replaces it.
    let cases = dir.path().join("one/cases.toml");
    fs::write(&cases, "# mine\n").unwrap();
    for what in ["world --seed 5 --size 14x16 --cases 20 --out one", "--out one/cases.toml"] {
        let said = refused(dir.path(), &format!("generate {what}"));
        assert!(said.contains("cases.toml is there already and differs"), "{said}");
        assert_eq!(fs::read_to_string(&cases).unwrap(), "# mine\n");
    }
    assert_eq!(generate("one --force"), files);
    let said = refused(dir.path(), "generate world --seed 5 --size 11x16 --out three");
    assert!(said.contains("11x16 cells; each side must be 12 to 64"), "{said}");

    let validated = memtransfer(dir.path(), "validate --assets one");
    assert_eq!(validated.status.code(), Some(0), "{}", text(&validated.stdout));
    let planned = memtransfer(dir.path(), "run --assets one --policy expert --dry-run");
    assert!(text(&planned.stdout).contains("40 of 40 episodes"), "{}", text(&planned.stdout));
}

#[test]
fn the_other_warehouse_is_drawn_or_named() {
    let dir = dir();
    let map = |arguments: &str| {
        let output = memtransfer(dir.path(), arguments);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let other = map("map --elsewhere");
    assert!(
        other.starts_with("<svg")
            && other != map("map")
            && other != map("map --elsewhere --seed 2")
    );
    assets(dir.path());
    fs::create_dir(dir.path().join("empty")).unwrap();
    for (arguments, said) in [
        ("run --demos elsewhere --elsewhere assets", "assets: it is the warehouse that is tested"),
        ("run --demos elsewhere --elsewhere empty", "cannot read empty/layout.toml"),
        ("run --suite stream --demos elsewhere", "in a suite of streams every episode begins"),
        ("map t01-01 --elsewhere", "cannot be used with"),
    ] {
        let message = refused(dir.path(), arguments);
        assert!(message.contains(said), "{arguments}: {message}");
    }
    let planned = memtransfer(dir.path(), "run --suite transfer --limit 10 --dry-run");
    let planned = text(&planned.stdout);
    assert!(planned.contains("semantic/new/unchanged/elsewhere"), "{planned}");
    assert!(planned.contains("570 of 570 episodes of 19 conditions"), "{planned}");
}

#[test]
fn settings_come_from_all_sources_in_order() {
    let dir = dir();
    fs::write(dir.path().join("mine.toml"), "lanes = 3\nruns = 4\nseed = 5").unwrap();
    let variables = [("MEMTRANSFER_RUNS", "6"), ("MEMTRANSFER_SEED", "7")];
    let arguments = "run --suite mine.toml --seed 8 --show-settings";
    let found = text(&memtransfer_with(dir.path(), arguments, &variables).stdout);
    for (key, origin) in [
        ("window = [6]", "default"),
        ("lanes = 3", "suite"),
        ("runs = 6", "environment"),
        ("seed = 8", "command line"),
        ("out = \"runs/mine-grounded\"", "default"),
    ] {
        let line = found.lines().find(|line| line.starts_with(key));
        assert!(line.is_some_and(|line| line.ends_with(origin)), "{key} from {origin}: {found}");
    }
}

#[test]
fn the_template_that_is_printed_is_one_to_start_from() {
    let dir = dir();
    let printed = text(&memtransfer(dir.path(), "ls prompt").stdout);
    assert_eq!(printed, prompt::Template::BUILT_IN_FILE);
    let dry_run = "run --policy openai --model m --base-url http://127.0.0.1:9 --memory working \
                   --limit 1 --dry-run --prompt mine.toml";
    fs::write(dir.path().join("mine.toml"), printed.replace("prompt/2", "mine/1")).unwrap();
    let output = memtransfer(dir.path(), dry_run);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    for (from, to, said) in [
        (
            "\nhint = ",
            "\nhnt = ",
            "the prompt mine.toml: unknown key `memory.hnt`: did you mean `memory.hint`?",
        ),
        ("# The name", "# the name", "version: prompt/2 is the built-in template"),
        ("[task]", "[tasks]", "unknown key `tasks`: did you mean `task`?"),
    ] {
        fs::write(dir.path().join("mine.toml"), printed.replace(from, to)).unwrap();
        let found = refused(dir.path(), dry_run);
        assert!(found.contains(said), "{found}");
    }
    let other_policy = refused(dir.path(), "run --policy random --prompt mine.toml");
    assert!(other_policy.contains("--prompt is for --policy openai"), "{other_policy}");
}

#[test]
fn a_wrong_variable_is_named() {
    let dir = dir();
    for (variable, value, said) in [
        ("MEMTRANSFER_LANES", "abc", "MEMTRANSFER_LANES: abc is not a whole number"),
        ("MEMTRANSFER_LANS", "3", "did you mean `MEMTRANSFER_LANES`?"),
        ("MEMTRANSFER_POLICY", "ground", "MEMTRANSFER_POLICY: unknown policy `ground`"),
    ] {
        let output = memtransfer_with(dir.path(), "run --dry-run", &[(variable, value)]);
        let found = message(&output, variable);
        assert!(found.contains(said) && !found.contains("--lanes"), "{found}");
    }
}

#[test]
fn an_empty_variable_is_not_set() {
    let dir = dir();
    let empty =
        ["MEMTRANSFER_ASSETS", "MEMTRANSFER_MODEL", "MEMTRANSFER_BASE_URL"].map(|name| (name, ""));
    for arguments in ["ls tasks", "run --policy expert --limit 1 --dry-run", "memory ls"] {
        let output = memtransfer_with(dir.path(), arguments, &empty);
        assert_eq!(output.status.code(), Some(0), "{arguments}: {}", text(&output.stderr));
    }
    let found = memtransfer_with(dir.path(), "doctor --policy openai", &empty);
    assert!(message(&found, "doctor").contains("--model <NAME>"));
}

#[test]
fn a_larger_limit_includes_the_cases_of_a_smaller_one() {
    let dir = dir();
    let planned = |limit: u32| {
        let arguments = format!("run --dry-run --policy expert --starts new --limit {limit}");
        text(&memtransfer(dir.path(), &arguments).stdout)
    };
    assert!(planned(10).contains("10 of 10 episodes"), "{}", planned(10));
    assert!(planned(20).contains("20 of 20 episodes"), "{}", planned(20));
}

#[test]
fn a_dry_run_counts_and_touches_nothing() {
    let dir = dir();
    let output = memtransfer(dir.path(), "run --dry-run --policy expert --limit 10 --runs 2");
    assert_eq!(output.status.code(), Some(0));
    for (arguments, counted) in [
        ("--limit 10 --runs 2", "240 of 240 episodes of 12 conditions would run"),
        ("--suite paper", "17900 of 17900 episodes of 53 conditions"),
        ("--suite paper --policy expert", "300 of 300 episodes of 3 conditions"),
        ("--suite design --memory working --runs 1", "300 of 300 episodes of 3 conditions"),
        ("--suite rq2 --window 0", "3600 of 3600 episodes of 12 conditions"),
    ] {
        let output = memtransfer(dir.path(), &format!("run --dry-run {arguments}"));
        let said = text(&output.stdout);
        assert!(said.contains(counted), "{arguments}: {said}{}", text(&output.stderr));
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}

/// A step of a run without a prompt log is shown with advice that helps, and a case that is not shown says why.
#[test]
fn a_run_without_prompts_is_shown_and_a_missing_case_explained() {
    let dir = dir();
    let mut manifest = records::manifest();
    manifest.settings.cases = vec!["t01".parse().unwrap()];
    let mut folder = RunFolder::open(&dir.path().join("run"), manifest, false).unwrap().folder;
    let record = records::record("t01-01", true);
    let timings = records::timings(&record);
    let by_key = format!("show run {} 0", record.key);
    folder.finish(&[(record, timings)]).unwrap();
    drop(folder);

    let shown = memtransfer(dir.path(), "show run t01-01 0");
    assert_eq!(shown.status.code(), Some(0), "{}", text(&shown.stderr));
    let advice = "command again with --log-prompts and another --out";
    assert!(text(&shown.stdout).contains(advice), "{}", text(&shown.stdout));
    assert_eq!(memtransfer(dir.path(), &by_key), shown);
    for (arguments, said) in [
        ("show run t01-01 0 --images views", "--log-prompts, --cases t01-01 and another --out"),
        ("show run t01-02 0", "no episode of t01-02 is finished yet in run"),
        ("show run t02-01 0", "t02-01 is not one of the cases of run"),
        ("show run t02-1 0", "unknown case `t02-1`: did you mean `t02-01`?"),
    ] {
        let found = message(&memtransfer(dir.path(), arguments), arguments);
        assert!(found.contains(said), "{arguments}: {found}");
    }
}

/// Makes the finished run `name` of `policy` in `dir`: one case under two conditions.
fn finished_run(dir: &Path, name: &str, policy: PolicyKind) {
    let mut manifest = records::manifest();
    (manifest.settings.policy, manifest.episodes) = (policy, 2);
    let mut folder = RunFolder::open(&dir.join(name), manifest, false).unwrap().folder;
    let record = records::record("t01-01", true);
    let other = "working/original/unchanged/none".parse().unwrap();
    for record in [record.clone(), records::under(other, record)] {
        let timings = records::timings(&record);
        folder.finish(&[(record, timings)]).unwrap();
    }
}

/// A finished run of the first `cases` cases under one condition, of which the first `successes` succeed.
fn run_of_cases(dir: &Path, name: &str, successes: u32, cases: u32) {
    let mut manifest = records::manifest();
    let group = &mut manifest.settings.groups[0];
    group.memory = vec![domain::Representation::Episodic.into()];
    group.starts = vec![conditions::Start::Original];
    manifest.episodes = cases;
    let mut folder = RunFolder::open(&dir.join(name), manifest, false).unwrap().folder;
    let records = (0..cases).map(|case| {
        let id = format!("t{:02}-{:02}", 1 + case / 10, 1 + case % 10);
        let record = records::record(&id, case < successes);
        let timings = records::timings(&record);
        (record, timings)
    });
    folder.finish(&records.collect::<Vec<_>>()).unwrap();
}

#[test]
fn a_gate_that_is_not_passed_has_an_exit_status_of_its_own() {
    let dir = dir();
    for (name, successes, cases) in [
        ("all", 100, 100),
        ("again", 100, 100),
        ("most", 70, 100),
        ("few", 10, 10),
        ("other", 99, 100),
    ] {
        run_of_cases(dir.path(), name, successes, cases);
    }
    run_of_cases(dir.path(), "stopped", 50, 50);
    let manifest = dir.path().join("stopped/manifest.json");
    let text = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, text.replace("\"episodes\": 50", "\"episodes\": 100")).unwrap();
    let condition = "episodic/original/unchanged/original";
    for (arguments, status, line) in [
        ("score all --require C:sr>=97", 0, "passed     C: sr >= 97: 100.0 [97.1, 100.0]"),
        ("score all --require C:sr>=99", 4, "undecided  C: sr >= 99: 100.0 [97.1, 100.0]"),
        ("score all --require C:sr<50", 4, "failed     C: sr < 50: 100.0 [97.1, 100.0]"),
        (
            "score all --require C:sr>=97 --require C:spl>=0.9",
            4,
            "1 of 2 passed, 1 failed, 0 undecided.",
        ),
        (
            "score all --require C:sr>=97 --require C:spl>=0.5",
            0,
            "2 of 2 passed, 0 failed, 0 undecided.",
        ),
        ("score few --require C:sr>=90", 4, "undecided  C: sr >= 90: 100.0"),
        ("score stopped --require C:sr>=50", 4, ": 50 of 100 episodes are missing"),
        ("score all --require C:change>=1", 4, "undecided  C: change >= 1: of blocked routes only"),
        (
            "score all --require-no-worse-than again",
            0,
            "passed     C: sr minus again's > -5: 0.0 [−2.8, 2.8], 100 cases",
        ),
        ("score other --require-no-worse-than all", 0, "passed     C: sr minus all's > -5: −1.0"),
        ("score few --require-no-worse-than all", 4, "undecided  C: sr minus all's > -5: 0.0"),
        ("score few --require-no-worse-than all --margin 40", 0, ", 10 cases"),
        ("score most --require-no-worse-than all", 4, "failed     C: sr minus all's > -5: −30.0"),
        ("score all --require-no-worse-than most", 0, "passed     C: sr minus most's > -5: +30.0"),
        (
            "score stopped --require-no-worse-than all",
            4,
            "50 of 100 episodes are missing in stopped",
        ),
        ("score all --require C:sr>=97 --require-no-worse-than most", 0, "2 of 2 passed"),
    ] {
        let arguments = arguments.replace('C', condition);
        let output = memtransfer(dir.path(), &arguments);
        // A long line goes on below its beginning.
        let shown = text_of(&output).replace(&format!("\n{}", " ".repeat(11)), " ");
        assert_eq!(output.status.code(), Some(status), "{arguments}: {shown}");
        let line = line.replace('C', condition);
        assert!(shown.lines().any(|shown| shown.contains(&line)), "{arguments}: {line}\n{shown}");
        assert!(shown.contains("scripted stand-in"), "{shown}");
    }
    // A gate on a condition that is complete may be passed before the run is.
    let other = "working/original/unchanged/none";
    let manifest = dir.path().join("again/manifest.json");
    let text = fs::read_to_string(&manifest).unwrap();
    let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
    value["settings"]["group"][0]["memory"] = serde_json::json!(["episodic", "working"]);
    value["episodes"] = 200.into();
    fs::write(&manifest, value.to_string()).unwrap();
    let output = memtransfer(dir.path(), &format!("score again --require {condition}:sr>=97"));
    assert!(text_of(&output).contains("1 of 1 passed"), "{}", text_of(&output));
    for arguments in ["score again", "score again most", "report again --out made"] {
        let output = memtransfer(dir.path(), arguments);
        assert_eq!(output.status.code(), Some(1), "{arguments}: {}", text_of(&output));
    }
    let output = memtransfer(dir.path(), &format!("score again --require {other}:sr>=97"));
    assert_eq!(output.status.code(), Some(4), "{}", text_of(&output));

    // Several comparisons of one command are one family.
    let pair = format!("--compare {condition} {condition}");
    let output = memtransfer(dir.path(), &format!("score all most {pair} {pair} --json"));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let families = json["comparisons"].as_array().unwrap().iter().map(|one| &one["family"]);
    assert_eq!(families.collect::<Vec<_>>(), [2, 2]);

    let output = memtransfer(dir.path(), &format!("score all --json --require {condition}:sr>=97"));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0));
    let gate = &json["gates"][0];
    assert_eq!((gate["figure"].as_str(), gate["verdict"].as_str()), (Some("sr"), Some("passed")));
    assert!(json["conditions"][0]["sr"]["mean"] == gate["value"] && gate["value"] == 100.0);
    let output = memtransfer(dir.path(), "score all --json");
    assert!(!text_of(&output).contains("gates"), "{}", text_of(&output));
    for (arguments, said) in [
        ("score all --require C", "is not a gate: write CONDITION: FIGURE OPERATOR NUMBER"),
        ("score all --require C:srr>=60", "did you mean `sr`?"),
        ("score all --require C:sr>=600", "sr lies from 0 to 100"),
        ("score all --require episodic/original/unchanged/nearby:sr>=60", "did you mean `C`?"),
        ("score all --require-no-worse-than nowhere", "nowhere"),
        ("score all --require-no-worse-than all --margin -1", "expected percentage points"),
        ("score all --require-no-worse-than all --margin x", "expected percentage points"),
        ("score all --margin 3", "--require-no-worse-than"),
        ("score all --require C:sr>=0", "every value of sr is >= 0"),
        ("score all --require C:sr>=0.6", "sr is in percent: write `60 %`"),
        // By another path, too.
        ("score all --require-no-worse-than ./few/../all", "cannot be compared with itself"),
        ("score all all", "all cannot be compared with itself"),
        ("score all --compare C C", "unchanged/original cannot be compared with itself"),
        ("report all most all --out both", "all is given twice"),
        ("score all most --require C:sr>=60", "cannot be used with"),
    ] {
        let (arguments, said) =
            (arguments.replace('C', condition), said.replace("`C`", &format!("`{condition}`")));
        let shown = refused(dir.path(), &arguments);
        assert!(shown.contains(&said), "{arguments}: {shown}");
    }
}

/// What the program has printed to stdout.
fn text_of(output: &Output) -> String {
    text(&output.stdout)
}

#[test]
fn a_run_is_set_beside_published_figures() {
    let dir = dir();
    run_of_cases(dir.path(), "all", 100, 100);
    run_of_cases(dir.path(), "most", 70, 100);
    let page = |arguments: &str| {
        let output = memtransfer(dir.path(), arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments}: {}", text(&output.stderr));
        fs::read_to_string(dir.path().join(text_of(&output).trim())).unwrap()
    };
    assert!(!page("report all").contains("Reproduction"));
    let found = page("report all --against all/report/published.toml");
    assert!(
        found.contains("2 of 2 published figures lie in this run’s intervals")
            || found.contains("2 of 2 published figures lie in this run&#39;s intervals"),
        "{found}"
    );
    let found = page("report most --against all/report/published.toml --out made");
    assert!(found.contains("0 of 2 published figures lie"), "{found}");
    assert!(dir.path().join("made/tables/reproduction.csv").exists());
    let found = page("report most --against paper --out made");
    assert!(found.contains("This run has 1 of 41 published conditions"), "{found}");
    fs::write(dir.path().join("broken.toml"), "title = \"t\"\npolicy = \"p\"\nyear = 2026\n")
        .unwrap();
    for (arguments, said) in [
        ("report all --against broken.toml", "broken.toml: TOML parse error at line 3, column 1"),
        ("report all --against nowhere.toml", "cannot read nowhere.toml"),
        (
            "report all most --against paper --out both",
            "--against sets one run beside published figures, and 2 runs are given",
        ),
    ] {
        let shown = refused(dir.path(), arguments);
        assert!(shown.contains(said), "{arguments}: {shown}");
    }
    assert!(!dir.path().join("both").exists());
}

/// The words that `--help` lists after the line `from`, indented, until an empty line.
fn listed(help: &str, from: &str) -> Vec<String> {
    let lines = help.lines().skip_while(|line| *line != from).skip(1);
    let lines = lines.take_while(|line| !line.is_empty());
    lines.filter_map(|line| Some(line.strip_prefix("  ")?.split(' ').next()?.to_owned())).collect()
}

#[test]
fn every_output_with_figures_of_a_run_names_a_policy_that_is_no_model() {
    /// Each verb with the commands that show figures of a run. The others are tested where a run takes place (`demo`, `run`,
    /// `work`, `top`, `view`), or show no figure of a policy.
    const SHOWN: &[(&str, &[&str])] = &[
        ("demo", &[]),
        ("run", &[]),
        ("plan", &[]),
        ("work", &[]),
        ("merge", &[]),
        ("top", &[]),
        ("ls", &["ls runs .", "ls runs . --json"]),
        ("validate", &[]),
        ("map", &[]),
        ("render", &[]),
        ("memory", &[]),
        (
            "score",
            &[
                "score RUN",
                "score RUN --json",
                "score RUN other",
                "score RUN other --json",
                "score RUN --compare A B",
                "score RUN --compare A B --json",
                "score RUN other --compare A A",
                "score RUN other --compare A A --json",
            ],
        ),
        (
            "report",
            &[
                "report RUN --out made/report",
                "report RUN --out made/against --against paper",
                "report RUN other --out made/both",
            ],
        ),
        ("view", &[]),
        (
            "export",
            &[
                "export RUN --out made/tables --format csv",
                "export RUN --out made/tables --format parquet",
                "export RUN --out made/hub --dataset a/b --format hugging-face",
            ],
        ),
        (
            "show",
            &["show RUN t01-01 --condition working", "show RUN t01-01 --condition working --json"],
        ),
        ("profile", &[]),
        ("conformance", &[]),
        ("clean", &[]),
        ("cache", &[]),
        ("generate", &[]),
        ("doctor", &[]),
        ("help", &[]),
    ];
    let (a, b) = ("episodic/original/unchanged/original", "working/original/unchanged/none");
    for (policy, role) in [
        (PolicyKind::Grounded, "scripted stand-in"),
        (PolicyKind::Random, "lower bound"),
        (PolicyKind::Expert, "upper bound"),
    ] {
        let dir = dir();
        finished_run(dir.path(), "one", policy);
        finished_run(dir.path(), "other", PolicyKind::External);
        let help = text(&memtransfer(dir.path(), "--help").stdout);
        let verbs: Vec<&str> = SHOWN.iter().map(|(verb, _)| *verb).collect();
        assert_eq!(listed(&help, "Commands:"), verbs, "a verb that this test does not know");
        let help = text(&memtransfer(dir.path(), "export --help").stdout);
        let formats = listed(&help, "Formats:").join(" ");
        assert_eq!(formats, "mcap mp4 csv, hugging-face", "a format that it does not know");
        for command in SHOWN.iter().flat_map(|(_, commands)| *commands) {
            let arguments: Vec<&str> = command
                .split(' ')
                .map(|word| match word {
                    "RUN" => "one",
                    "A" => a,
                    "B" => b,
                    word => word,
                })
                .collect();
            let output = memtransfer(dir.path(), &arguments.join(" "));
            assert_eq!(output.status.code(), Some(0), "{command}: {}", text(&output.stderr));
            let shown = text(&output.stdout);
            let writes = command.starts_with("report") || command.starts_with("export");
            assert!(writes || shown.contains(role), "{command} does not say {role}:\n{shown}");
        }
        let made = dir.path().join("made");
        for file in [
            "report/report.html",
            "report/published.toml",
            "against/report.html",
            "both/report.html",
            "tables/episodes.csv",
            "tables/steps.csv",
            "tables/episodes.parquet",
            "tables/steps.parquet",
            "hub/memtransfer-quick.yaml",
        ] {
            let content = text(&fs::read(made.join(file)).unwrap());
            assert!(content.contains(role), "{file} does not say {role}");
        }
    }
}

#[test]
fn damaged_lines_are_named_by_all_that_leave_them_out() {
    let dir = dir();
    for (name, seed) in [("a", 1), ("b", 2)] {
        let mut manifest = records::manifest();
        manifest.settings.seed = seed;
        let mut folder = RunFolder::open(&dir.path().join(name), manifest, false).unwrap().folder;
        let mut record = records::record("t01-01", true);
        record.seed = record.own_key().seed(seed);
        let timings = records::timings(&record);
        folder.finish(&[(record, timings)]).unwrap();
    }
    let path = dir.path().join("a/episodes.jsonl");
    let whole = fs::read_to_string(&path).unwrap();
    fs::write(&path, whole.clone() + &whole.replace("\"task\"", "\"tusk\"")).unwrap();
    let condition = "episodic/original/unchanged/original";
    let said = "warning: damaged, left out: ";
    let field = "episodes.jsonl, line 2: unknown field `tusk` at line 1 column ";
    for arguments in [
        "score a --json",
        "score a b",
        "score a b --json",
        &format!("score a b --compare {condition} {condition}"),
        &format!("score a b --compare {condition} {condition} --json"),
        &format!("score b a --compare {condition} {condition}"),
        "export a --format csv --out tables",
    ] {
        let output = memtransfer(dir.path(), arguments);
        let found = text(&output.stderr);
        // Three of the four planned episodes are missing.
        let status = if arguments.starts_with("score") { 1 } else { 0 };
        assert_eq!(output.status.code(), Some(status), "{arguments}: {found}");
        assert_eq!(found.matches(said).count(), 1, "{arguments}: {found}");
        assert!(found.contains(field), "{arguments}: {found}");
        assert!(found.lines().all(|line| line.chars().count() <= 100), "{arguments}: {found}");
    }
    // Both comparisons of two runs name the settings that differ.
    for arguments in
        ["score a b --json", &format!("score a b --compare {condition} {condition} --json")]
    {
        let found = text(&memtransfer(dir.path(), arguments).stdout);
        let found: serde_json::Value = serde_json::from_str(&found).unwrap();
        assert_eq!(found["differing_settings"][0]["key"], "seed", "{arguments}: {found}");
        assert_eq!(found["comparisons"][0]["cases"], 1, "{arguments}: {found}");
    }
}

#[test]
fn a_folder_with_other_files_is_not_touched() {
    let dir = dir();
    fs::create_dir(dir.path().join("precious")).unwrap();
    fs::write(dir.path().join("precious/thesis.txt"), "years").unwrap();
    for arguments in ["run --out precious", "run --out precious --fresh"] {
        let said = refused(dir.path(), arguments);
        assert!(said.contains("precious holds files and is no run folder"), "{said}");
    }
    assert_eq!(fs::read_to_string(dir.path().join("precious/thesis.txt")).unwrap(), "years");
}

#[test]
fn a_folder_with_another_manifest_is_not_touched() {
    let dir = dir();
    let web = dir.path().join("web");
    for folder in ["documents", "report", "prompts", "snapshots"] {
        fs::create_dir_all(web.join(folder)).unwrap();
        fs::write(web.join(folder).join("mine.txt"), "mine").unwrap();
    }
    fs::write(web.join("manifest.json"), r#"{"name": "My pages"}"#).unwrap();
    for arguments in ["run --out web", "run --out web --fresh"] {
        let said = refused(dir.path(), arguments);
        assert!(said.contains("it is not the manifest of a run"), "{said}");
    }
    for folder in ["documents", "report", "prompts", "snapshots"] {
        assert_eq!(fs::read_to_string(web.join(folder).join("mine.txt")).unwrap(), "mine");
    }
    assert_eq!(fs::read_dir(&web).unwrap().count(), 5);
}

#[test]
fn what_is_no_regular_file_is_refused_at_once() {
    let dir = dir();
    let made = |path: &str| {
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mkfifoat(rustix::fs::CWD, dir.path().join(path), mode).unwrap();
    };
    for run in ["runs/pipe", "runs/episodes"] {
        drop(RunFolder::open(&dir.path().join(run), records::manifest(), false).unwrap());
    }
    fs::remove_file(dir.path().join("runs/pipe/manifest.json")).unwrap();
    fs::remove_file(dir.path().join("runs/episodes/episodes.jsonl")).unwrap();
    fs::create_dir(dir.path().join("assets")).unwrap();
    made("runs/pipe/manifest.json");
    made("runs/episodes/episodes.jsonl");
    made("assets/layout.toml");
    made("pipe");
    for arguments in [
        "run --dry-run --suite /dev/zero",
        "run --dry-run --suite ./pipe",
        "run --dry-run --assets assets",
        "run --dry-run --policy openai --model m --base-url http://127.0.0.1:9 --prices /dev/zero",
        "work --plan /dev/zero --unit 0 --out units",
        "score runs/pipe",
        "score runs/episodes",
        "report runs/pipe",
        "view runs/episodes --out pages",
    ] {
        let said = message(&memtransfer(dir.path(), arguments), arguments);
        assert!(said.contains("not a regular file"), "{arguments}: {said}");
    }
    let listed = memtransfer(dir.path(), "ls runs");
    assert_eq!(listed.status.code(), Some(0), "{}", text(&listed.stderr));
    let shown = text(&listed.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(shown.contains("runs/pipe") && shown.contains("regular file"), "{shown}");
}

#[test]
fn a_report_is_written_beside_the_folder_and_follows_no_link() {
    let dir = dir();
    let mut folder =
        RunFolder::open(&dir.path().join("run"), records::manifest(), false).unwrap().folder;
    let record = records::record("t01-01", true);
    let timings = records::timings(&record);
    folder.finish(&[(record, timings)]).unwrap();
    drop(folder);
    let report = dir.path().join("run/report");
    fs::create_dir(&report).unwrap();
    fs::write(dir.path().join("mine.html"), "mine").unwrap();
    std::os::unix::fs::symlink("../../mine.html", report.join("report.html")).unwrap();
    let output = memtransfer(dir.path(), "report run");
    // One of four planned episodes is finished.
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    assert_eq!(fs::read_to_string(dir.path().join("mine.html")).unwrap(), "mine");
    assert!(fs::symlink_metadata(report.join("report.html")).unwrap().is_file());
    // A folder with anything else is no report.
    fs::create_dir(dir.path().join("notes")).unwrap();
    fs::write(dir.path().join("notes/notes.txt"), "mine").unwrap();
    let said = refused(dir.path(), "report run --out notes");
    assert!(said.contains("notes.txt is no part of a report"), "{said}");
}

#[test]
fn a_plan_makes_its_folder_and_is_not_replaced_by_another() {
    let dir = dir();
    let plan = "plan --policy expert --limit 1 --out plans/of/one.json";
    for _ in 0..2 {
        let output = memtransfer(dir.path(), plan);
        assert!(output.status.success(), "{}", text(&output.stderr));
    }
    let said = refused(dir.path(), &plan.replace("--limit 1", "--limit 2"));
    assert!(said.contains("one.json is the plan of another run"), "{said}");
    let notes = dir.path().join("plans/of/one.json");
    fs::write(&notes, "buy milk").unwrap();
    let said = refused(dir.path(), plan);
    assert!(said.contains("one.json is no plan") && said.contains("left as it is"), "{said}");
    assert_eq!(fs::read_to_string(&notes).unwrap(), "buy milk");
}

#[test]
fn a_case_is_drawn_by_number_and_a_missing_folder_named() {
    let dir = dir();
    assert_eq!(
        memtransfer(dir.path(), "map 11").stdout,
        memtransfer(dir.path(), "map t02-01").stdout
    );
    for (arguments, said) in [
        ("map t03", "t03 stands for 10 cases"),
        ("map 101", "1-100"),
        ("ls runs missing", "cannot list missing"),
        ("memory ls --documents missing", "missing is no folder"),
    ] {
        let message = refused(dir.path(), arguments);
        assert!(message.contains(said), "{arguments}: {message}");
    }
}

#[test]
fn lists_are_tables_and_json() {
    let dir = dir();
    for (list, least) in [
        ("cases", 100),
        ("histories", 400),
        ("tasks", 10),
        ("items", 150),
        ("suites", 6),
        ("conditions --suite paper", 50),
        ("cases --suite paper", 100),
        ("runs", 0),
    ] {
        let output = memtransfer(dir.path(), &format!("ls {list} --json"));
        assert_eq!(output.status.code(), Some(0), "{list}");
        let values: Vec<serde_json::Value> = serde_json::from_slice(&output.stdout).unwrap();
        assert!(values.len() >= least, "{list}");
        assert_eq!(memtransfer(dir.path(), &format!("ls {list}")).status.code(), Some(0));
    }
    // A run of `quick` has half of the cases, as many of each task.
    let output = memtransfer(dir.path(), "ls cases --suite quick --json");
    let selected: Vec<serde_json::Value> = serde_json::from_slice(&output.stdout).unwrap();
    let of_task = |task: &str| {
        selected.iter().filter(|row| row["case"].as_str().unwrap().starts_with(task)).count()
    };
    assert_eq!((selected.len(), of_task("t03-"), of_task("t10-")), (50, 5, 5));
    let output = memtransfer(dir.path(), "clean --json");
    assert_eq!(
        text(&output.stdout).replace(char::is_whitespace, ""),
        "{\"alive\":[],\"removed\":[]}"
    );
}

/// Files in `dir` whose commands leave a trace: the suite `mine.toml`, the same in assets, and a plan of it.
fn files_with_commands(dir: &Path) -> [String; 2] {
    let [policy, memory] = ["policy", "memory"].map(|name| {
        let trace = dir.join(format!("started-{name}"));
        format!("touch {}", trace.display())
    });
    let suite = format!(
        "policy-cmd = \"{policy}\"\nmemory-cmd = [\"{memory}\"]\nmemory = [\"working\"]\nlimit = 1\nruns = 1"
    );
    assets(dir);
    fs::create_dir(dir.join("assets/suites")).unwrap();
    for file in ["mine.toml", "assets/suites/mine.toml", "assets/suites/quick.toml"] {
        fs::write(dir.join(file), &suite).unwrap();
    }
    // The plan of a run of the same commands, which its author gave on the command line.
    let mut manifest = records::manifest();
    manifest.settings.memory_cmd = vec![memory.clone()];
    let plan = UnitPlan::new(manifest, 500);
    plan.write(&dir.join("plan.json")).unwrap();
    [policy, memory]
}

fn has_started_a_program(dir: &Path) -> bool {
    ["policy", "memory"].iter().any(|name| dir.join(format!("started-{name}")).exists())
}

#[test]
fn a_dry_run_starts_no_program() {
    let dir = dir();
    let [policy, memory] = files_with_commands(dir.path());
    let flags = "--allow-commands --memory working --limit 1";
    for arguments in [
        "--suite ./mine.toml".to_owned(),
        "--assets assets --suite mine".to_owned(),
        format!("--suite ./mine.toml {flags}"),
    ] {
        let output = memtransfer(dir.path(), &format!("run --dry-run {arguments}"));
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{arguments}: {said}");
        // They are shown, so that the user sees what a suite would start.
        for command in [&policy, &memory] {
            assert!(said.contains(&**command), "{arguments}: {said}");
        }
        assert!(said.contains("a dry run starts no program"), "{arguments}: {said}");
    }
    // Nor one of the command line, and none of ours.
    let mut command = Command::new(env!("CARGO_BIN_EXE_memtransfer"));
    let cache = dir.path().join("cache");
    command.args(["run", "--dry-run", "--limit", "1", "--memory-cmd", &memory]);
    command.current_dir(dir.path()).env("MEMTRANSFER_CACHE", &cache);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(!has_started_a_program(dir.path()) && !cache.exists());
}

/// A run's folder has the names that its external memories reported.
#[test]
fn a_dry_run_lists_the_memories_that_the_folder_names() {
    let dir = dir();
    let mut manifest = records::manifest();
    manifest.settings.memory_cmd = vec!["./mine".to_owned()];
    let facts = serde_json::json!({"index": 0, "version": "1", "command": "./mine", "scope": "case",
        "embeddings": false, "frames": false, "deterministic": true, "learns": false, "sdk": "-"});
    let facts = serde_json::from_value(facts).unwrap();
    manifest.memories.insert("top-three".parse().unwrap(), facts);
    drop(RunFolder::open(&dir.path().join("run"), manifest, false).unwrap());
    let planned = |command: &str| {
        let arguments = format!("run --dry-run --memory working --memory-cmd {command} --out run");
        let output = memtransfer(dir.path(), &arguments);
        (text(&output.stdout).contains("top-three/"), text(&output.stderr))
    };
    assert_eq!(planned("./mine"), (true, String::new()));
    let (is_listed, said) = planned("./other");
    assert!(!is_listed && said.contains("its conditions are not listed"), "{said}");
}

#[test]
fn commands_of_a_file_are_shown_and_refused() {
    let dir = dir();
    let [policy, memory] = files_with_commands(dir.path());
    for (arguments, file, commands) in [
        ("run --suite ./mine.toml", "the suite ./mine.toml", &[&policy, &memory][..]),
        ("run --suite mine --assets assets", "the suite mine", &[&policy, &memory]),
        ("run --suite ./mine.toml --policy-cmd mine", "the suite ./mine.toml", &[&memory]),
        ("plan --suite ./mine.toml --out new.json", "the suite ./mine.toml", &[&policy, &memory]),
        ("work --plan plan.json --unit 0 --out units", "the plan plan.json", &[&memory]),
    ] {
        let said = refused(dir.path(), arguments);
        assert!(said.contains(&format!("{file} starts programs on this machine")), "{said}");
        assert!(said.contains("give --allow-commands"), "{said}");
        assert!(commands.iter().all(|command| said.contains(&***command)), "{arguments}: {said}");
        assert!(!has_started_a_program(dir.path()), "{arguments}");
        assert!(!dir.path().join("units").exists() && !dir.path().join("new.json").exists());
    }
    // No file allows itself.
    fs::write(dir.path().join("allows.toml"), "allow-commands = true").unwrap();
    assert!(
        refused(dir.path(), "run --suite ./allows.toml").contains("unknown key `allow-commands`")
    );
    // With the flag they are shown and started: this one is no memory, and has left its trace.
    let found = memtransfer(
        dir.path(),
        "run --suite ./mine.toml --policy grounded --allow-commands --out run --start-timeout 5",
    );
    let said = text(&found.stderr);
    assert!(said.contains("the suite ./mine.toml starts these programs:"), "{said}");
    assert!(said.contains(&memory) && has_started_a_program(dir.path()), "{said}");
}

/// `DIR/suites/quick.toml` in downloaded assets is not what `run --assets DIR` means.
#[test]
fn assets_do_not_replace_the_default_suite() {
    let dir = dir();
    files_with_commands(dir.path());
    for verb in ["run --dry-run", "run", "plan --out plan2.json", "run --show-settings"] {
        let said = refused(dir.path(), &format!("{verb} --assets assets"));
        assert!(
            said.contains("assets/suites/quick.toml differs from the shipped suite `quick`"),
            "{said}"
        );
    }
    assert!(!has_started_a_program(dir.path()));
}

/// The script for a cluster is made by the user who gave the commands, or allowed them.
#[test]
fn the_script_of_a_plan_allows_what_its_maker_gave() {
    let dir = dir();
    let with = "--policy openai --model m --memory working --limit 1 --base-url http://a/v1";
    let output = memtransfer(dir.path(), &format!("plan {with} --out plan.json --slurm"));
    let script = text(&output.stdout);
    assert!(
        script.contains("--quiet --base-url http://a/v1 ||"),
        "{script}{}",
        text(&output.stderr)
    );
    let with = "--policy-cmd ./mine --memory working --limit 1";
    let output = memtransfer(dir.path(), &format!("plan {with} --out own.json --slurm"));
    assert!(
        text(&output.stdout).contains("--quiet --allow-commands ||"),
        "{}",
        text(&output.stderr)
    );
    let output =
        memtransfer(dir.path(), "plan --policy random --limit 1 --out random.json --slurm");
    assert!(text(&output.stdout).contains("--quiet ||"), "{}", text(&output.stderr));
    // An address that the environment named is not one of the command line.
    let with = "plan --policy openai --model m --memory working --limit 1 --out env.json --slurm";
    let output = memtransfer_with(dir.path(), with, &[("MEMTRANSFER_BASE_URL", "http://a/v1")]);
    assert!(text(&output.stdout).contains("--quiet ||"), "{}", text(&output.stderr));
}

/// The author of a downloaded folder does not get the key of the user.
#[test]
fn a_key_is_not_sent_to_an_address_that_a_file_names() {
    const KEY: (&str, &str) = ("OPENAI_API_KEY", "sk-very-secret");
    let dir = dir();
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let url = format!("http://{}/v1", listener.local_addr().unwrap());
    fs::create_dir(dir.path().join("downloaded")).unwrap();
    fs::write(dir.path().join("downloaded/.env"), format!("OPENAI_BASE_URL={url}\n")).unwrap();
    let suite = format!(
        "base-url = \"{url}\"\npolicy = \"openai\"\nmodel = \"m\"\nmemory = [\"working\"]\nlimit = 1"
    );
    fs::write(dir.path().join("suite.toml"), &suite).unwrap();
    fs::create_dir(dir.path().join("downloaded/suites")).unwrap();
    fs::write(dir.path().join("downloaded/suites/mine.toml"), &suite).unwrap();
    for file in ["layout.toml", "catalogue.toml", "cases.toml"] {
        let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets").join(file);
        fs::copy(shipped, dir.path().join("downloaded").join(file)).unwrap();
    }
    let openai = "--policy openai --model m --memory working --limit 1";
    // Its author gave the address on the command line.
    let plan = format!("plan {openai} --base-url {url} --out plan.json");
    assert_eq!(memtransfer(dir.path(), &plan).status.code(), Some(0));
    let in_file = dir.path().join("downloaded");
    for (folder, arguments, place) in [
        (&*in_file, format!("run {openai}"), "the file .env"),
        // Asks for documents first.
        (&in_file, format!("run {openai}").replace("working", "summary"), "the file .env"),
        (&in_file, "doctor --policy openai --model m".to_owned(), "the file .env"),
        (&in_file, "memory build --builder model --model m".to_owned(), "the file .env"),
        (dir.path(), "run --suite ./suite.toml".to_owned(), "the suite or plan"),
        (dir.path(), "run --assets downloaded --suite mine".to_owned(), "the suite or plan"),
        (dir.path(), "work --plan plan.json --unit 0 --out units".to_owned(), "the suite or plan"),
    ] {
        let output = memtransfer_with(folder, &arguments, &[KEY]);
        let said = text(&output.stderr) + &text(&output.stdout);
        assert_ne!(output.status.code(), Some(0), "{arguments}: {said}");
        for part in ["given in the environment", place, &format!("give --base-url {url}")] {
            assert!(said.contains(part), "{arguments}: {part}: {said}");
        }
        assert!(!said.contains(KEY.1) && listener.accept().is_err(), "{arguments}: {said}");
    }
}

/// The commit is that of the build: not of a repository that a variable names, and git is not asked.
#[test]
fn the_commit_of_a_manifest_is_that_of_the_build() {
    let dir = dir();
    let git = dir.path().join("git");
    fs::write(&git, "#!/bin/sh\ntouch started-git\nexec sleep 1000\n").unwrap();
    fs::set_permissions(&git, fs::Permissions::from_mode(0o755)).unwrap();
    let other = dir.path().join("other");
    let path = dir.path().to_str().unwrap();
    let variables = [("PATH", path), ("GIT_DIR", other.to_str().unwrap())];
    let arguments = "plan --policy random --limit 1 --out plan.json";
    let output = memtransfer_with(dir.path(), arguments, &variables);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let plan = fs::read(dir.path().join("plan.json")).unwrap();
    let plan: serde_json::Value = serde_json::from_slice(&plan).unwrap();
    assert_eq!(plan["manifest"]["commit"].as_str(), build_commit::COMMIT);
    assert!(!dir.path().join("started-git").exists());
}

/// A renamed test would leave a claim of the page without one.
#[test]
fn the_tests_that_the_security_page_names_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let page = fs::read_to_string(root.join("docs/security.md")).unwrap();
    let mut sources = String::new();
    let mut folders: Vec<PathBuf> =
        ["crates", "memory-proc", "orchestrator", "shm-types", "tests", "xtask"]
            .map(|folder| root.join(folder))
            .into();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|end| end == "rs") {
                sources += &fs::read_to_string(path).unwrap();
            }
        }
    }
    let is_test = |name: &&str| {
        name.matches('_').count() > 2
            && name.bytes().all(|c| c == b'_' || c.is_ascii_lowercase() || c.is_ascii_digit())
    };
    let named: Vec<&str> = page.split('`').filter(is_test).collect();
    assert!(named.len() > 30, "{named:?}");
    for name in named {
        assert!(sources.contains(&format!("fn {name}()")), "{name}");
    }
}
