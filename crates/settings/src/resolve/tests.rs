use super::*;

fn flags(given: &[(&str, &str)]) -> Layer {
    Layer::flags(given.iter().copied()).unwrap()
}

fn environment(variable: &str, value: &str) -> Layer {
    Layer::environment([(variable.into(), value.into())]).unwrap()
}

fn suite(text: &str) -> Layer {
    Layer::suite("mine.toml", text).unwrap()
}

/// Of the defaults and `layers`.
fn merged(layers: impl IntoIterator<Item = Layer>) -> Result<Resolved> {
    merge([Layer::defaults().unwrap()].into_iter().chain(layers))
}

fn with(given: &[(&str, &str)]) -> Result<Resolved> {
    merged([flags(given)])
}

#[test]
fn the_strongest_source_wins_whatever_the_others_say() {
    use Origin::{CommandLine, Default, Environment, Suite};
    let (file, variable) = (suite("lanes = 2"), environment("MEMTRANSFER_LANES", "3"));
    let flag = flags(&[("lanes", "4")]);
    for (layers, expected, origin) in [
        (vec![], 16, Default),
        (vec![file.clone()], 2, Suite),
        (vec![file.clone(), variable.clone()], 3, Environment),
        (vec![file.clone(), variable, flag], 4, CommandLine),
        (vec![file, flags(&[])], 2, Suite),
    ] {
        let resolved = merged(layers).unwrap();
        assert_eq!((resolved.settings.lanes, resolved.origins["lanes"]), (expected, origin));
    }
}

#[test]
fn the_folder_follows_from_suite_and_policy() {
    let out = |given: &[_]| with(given).unwrap().settings.out.display().to_string();
    assert_eq!(out(&[]), "runs/quick-grounded");
    assert_eq!(out(&[("suite", "mine/small.toml")]), "runs/small-grounded");
    assert_eq!(out(&[("policy", "openai"), ("model", "a/b")]), "runs/quick-openai-a-b");
    assert_eq!(out(&[("out", "elsewhere")]), "elsewhere");
}

#[test]
fn settings_that_contradict_each_other_are_refused() {
    let error = |given: &[_]| with(given).unwrap_err().to_string();
    let nothing = error(&[("starts", "original"), ("routes", "blocked")]);
    assert!(nothing.contains("a blocked route needs the new start"));
    insta::assert_snapshot!(error(&[("model", "m")]), @"--model is for --policy openai, and the policy is grounded");
    insta::assert_snapshot!(error(&[("policy", "openai")]), @"--policy openai needs --model NAME: the model, by the name that the server knows");
    insta::assert_snapshot!(error(&[("backend", "cpu"), ("adapter", "x")]), @"--adapter chooses a graphics adapter, and --backend cpu uses none: give one of them");
    insta::assert_snapshot!(error(&[("plates", "off")]), @"--policy grounded sees nothing but plates, so it cannot run with --plates off: leave that out, or choose another --policy");
    insta::assert_snapshot!(error(&[("memory", "none")]), @"no memory is left: `--memory none` is for a memory of your own (--memory-cmd, or `external` in --memory)");
    insta::assert_snapshot!(error(&[("elsewhere", "w")]), @"--elsewhere is the warehouse of --demos elsewhere, and of documents in the arm `wrong`; no condition has either");
    assert!(with(&[("labels", "off"), ("appearance-seed", "7")]).is_ok());
    let elsewhere = [("world-cmd", "w"), ("policy", "imitate"), ("memory", "summary,hybrid")];
    assert!(with(&elsewhere).is_ok());
    assert!(with(&[&elsewhere[..], &[("documents", "model")]].concat()).is_ok());
    let plates = [&elsewhere[..], &[("plates", "on")]].concat();
    insta::assert_snapshot!(error(&plates), @"--plates is about the warehouse, and --world-cmd names another world: leave one of them out");
    insta::assert_snapshot!(error(&[("window", "6,20")]), @"a request under full-context/original/unchanged/original/h20 may need 61 images (the current view, 20 of the window, 40 of memory), and a prompt holds at most 50: lower --window or --keyframes");
    let long = error(&[("window", "20"), ("horizon", "30"), ("keyframes", "20")]);
    assert!(long.ends_with("lower --window, --hits or --horizon"), "{long}");
    assert!(with(&[("keyframes", "43")]).is_ok(), "50 images");
}

/// The paper's warehouse has no plates, and the policy that cannot do without them says so.
#[test]
fn plates_follow_from_the_policy_where_nothing_else_is_said() {
    use Drawn::{Off, On};
    let of = |policy: &str, others: &[Layer]| {
        let policy = [flags(&[("policy", policy)]), environment("MEMTRANSFER_MODEL", "m")];
        let resolved = merged(others.iter().cloned().chain(policy))?;
        anyhow::Ok((resolved.settings.plates, resolved.origins["plates"]))
    };
    let given = |word| [flags(&[("plates", word)])];
    for &policy in PolicyKind::ALL {
        let name = policy.name();
        let default = if policy == PolicyKind::Grounded { On } else { Off };
        assert_eq!(of(name, &[]).unwrap(), (default, Origin::Policy), "{name}");
        assert_eq!(of(name, &given("on")).unwrap(), (On, Origin::CommandLine), "{name}");
        let variable = environment("MEMTRANSFER_PLATES", "on");
        assert_eq!(of(name, &[variable]).unwrap(), (On, Origin::Environment), "{name}");
        let without = of(name, &[suite("plates = \"off\"")]);
        match policy {
            PolicyKind::Grounded => assert!(without.is_err()),
            _ => assert_eq!(without.unwrap(), (Off, Origin::Suite), "{name}"),
        }
    }
    let shown = with(&[("policy", "imitate")]).unwrap().to_string();
    let line = shown.lines().find(|line| line.starts_with("plates"));
    assert!(line.is_some_and(|line| line.ends_with("# policy")), "{shown}");
    let every: Vec<&str> = Representation::ALL.iter().map(|memory| memory.name()).collect();
    let memories = ("memory", &*every.join(","));
    assert!(with(&[("policy", "imitate"), memories]).is_ok(), "no memory needs plates");
}

#[test]
fn documents_are_by_the_model_of_a_run_that_has_one() {
    use Origin::{CommandLine, Environment, Policy, Suite};
    let openai = flags(&[("policy", "openai"), ("model", "m")]);
    let of_suite = suite("documents = \"extractive\"");
    let of_environment = environment("MEMTRANSFER_DOCUMENTS", "./mine");
    let given = flags(&[("policy", "openai"), ("model", "m"), ("documents", "extractive")]);
    for (layers, expected, origin) in [
        (vec![openai.clone()], "model", Policy),
        (vec![of_suite, openai.clone()], "extractive", Suite),
        (vec![of_environment, openai], "./mine", Environment),
        (vec![given], "extractive", CommandLine),
        (vec![], "extractive", Policy),
        (vec![flags(&[("policy-cmd", "mine")])], "extractive", Policy),
        (vec![flags(&[("policy", "imitate"), ("documents", "model")])], "model", CommandLine),
    ] {
        let resolved = merged(layers).unwrap();
        assert_eq!(resolved.settings.documents.to_string(), expected);
        assert_eq!(resolved.origin("documents"), Some(origin));
    }
}

#[test]
fn variables_for_another_policy_are_ignored_and_flags_refused() {
    for (key, value) in [("policy-cmd", "mine"), ("model", "m")] {
        let variable =
            environment(&format!("MEMTRANSFER_{}", key.replace('-', "_").to_uppercase()), value);
        let settings = merged([variable, flags(&[("policy", "random")])]).unwrap().settings;
        assert!(settings.policy_cmd.is_none() && settings.model.is_none(), "{key}");
        assert!(with(&[(key, value), ("policy", "random")]).is_err(), "{key}");
    }
    let alone = merged([environment("MEMTRANSFER_POLICY_CMD", "mine")]).unwrap().settings;
    assert_eq!((alone.policy, alone.policy_cmd.as_deref()), (PolicyKind::External, Some("mine")));
}

#[test]
fn settings_are_shown_as_a_suite_file() {
    let quick = load_suite(&SuiteName::quick(), None).unwrap();
    let resolved = merged([quick, flags(&[("lanes", "4")])]).unwrap();
    insta::assert_snapshot!(resolved);
    let read_again = |resolved: &Resolved| merged([suite(&resolved.to_string())]).unwrap().settings;
    assert_eq!(read_again(&resolved).lanes, 4);
    let resolved = merged([suite(GROUPS)]).unwrap();
    insta::assert_snapshot!("groups-as-a-suite-file", resolved);
    assert_eq!(read_again(&resolved), resolved.settings);
}

#[test]
fn external_memories_join_the_groups_once_they_have_told_their_names() {
    let given =
        [("memory", "working,external"), ("memory-cmd", "python a.py, b"), ("starts", "new")];
    let layer = flags(&[&given[..], &[("memory-cmd", "./c")]].concat());
    let resolved = merged([layer]).unwrap();
    let shown = resolved.to_string();
    assert!(shown.contains("memory = [\"working\",\"external\"]"), "{shown}");
    assert!(shown.contains("memory-cmd = [\"python a.py, b\",\"./c\"]"), "{shown}");
    let again = merged([suite(&shown)]).unwrap().settings;
    let mut settings = resolved.settings;
    assert_eq!(again, settings);
    assert_eq!((settings.memory_cmd.len(), settings.external_memory), (2, true));
    settings.add_external_memories(&["a", "top-3"].map(|name| (name.parse().unwrap(), false)));
    let conditions: Vec<String> = settings.conditions().iter().map(ToString::to_string).collect();
    assert_eq!(
        conditions,
        ["working/new/unchanged/none", "a/new/unchanged/original", "top-3/new/unchanged/original"]
    );
    // Alone they are enough, and a suite's group of working memory alone stays as it is.
    assert!(with(&[("memory", "external")]).is_ok());
    let only = with(&[("memory", "none"), ("memory-cmd", "a")]).unwrap();
    assert!(only.to_string().contains("memory = [\"none\"]"), "{only}");
    assert!(only.settings.groups[0].memory.is_empty());
    let error = with(&[("memory", "none")]).unwrap_err().to_string();
    assert!(error.starts_with("no memory is left"), "{error}");
    let groups = "[[group]]\nname = \"w\"\nmemory = [\"working\"]\n[[group]]\nname = \"e\"\n\
                  memory = [\"episodic\"]";
    let layer = suite(&format!("memory-cmd = [\"a\"]\n{groups}"));
    let mut settings = merged([layer]).unwrap().settings;
    settings.add_external_memories(&[("a".parse().unwrap(), true)]);
    let counts: Vec<usize> = settings.groups.iter().map(|group| group.memory.len()).collect();
    assert_eq!(counts, [1, 2]);
}

#[test]
fn external_memories_are_of_no_use_to_a_policy_without_memory() {
    let of = |policy, given: &[_]| {
        let layers = [suite("memory-cmd = [\"a\"]"), flags(&[("policy", policy)]), flags(given)];
        merged(layers).unwrap().settings
    };
    assert_eq!(of("grounded", &[]).memory_cmd, ["a"]);
    assert!(!of("random", &[]).has_external_memories());
    assert_eq!(of("random", &[("memory-cmd", "b")]).memory_cmd, ["b"]);
    let given = [("memory-cmd", "b"), ("memory", "external")];
    assert!(!of("expert", &given).has_external_memories());
    let nine: Vec<(&str, &str)> = vec![("memory-cmd", "x"); 9];
    let error = with(&nine).unwrap_err().to_string();
    assert!(error.starts_with("the run has 9 external memories"), "{error}");
    let settings = with(&[("memory-images", "50")]);
    assert!(settings.is_ok(), "no built-in memory supplies as many");
}

const GROUPS: &str = r#"
runs = 3
memory = ["working"]
out = "elsewhere"

[[group]]
name = "one"
starts = ["original"]

[[group]]
name = "two"
memory = ["episodic", "summary"]
demos = ["4"]
window = [0, 6]
runs = 5
"#;

fn in_groups(policy: &str, given: &[(&str, &str)]) -> String {
    let policy = suite(&format!("policy = \"{policy}\"\n{GROUPS}"));
    let resolved = merged([policy, flags(given)]).unwrap();
    let conditions = resolved.settings.runs();
    let shown = conditions.iter().map(|(condition, runs)| format!("{condition} x{runs}"));
    shown.collect::<Vec<_>>().join("\n")
}

#[test]
fn the_top_level_holds_in_groups_and_flags_replace_both() {
    insta::assert_snapshot!(in_groups("grounded", &[]), @"
    working/original/unchanged/none x3
    episodic/original/unchanged/4/h0 x5
    episodic/original/unchanged/4 x5
    episodic/new/unchanged/4/h0 x5
    episodic/new/unchanged/4 x5
    summary/original/unchanged/4/h0 x5
    summary/original/unchanged/4 x5
    summary/new/unchanged/4/h0 x5
    summary/new/unchanged/4 x5
    ");
    let given = [("memory", "episodic"), ("starts", "new"), ("runs", "2")];
    insta::assert_snapshot!(in_groups("grounded", &given), @"
    episodic/new/unchanged/original x2
    episodic/new/unchanged/4/h0 x2
    episodic/new/unchanged/4 x2
    ");
}

#[test]
fn a_policy_that_ignores_memory_runs_once_for_all_memories() {
    insta::assert_snapshot!(in_groups("expert", &[]), @"
    working/original/unchanged/none x1
    working/new/unchanged/none x1
    ");
    insta::assert_snapshot!(in_groups("random", &[]), @"
    working/original/unchanged/none x5
    working/new/unchanged/none x5
    ");
    // Asked for, to measure what memory costs.
    let episodic = [("memory", "episodic")];
    insta::assert_snapshot!(in_groups("random", &episodic), @"
    episodic/original/unchanged/original x3
    episodic/original/unchanged/4 x5
    episodic/new/unchanged/4 x5
    ");
    insta::assert_snapshot!(in_groups("expert", &episodic), @"
    working/original/unchanged/none x1
    working/new/unchanged/none x1
    ");
}

const STREAM: &str = r#"
memory = ["working", "episodic"]
starts = ["new"]
arms = ["frozen", "learning", "oracle"]

[stream]
streams = 3
blocks = 2
cases-per-block = 2
rounds = 1
events = ["swap"]
orders = ["drawn"]
feedback = "none"
"#;

#[test]
fn flags_replace_parts_of_the_stream_table() {
    let with = |text: &str, given: &[_]| merged([suite(text), flags(given)]);
    let given = [("streams", "7"), ("feedback", "sub-goals"), ("orders", "reversed,drawn")];
    let resolved = with(STREAM, &given).unwrap();
    let stream = resolved.settings.stream.as_ref().unwrap();
    assert_eq!((stream.streams, stream.blocks, stream.rounds), (7, 2, 1));
    assert_eq!((stream.feedback.word(), stream.orders.len()), ("sub-goals", 2));
    assert!(stream.evaluate);
    assert_eq!(stream.all_episodes(), 7 * 2 * (2 * 2 + 3 * 2 * 2));
    let conditions: Vec<String> =
        resolved.settings.conditions().iter().map(ToString::to_string).collect();
    let frozen = "episodic/new/unchanged/original";
    assert_eq!(conditions, ["working/new/unchanged/none", frozen, &format!("{frozen}/oracle")]);
    // An external memory has the arms that there are of it.
    let mut settings = with(STREAM, &[("memory-cmd", "a,b")]).unwrap().settings;
    settings.add_external_memories(&["a", "b"].map(|name| (name.parse().unwrap(), name == "a")));
    let conditions: Vec<String> =
        settings.conditions().iter().map(ToString::to_string).skip(3).collect();
    let [a, b] = ["a", "b"].map(|name| format!("{name}/new/unchanged/original"));
    let expected = [a.clone(), format!("{a}/learning"), format!("{a}/oracle")];
    assert_eq!(conditions, [&expected[..], &[b.clone(), format!("{b}/oracle")]].concat());
    // What is shown is a suite file with the same meaning.
    let shown = resolved.to_string();
    assert!(shown.contains("\n[stream]\n") && shown.contains("rounds = 1"), "{shown}");
    let again = merged([suite(&shown)]).unwrap();
    assert_eq!(again.settings.stream, resolved.settings.stream);

    let error = |text: &str, given: &[_]| with(text, given).unwrap_err().to_string();
    for (text, given, expected) in [
        ("", &[("rounds", "2")][..], "--rounds is for a suite of streams"),
        ("", &[("arms", "learning")], "--arms learning is for a suite of streams"),
        (STREAM, &[("starts", "original")], "in a suite of streams every episode begins"),
    ] {
        let error = error(text, given);
        assert!(error.contains(expected), "{error}");
    }
    let variable = environment("MEMTRANSFER_ROUNDS", "2");
    assert!(merged([variable]).is_ok(), "it is for other runs");
    let unknown = Layer::suite("my.toml", &STREAM.replace("rounds", "turns")).unwrap_err();
    assert!(unknown.to_string().starts_with("suite my.toml, stream: unknown field `turns`"));
}

#[test]
fn arms_outside_of_streams_are_controls_beside_each_memory() {
    let suite = |name: &str| {
        let text = std::fs::read_to_string(format!("../../assets/suites/{name}.toml")).unwrap();
        Layer::suite(name, &text).unwrap()
    };
    let conditions = |name, given: &[_]| -> Vec<String> {
        let settings = merged([suite(name), flags(given)]).unwrap().settings;
        settings.conditions().iter().map(ToString::to_string).collect()
    };
    let arms = ("arms", "frozen,oracle,wrong");
    insta::assert_snapshot!(conditions("rq2", &[arms, ("memory", "working,summary,episodic")]).join("\n"), @"
    working/new/unchanged/none
    working/new/blocked/none
    summary/new/unchanged/4
    summary/new/unchanged/original/oracle
    summary/new/unchanged/original/wrong
    summary/new/blocked/4
    summary/new/blocked/original/oracle
    summary/new/blocked/original/wrong
    episodic/new/unchanged/4
    episodic/new/unchanged/original/oracle
    episodic/new/unchanged/4/wrong
    episodic/new/blocked/4
    episodic/new/blocked/original/oracle
    episodic/new/blocked/4/wrong
    ");
    insta::assert_snapshot!(conditions("rq1", &[arms, ("memory", "episodic")]).join("\n"), @"
    episodic/original/unchanged/original
    episodic/original/unchanged/original/wrong
    episodic/new/unchanged/original
    episodic/new/unchanged/original/oracle
    episodic/new/unchanged/original/wrong
    episodic/original/unchanged/opposite
    episodic/original/unchanged/nearby
    episodic/original/unchanged/distant
    ");
    let frozen = merged([suite("rq1")]).unwrap();
    assert!(!frozen.settings.demonstrates_elsewhere());
    assert_eq!(
        frozen.settings,
        merged([suite("rq1"), flags(&[("arms", "frozen")])]).unwrap().settings
    );
    assert!(!serde_json::to_string(&frozen.settings).unwrap().contains("arms"));
    let documents = merged([suite("rq1"), flags(&[("arms", "wrong")])]).unwrap();
    assert!(documents.settings.demonstrates_elsewhere());
    let of_other_world =
        [("arms", "wrong"), ("policy", "imitate"), ("world-cmd", "w"), ("memory", "summary")];
    insta::assert_snapshot!(merged([suite("rq2"), flags(&of_other_world)]).unwrap_err(), @"summary/new/unchanged/original/wrong: the documents of summary memory are of all cases, so wrong ones are those of another warehouse, and --world-cmd names a world that has none: leave `wrong` out of --arms, or summary out of --memory");
    let set = Layer::flags([("demos", "wrong-1")]).unwrap_err();
    insta::assert_snapshot!(set, @"--demos: `wrong-1` is held in a control arm: give --arms oracle or --arms wrong");
}

/// The user has written the command line, and may not have read the suite.
#[test]
fn commands_of_a_suite_are_distinguished_from_those_of_the_command_line() {
    let of_suite = suite("policy-cmd = \"p\"\nmemory-cmd = [\"a\", \"b\"]");
    let of = |layers: Vec<Layer>| {
        let resolved = merge([Layer::defaults().unwrap()].into_iter().chain(layers)).unwrap();
        let all = commands(&resolved.settings).unwrap();
        (all, resolved.commands_of_suite().unwrap())
    };
    let owned = |list: &[(&'static str, &str)]| -> Vec<_> {
        list.iter().map(|(key, command)| (*key, (*command).to_owned())).collect()
    };
    let (all, from_file) = of(vec![of_suite.clone()]);
    assert_eq!(all, owned(&[("policy-cmd", "p"), ("memory-cmd", "a"), ("memory-cmd", "b")]));
    assert_eq!(from_file, all);
    let (all, from_file) = of(vec![of_suite, flags(&[("memory-cmd", "c")])]);
    assert_eq!(all, owned(&[("policy-cmd", "p"), ("memory-cmd", "c")]));
    assert_eq!(from_file, owned(&[("policy-cmd", "p")]));
    let (all, from_file) = of(vec![flags(&[("policy-cmd", "q")])]);
    assert_eq!((all.len(), from_file.len()), (1, 0));
    // Every key whose value is a command is known as one: others accept a quote that is not closed.
    for key in KEYS {
        let is_open = key.check(&"a 'b".into()).is_err() && key.check(&"a b".into()).is_ok();
        let in_list = key.check(&json!(["a 'b"])).is_err() && key.check(&json!(["a b"])).is_ok();
        assert_eq!(key.is_command(), is_open || in_list, "{}", key.name);
    }
}

#[test]
fn a_world_is_the_warehouse_or_one_that_a_command_or_the_user_starts() {
    let of = |layers: &[Layer]| {
        let imitate = flags(&[("policy", "imitate"), ("memory", "episodic")]);
        merged([vec![imitate], layers.to_vec()].concat()).map(|resolved| resolved.settings)
    };
    let command = environment("MEMTRANSFER_WORLD_CMD", "python world.py");
    let external = of(&[command.clone(), flags(&[("world-book", "book")])]).unwrap();
    assert_eq!((external.world, external.world_cmd.as_deref()), (Some(WorldStart::External), None));
    let book = suite("world = \"external\"\nworld-book = \"book\"");
    let started = of(&[book.clone(), command]).unwrap();
    assert_eq!((started.own_world(), &started.world_book), (Some("--world-cmd"), &None));
    let error = |layers: &[Layer]| of(layers).unwrap_err().to_string();
    let alone = error(&[flags(&[("world", "external")])]);
    assert!(alone.starts_with("--world external needs --world-book DIR"), "{alone}");
    let both = error(&[flags(&[("world-cmd", "mine"), ("world-book", "book")])]);
    assert!(both.contains("give one of them"), "{both}");
    let adapter = error(&[book, flags(&[("adapter", "llvmpipe")])]);
    assert!(adapter.contains("--world external names another world"), "{adapter}");
}

#[test]
fn a_stream_has_one_world() {
    let stream = load_suite(&"stream".parse().unwrap(), None).unwrap();
    let error = merged([stream, flags(&[("worlds", "2")])]).unwrap_err().to_string();
    assert!(error.starts_with("--worlds is 2, and a suite of streams has one"), "{error}");
}
