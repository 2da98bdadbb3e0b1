//! The pages of `memtransfer view` in a real browser.

mod server;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use case_book::EpisodeFacts;
use domain::prompt_log::PromptLogEntry;
use memtransfer_tests::browser::Browser;
use memtransfer_tests::{Bench, records};
use rigs::records::without_checksums;
use run_log::{EpisodeRecord, RunLog};
use serde_json::{Value, json};

/// A run on blocked routes, in which some agents run into the barricade.
fn blocked(bench: &Bench, out: &str, memory: &str, more: &[&str]) -> PathBuf {
    let mut args = vec!["run", "--suite", "rq2", "--policy", "grounded", "--runs", "1"];
    args.extend(["--memory", memory, "--out", out]);
    bench.run(&[&args[..], more].concat()).expect(0);
    bench.out(out)
}

const MEMORIES: &str = "working,full-context,episodic";

/// The pages of `runs` as files; returns the address of the first.
fn bundle(bench: &Bench, runs: &[&Path], more: &[&str]) -> String {
    let mut args = vec!["view"];
    args.extend(runs.iter().map(|run| run.to_str().unwrap()));
    let pages = bench.out("pages");
    args.extend(["--out", pages.to_str().unwrap()]);
    let ended = bench.run(&[&args[..], more].concat()).expect(0);
    format!("file://{}", ended.stdout.trim())
}

fn assert_no_problem(browser: &mut Browser) {
    assert_eq!(browser.problems(), [""; 0]);
}

const EPISODE: &str = "document.querySelector('.transport output') !== null";
const STEP: &str = ".transport output";

#[test]
fn five_clicks_lead_from_a_run_to_the_step_that_decided_a_failure() {
    let bench = Bench::new();
    let run = blocked(&bench, "rq2", MEMORIES, &["--cases", "t01-04,t02-02"]);
    let url = bundle(&bench, &[&run], &["--episodes", "all"]);
    let mut browser = Browser::start(1300, 1000);
    browser.open(&url);
    browser.wait_for("document.querySelectorAll('td a.mark').length === 12");
    let notice = browser.text(".notice");
    assert!(notice.starts_with("Policy: grounded, scripted stand-in."), "{notice}");

    // 1: the failures of one kind. 2: an episode.
    browser.click(".outcomes button:has(.failure-blocked)");
    let left = browser.value("document.querySelectorAll('td a.mark:not(.faded)').length");
    assert!(left.as_u64().unwrap() > 0 && left.as_u64().unwrap() < 12, "{left}");
    browser.click("td a.mark.failure-blocked");
    browser.wait_for(EPISODE);
    let heading = browser.text(".heading");
    assert!(heading.contains("policy: grounded, scripted stand-in"), "{heading}");
    let story = browser.text(".story");
    assert!(story.contains("closed passage") && story.contains("Failed, blocked"), "{story}");
    // Every letter on the map has the name of its item.
    let unnamed = "[...document.querySelectorAll('.map-targets text')].map((text) => text.textContent[0]) \
        .filter((letter) => ![...document.querySelectorAll('.legend li')].some((entry) => entry.textContent.includes(`${letter}: `)))";
    browser.wait_for("document.querySelector('.map-targets text') !== null");
    assert_eq!(browser.value(unnamed), json!([]));
    // 3: the step.
    browser.click(".story .step-link");
    let decided: u32 = story
        .split("at step ")
        .nth(1)
        .unwrap()
        .split(|c: char| !c.is_ascii_digit())
        .next()
        .unwrap()
        .parse()
        .unwrap();
    assert!(browser.text(STEP).starts_with(&format!("Step {decided} of")), "{story}");
    assert!(browser.text(".happening").contains("The agent tried to enter the closed passage."));
    browser.wait_for("document.querySelector('img.view').naturalWidth === 320");
    // 4: where memory has it from.
    browser.click("section[aria-label=Memory] .source");
    browser.wait_for("document.querySelectorAll('.source-panel .film img').length > 0");
    browser.wait_for("[...document.querySelectorAll('.source-panel .film img')].every((i) => i.naturalWidth === 160)");
    assert!(browser.text(".source-panel h2").contains("demonstration"));

    // The address has the state: another page that opens it shows the same.
    let address = browser.value("location.href");
    let step = browser.text(STEP);
    browser.open("about:blank");
    browser.open(address.as_str().unwrap());
    browser.wait_for(EPISODE);
    assert_eq!(browser.text(STEP), step);
    browser.wait_for("document.querySelector('.source-panel').hidden === false");

    // Keys.
    browser.value("document.getElementById('main').focus()");
    for (key, expected) in [
        ("End", "Step 200 of 200"),
        ("Home", "Step 0 of 200"),
        ("ArrowRight", "Step 1 of 200"),
        ("ArrowRight", "Step 2 of 200"),
        ("ArrowLeft", "Step 1 of 200"),
        ("f", &format!("Step {decided} of 200")),
        ("p", ""),
        ("n", &format!("Step {decided} of 200")),
    ] {
        browser.press(key);
        let shown = browser.text(STEP);
        assert!(expected.is_empty() || shown == expected, "{key}: {shown}");
    }
    browser.press("Home");
    browser.press(" ");
    browser.wait_for("Number(document.querySelector('.transport input').value) > 2");
    browser.press(" ");
    assert_eq!(browser.text(".play"), "Play");

    // Side by side, at the first difference.
    let other = browser.value("document.querySelector('.compare option:nth-child(2)').value");
    browser.choose(".compare select", other.as_str().unwrap());
    browser.wait_for("document.querySelectorAll('.pair > section').length === 2");
    let words = browser.text(".divergence");
    let same = words.split("until step ").nth(1).unwrap().split('.').next().unwrap().to_owned();
    assert!(browser.text(STEP).starts_with(&format!("Step {same} of")), "{words}");
    let poses = "memtransfer.state().step";
    assert_eq!(browser.value(poses), same.as_str());
    assert_no_problem(&mut browser);
}

#[test]
fn a_failure_is_compared_with_the_success_that_it_follows_longest() {
    let bench = Bench::new();
    let mut args = vec!["run", "--policy", "grounded", "--cases", "t02-02", "--starts", "new"];
    args.extend(["--memory", "working,semantic", "--out", "run"]);
    bench.run(&args).expect(0);
    let run = bench.out("run");
    let log = RunLog::read(&run).unwrap();
    let (failed, success) = (
        log.episodes.iter().find(|record| !record.is_success()).unwrap(),
        log.episodes.iter().find(|record| record.is_success()).unwrap(),
    );
    let shown = bench.run(&["show", run.to_str().unwrap(), &failed.key, "--json"]).expect(0);
    let points = serde_json::from_str::<Value>(&shown.stdout).unwrap()["points"].take();
    assert!(points["loops"].is_array(), "{points}");
    assert_eq!(points["divergence"]["success"], success.key.as_str());
    let step = points["divergence"]["step"].as_u64().unwrap();

    let url = bundle(&bench, &[&run], &["--episodes", "all"]);
    let mut browser = Browser::start(1300, 1000);
    browser.open(&url);
    browser.click("td a.mark:not(.success)");
    browser.wait_for(EPISODE);
    let story = browser.text(".story");
    assert!(story.contains(&format!("First unlike a success: step {step}.")), "{story}");
    assert!(story.contains("Last progress: none."), "{story}");
    browser.value("document.getElementById('main').focus()");
    browser.press("d");
    assert!(browser.text(STEP).starts_with(&format!("Step {step} of")));
    assert!(browser.text(".happening").contains("From here unlike a success of the same case."));
    browser.click(".story .points a");
    browser.wait_for("document.querySelectorAll('.pair > section').length === 2");
    assert!(browser.text(STEP).starts_with(&format!("Step {step} of")));
    assert!(browser.text(".divergence").contains(&format!("until step {step}.")));
    assert_no_problem(&mut browser);
}

/// Whether each entry of the legend has the number of its marks in the grid, and the headings that of the successes.
const COUNTED: &str = "(() => { \
    const marks = (kind) => document.querySelectorAll(`td a.mark.${kind}`).length; \
    const counts = [...document.querySelectorAll('.outcomes button')].map((button) => \
      [[...button.querySelector('.mark').classList].pop(), Number(button.querySelector('b').textContent)]); \
    const successes = [...document.querySelectorAll('thead tr:last-child th[scope=col]')] \
      .reduce((sum, heading) => sum + Number(heading.textContent.split('/')[0]), 0); \
    return counts.every(([kind, count]) => count === marks(kind)) && successes === marks('success'); \
  })()";

#[test]
fn the_grid_is_filtered_sorted_and_used_with_keys_and_every_state_has_an_address() {
    let bench = Bench::new();
    let run = blocked(&bench, "a", MEMORIES, &["--limit", "20", "--max-steps", "20"]);
    let short = ["--seed", "2", "--limit", "5", "--max-steps", "20"];
    let other = blocked(&bench, "b", MEMORIES, &short);
    let url = bundle(&bench, &[&run, &other], &["--episodes", "2"]);
    let mut browser = Browser::start(1300, 1000);
    browser.open(&url);
    browser.wait_for("document.querySelectorAll('td a.mark').length === 120");
    // A screen reader passes arrow keys to a grid. Each part of a condition has a label.
    assert_eq!(browser.value("document.querySelector('.grid > table').role"), "grid");
    let headings = "[...document.querySelectorAll('thead tr')].map((row) => [row.cells[0].textContent, row.cells[1].textContent])";
    let log = RunLog::read(&run).unwrap();
    let is_success = |record: &&EpisodeRecord| {
        record.key.starts_with("working/new/unchanged/none/") && record.is_success()
    };
    let successes = log.episodes.iter().filter(is_success).count();
    assert_eq!(
        browser.value(headings),
        json!([
            ["memory", "Working memory"],
            ["start", "new"],
            ["route", "unchanged"],
            ["demonstrations", "none"],
            ["successes", format!("{successes}/20")],
        ])
    );
    assert_eq!(browser.value(COUNTED), true);
    let wider = "getComputedStyle(document.querySelector('.grid'), '::before').height !== '0px'";
    assert_eq!(browser.value(wider), false);
    // Tab reaches one episode; arrow keys move among the others.
    assert_eq!(browser.value("document.querySelectorAll('td a.mark[tabindex=\"0\"]').length"), 1);
    browser.value("document.querySelector('td a.mark[tabindex=\"0\"]').focus()");
    browser.press("ArrowRight");
    browser.press("ArrowDown");
    let focused = "(() => { const c = document.activeElement.closest('td'); return [c.cellIndex, c.parentElement.sectionRowIndex]; })()";
    assert_eq!(browser.value(focused), json!([2, 1]));
    browser.press("Enter");
    browser.wait_for(EPISODE);
    browser.value("history.back()");
    browser.wait_for("document.querySelectorAll('td a.mark').length === 120");

    // The grid is where it was left.
    let scrolled = "[document.querySelector('.grid').scrollTop, window.scrollY]";
    browser.value("document.querySelector('.grid').scrollTo(0, 40)");
    browser.value("window.scrollTo(0, 30)");
    assert_eq!(browser.value(scrolled), json!([40, 30]));
    browser.value("document.querySelector('tr:nth-child(9) a.mark').click()");
    browser.wait_for(EPISODE);
    assert_eq!(browser.value("window.scrollY"), 0);
    browser.value("history.back()");
    browser.wait_for("document.querySelectorAll('td a.mark').length === 120");
    assert_eq!(browser.value(scrolled), json!([40, 30]));

    browser.choose("select[name=memory]", "episodic");
    browser.wait_for("document.querySelectorAll('td a.mark').length === 40");
    assert_eq!(browser.value(COUNTED), true);
    // What was retrieved for the first step, and how far it was.
    browser.click("td a.mark");
    browser.wait_for(EPISODE);
    browser.press("Home");
    let key = browser.value("new URLSearchParams(location.hash.slice(1)).get('key')");
    let record = records(&run).into_iter().find(|record| record["key"] == key).unwrap();
    let distance = record["distances"].as_str().unwrap().split(' ').next().unwrap();
    let supplied = browser.text(".item");
    assert!(supplied.contains(&format!("Distance: {distance}.")), "{supplied}");
    browser.value("history.back()");
    browser.wait_for("document.querySelectorAll('td a.mark').length === 40");
    browser.choose("select[name=memory]", "");
    let conditions: Vec<String> =
        serde_json::from_value(browser.value("memtransfer.runs[0].conditions.map((c) => c.name)"))
            .unwrap();
    browser.choose("select[name=a]", &conditions[0]);
    browser.choose("select[name=b]", &conditions[1]);
    browser.wait_for("document.querySelectorAll('td a.mark').length < 120");
    assert_eq!(browser.value(COUNTED), true);
    let rows = browser.value("document.querySelectorAll('tbody tr').length");
    assert_eq!(browser.value("document.querySelectorAll('a.pair').length"), rows);
    let address = browser.value("location.href");
    browser.open("about:blank");
    browser.open(address.as_str().unwrap());
    browser.wait_for("document.querySelectorAll('tbody tr').length > 0");
    assert_eq!(browser.value("document.querySelectorAll('tbody tr').length"), rows);
    browser.click("a.pair");
    browser.wait_for("document.querySelectorAll('.pair > section').length === 2");

    // The other run, and the report's tables.
    browser.open(&format!("{url}#run=2"));
    browser.wait_for("document.querySelector('h1').textContent === 'b'");
    browser.click(".tables summary");
    browser.wait_for("document.querySelector('iframe') !== null");

    // On a phone nothing is wider than the page.
    browser.resize(390, 800);
    let key = browser.value("encodeURIComponent(memtransfer.runs[0].episodes[0][0])");
    let key = key.as_str().unwrap();
    for state in ["#run=1", "#page=episode&run=1&key=", "#page=episode&run=2&key="] {
        let key = if state.ends_with('=') { key } else { "" };
        browser.open(&format!("{url}{state}{key}"));
        let shown = if state.ends_with('=') {
            EPISODE
        } else {
            "document.querySelector('td a.mark') !== null"
        };
        browser.wait_for(shown);
        let overflow = "document.documentElement.scrollWidth <= 390";
        assert_eq!(browser.value(overflow), true, "{state}");
        if state == "#run=1" {
            // The grid is, and says so.
            browser.wait_for(wider);
        }
    }
    // The words of a report stay whole.
    browser.resize(320, 800);
    let report = "new URL(`${memtransfer.runs[0].folder}/report.html`, location.href).href";
    let report = browser.value(report);
    browser.open(report.as_str().unwrap());
    let words = "[...document.querySelectorAll('.facts td')].filter((cell) => /^\\S{1,9}$/.test(cell.textContent) && !cell.childElementCount)";
    let lines = "((cell) => { const range = document.createRange(); range.selectNodeContents(cell); return range.getClientRects().length; })";
    browser.wait_for(&format!("{words}.length > 3"));
    assert_eq!(browser.value(&format!("{words}.filter((cell) => {lines}(cell) > 1).length")), 0);
    // Tables and figures that are wider than the page say so, and others do not.
    browser.wait_for(
        "(() => { const parts = [...document.querySelectorAll('.scroll, .plot')]; \
           const isWide = (part) => part.scrollWidth > part.clientWidth; \
           const says = (part) => getComputedStyle(part, '::before').height !== '0px'; \
           return parts.some(isWide) && !parts.every(isWide) && parts.every((part) => isWide(part) === says(part)); \
         })()",
    );
    browser.resize(390, 800);
    // What the old page still does has no effect on a new address.
    browser.open(&format!("{url}#page=episode&run=1&key={key}"));
    browser.wait_for(EPISODE);
    let opened = "(() => { location.hash = '#run=2'; document.querySelector('.transport input').dispatchEvent(new Event('input')); return location.hash; })()";
    assert_eq!(browser.value(opened), "#run=2");
    browser.wait_for("document.querySelector('h1').textContent === 'b'");
    // An address of nothing says so.
    browser.open(&format!("{url}#page=episode&run=1&key=nothing"));
    browser.wait_for("document.querySelector('[role=alert]') !== null");
    assert_no_problem(&mut browser);
}

#[test]
fn a_phone_shows_a_result_of_a_ranking_without_scrolling() {
    let bench = Bench::new();
    let how = ["--cases", "t02-02", "--max-steps", "20"];
    let (a, b) = (blocked(&bench, "a", MEMORIES, &how), blocked(&bench, "b", MEMORIES, &how));
    bench.run(&["report", a.to_str().unwrap(), b.to_str().unwrap(), "--out", "both"]).expect(0);
    let mut browser = Browser::start(390, 844);
    browser.open(&format!("file://{}", bench.out("both/report.html").display()));
    browser.wait_for("document.querySelector('#ranking-1') !== null");
    let heading = browser.value(
        "[...document.querySelectorAll('#ranking-1 thead th')].slice(0, 3).map((one) => one.textContent)",
    );
    assert_eq!(heading, json!(["Run", "Memory", "SR %"]));
    let place = "(() => { const { right, bottom } = document.querySelector('#ranking-1 tbody td:nth-child(3)').getBoundingClientRect(); return [right, bottom]; })()";
    let place = browser.value(place);
    assert!(place[0].as_f64() <= Some(390.0) && place[1].as_f64() <= Some(844.0), "{place}");
    assert_no_problem(&mut browser);
}

/// The value that a data script of a bundle passes to the page.
fn data(pages: &Path, name: &str) -> Value {
    let text = fs::read_to_string(pages.join(format!("{name}.js"))).unwrap();
    let value = text.split_once(',').unwrap().1.trim_end().strip_suffix(");").unwrap();
    serde_json::from_str(value).unwrap()
}

#[test]
fn an_episode_of_40_steps_takes_less_than_a_megabyte() {
    let bench = Bench::new();
    let run = blocked(&bench, "r", MEMORIES, &["--limit", "3", "--max-steps", "40"]);
    bundle(&bench, &[&run], &["--episodes", "all"]);
    let pages = bench.out("pages");
    let bytes = |file: &str| fs::metadata(pages.join("run1").join(file)).unwrap().len();
    let count = records(&run).len();
    let mut full_length = 0;
    let mut largest = 0;
    for index in 0..count {
        let episode = data(&pages, &format!("run1/episodes/{index}"));
        full_length += usize::from(episode["steps"] == 40);
        let mut files: Vec<String> = vec![format!("episodes/{index}.js"), "maps/0.svg".into()];
        let demonstrations = episode["demonstrations"].as_array().unwrap();
        let mut views: Vec<&str> = demonstrations
            .iter()
            .chain([&episode])
            .flat_map(|one| one["views"].as_array().unwrap())
            .map(|name| name.as_str().unwrap())
            .filter(|name| !name.is_empty())
            .collect();
        views.sort_unstable();
        views.dedup();
        files.extend(views.iter().map(|view| format!("views/{view}")));
        let total: u64 = files.iter().map(|file| bytes(file)).sum();
        assert!(total < 1_000_000, "{}: {total} bytes", episode["key"]);
        largest = largest.max(total);
    }
    println!("the largest of {count} episodes has {largest} bytes");
    assert!(full_length > 0);
}

#[test]
fn events_of_a_stream_are_told_where_they_happen_in_the_order_of_the_sequence() {
    const SUITE: &str = r#"
memory = ["working"]
arms = ["frozen"]
starts = ["new"]
max-steps = 2

[stream]
streams = 1
blocks = 4
cases-per-block = 1
events = ["swap", "move"]
rounds = 1
orders = ["drawn", "reversed", "shuffled"]
feedback = "success"
"#;
    let bench = Bench::new();
    fs::write(bench.out("suite.toml"), SUITE).unwrap();
    bench.run(&["run", "--suite", "./suite.toml", "--policy", "grounded", "--out", "r"]).expect(0);
    let run = bench.out("r");
    bundle(&bench, &[&run], &["--episodes", "0"]);
    let drawn: Value =
        serde_json::from_str(&fs::read_to_string(run.join("streams.json")).unwrap()).unwrap();
    let place = |record: &Value| {
        let part = &record["stream"];
        (part["order"].as_str().unwrap().to_owned(), part["place"].as_u64().unwrap())
    };
    let block = |record: &Value| record["stream"]["block"].as_u64().unwrap() as usize;
    let records = records(&run);
    let blocks: BTreeMap<_, _> =
        records.iter().map(|record| (place(record), block(record))).collect();
    assert_eq!(blocks.len(), 3 * 4);
    for index in 0..records.len() {
        let episode = data(&bench.out("pages"), &format!("run1/episodes/{index}"));
        let record = records.iter().find(|record| record["key"] == episode["key"]).unwrap();
        let (order, place) = place(record);
        let before = place.checked_sub(1).map_or(0, |before| blocks[&(order.clone(), before)]);
        let way = [before, block(record)];
        let between = way.iter().min().unwrap() + 1..=*way.iter().max().unwrap();
        let events =
            |block: usize| drawn["streams"][0]["blocks"][block]["events"].as_array().unwrap().len();
        assert_eq!(episode["firstBlock"], place == 0);
        let changes = episode["changes"].as_array().unwrap().len();
        assert_eq!(changes, between.map(events).sum::<usize>(), "{order} {way:?}: {episode}");
    }
}

#[test]
fn a_missing_image_of_a_prompt_is_left_out_of_the_pages() {
    let bench = Bench::new();
    let how = ["--log-prompts", "--cases", "t01-01", "--max-steps", "3"];
    let run = blocked(&bench, "r", "working", &how);
    let images = fs::read_dir(run.join("prompts/images")).unwrap();
    let images: Vec<PathBuf> = images.map(|image| image.unwrap().path()).collect();
    fs::remove_file(&images[0]).unwrap();
    let pages = bench.out("pages");
    let args = ["view", run.to_str().unwrap(), "--out", pages.to_str().unwrap()];
    let said = bench.run(&args).expect(0).stderr;
    let warning = format!("warning: missing, left out: {}", images[0].display());
    assert!(said.contains(&warning), "{said}");
    let written = [0, 1].map(|at| {
        let name = Path::new(images[at].file_name().unwrap()).with_extension("jpg");
        pages.join("run1/images").join(name).exists()
    });
    assert_eq!(written, [false, true]);
}

#[test]
fn text_of_a_run_is_never_read_as_a_page() {
    const TEXT: &str = "<img src=x onerror=window.hacked=1><script>window.hacked=1</script>";
    let bench = Bench::new();
    let run = blocked(&bench, "r", "full-context", &["--log-prompts", "--cases", "t01-01"]);
    let quoted = serde_json::to_string(TEXT).unwrap();
    let error = format!("{{\"key\":{quoted},\"session\":1,\"error\":{quoted}}}\n");
    fs::write(run.join("errors.jsonl"), error).unwrap();
    let manifest = run.join("manifest.json");
    let mut json: Value = serde_json::from_str(&fs::read_to_string(&manifest).unwrap()).unwrap();
    json["processes"]["policy"]["policy"] = TEXT.into();
    fs::write(&manifest, json.to_string()).unwrap();
    let log = run.join("prompts/session-1/generation-1.jsonl");
    let exchange = format!(
        "\"exchange\":{{\"messages\":[{{\"role\":{quoted},\"parts\":[{{\"text\":{quoted}}}]}}],\"reply\":{quoted}}},\"timing\""
    );
    let text = fs::read_to_string(&log).unwrap().replace("\"timing\"", &exchange);
    fs::write(&log, text).unwrap();

    let url = bundle(&bench, &[&run], &[]);
    let mut browser = Browser::start(1000, 800);
    browser.open(&url);
    browser.wait_for("document.querySelectorAll('td a.mark').length > 0");
    let page = browser.text("main");
    assert_eq!(page.matches(TEXT).count(), 4, "{page}");
    browser.click("td a.mark");
    browser.click(".prompts summary");
    browser.wait_for("document.querySelectorAll('.prompts pre').length >= 2");
    let prompts = browser.text(".prompts");
    assert_eq!(prompts.matches(TEXT).count(), 3, "{prompts}");
    assert!(prompts.contains("Window of past steps"));
    assert_eq!(browser.value("window.hacked === undefined"), true);
    assert_no_problem(&mut browser);
}

/// What no page may read as anything but text.
const HOSTILE: &str = "\"'><img src=x onerror=window.hacked=1><script>window.hacked=1</script></script>&lt;<svg onload=window.hacked=1>";

/// Puts [`HOSTILE`] into every text of a JSON value, one after the other, where `is_read` accepts the result.
fn poison(value: &mut Value, is_read: &mut dyn FnMut(&Value) -> bool) -> usize {
    fn places(value: &Value, at: &str, found: &mut Vec<String>) {
        match value {
            Value::String(_) => found.push(at.to_owned()),
            Value::Array(list) => {
                list.iter().enumerate().for_each(|(i, of)| places(of, &format!("{at}/{i}"), found));
            }
            Value::Object(fields) => fields.iter().for_each(|(name, of)| {
                let name = name.replace('~', "~0").replace('/', "~1");
                places(of, &format!("{at}/{name}"), found);
            }),
            _ => {}
        }
    }
    let mut found = Vec::new();
    places(value, "", &mut found);
    let mut poisoned = 0;
    for place in found {
        let was = std::mem::replace(value.pointer_mut(&place).unwrap(), HOSTILE.into());
        if is_read(value) {
            poisoned += 1;
        } else {
            *value.pointer_mut(&place).unwrap() = was;
        }
    }
    poisoned
}

#[test]
fn every_text_of_a_run_that_is_read_at_all_is_shown_as_text() {
    let bench = Bench::new();
    let run = blocked(&bench, "r", "full-context", &["--log-prompts", "--cases", "t01-01"]);
    // A page is refused if the facts of the world are not those of a warehouse.
    let facts = |record: &EpisodeRecord| Value::from(record.world.clone());
    let is_told =
        |record: &EpisodeRecord| serde_json::from_value::<EpisodeFacts>(facts(record)).is_ok();
    let is_good = |log: RunLog| log.damaged.is_empty() && log.episodes.iter().all(is_told);
    let good = |run: &Path| RunLog::read(run).is_ok_and(is_good);
    assert!(good(&run));
    let key = records(&run)[0]["key"].clone();
    let error = json!({"key": "k", "session": 1, "error": "e"}).to_string() + "\n";
    fs::write(run.join("errors.jsonl"), error).unwrap();
    let request =
        json!({"key": key, "step": 0, "session": 1, "outcome": "acted"}).to_string() + "\n";
    fs::write(run.join("requests.jsonl"), request).unwrap();
    let mut poisoned = 0;
    for name in
        ["manifest.json", "errors.jsonl", "sessions.jsonl", "timings.jsonl", "episodes.jsonl"]
    {
        let file = run.join(name);
        let mut text = fs::read_to_string(&file).unwrap();
        if name != "manifest.json" {
            text = without_checksums(&text);
        }
        let documents = if name == "manifest.json" { vec![&*text] } else { text.lines().collect() };
        let mut values: Vec<Value> =
            documents.iter().map(|text| serde_json::from_str(text).unwrap()).collect();
        if name == "manifest.json" {
            values[0]["processes"]["policy"]["policy"] = "p".into();
            values[0]["processes"]["policy"][HOSTILE] = "fact".into();
            values[0]["commit"] = "c".into();
        }
        for number in 0..values.len() {
            let mut all = values.clone();
            let mut value = all[number].clone();
            poisoned += poison(&mut value, &mut |value| {
                // Timings belong to their episode by their key.
                if name == "timings.jsonl" && value["key"] == HOSTILE {
                    return false;
                }
                all[number] = value.clone();
                let lines: String = all.iter().map(|value| format!("{value}\n")).collect();
                fs::write(&file, lines).unwrap();
                good(&run)
            });
            values[number] = value;
        }
        let lines: String = values.iter().map(|value| format!("{value}\n")).collect();
        fs::write(&file, lines).unwrap();
        assert!(good(&run), "{name}");
    }
    let log = run.join("prompts/session-1/generation-1.jsonl");
    let mut lines = String::new();
    for line in fs::read_to_string(&log).unwrap().lines() {
        let mut entry: Value = serde_json::from_str(line).unwrap();
        let message = json!({"role": "r", "parts": [{"text": "t"}]});
        entry["exchange"] = json!({"messages": [message], "reply": "r", "unread": "u"});
        entry["failed"] = "f".into();
        let is_hash = |text: &Value| text.as_str().is_some_and(domain::prompt_log::is_hash);
        let hashes = |entry: &Value| {
            entry.to_string().split('"').filter(|text| is_hash(&(*text).into())).count()
        };
        let known = hashes(&entry);
        poisoned += poison(&mut entry, &mut |entry| {
            hashes(entry) == known
                && serde_json::from_value::<PromptLogEntry>(entry.clone()).is_ok()
        });
        let entry: PromptLogEntry = serde_json::from_value(entry).unwrap();
        lines += &(serde_json::to_string(&entry).unwrap() + "\n");
    }
    fs::write(&log, lines).unwrap();
    for document in fs::read_dir(run.join("prompts/documents")).unwrap() {
        let path = document.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "txt") {
            fs::write(path, HOSTILE).unwrap();
        }
    }
    assert!(poisoned > 100, "{poisoned}");

    let folder = run.to_str().unwrap();
    let url = bundle(&bench, &[&run], &[]);
    // The run lacks the episode that was given up.
    bench.run(&["report", folder]).expect(1);
    let copied = Command::new("cp").args(["-r", folder]).arg(bench.out("copy")).status();
    assert!(copied.unwrap().success());
    bench.run(&["report", folder, "copy", "--out", "both"]).expect(1);
    let shown = bench.run(&["show", folder, "t01-01", "0"]);
    assert!(shown.status.is_some_and(|status| status < 3), "{}", shown.stderr);

    let mut browser = Browser::start(1000, 800);
    let check = |browser: &mut Browser, what: &str| {
        let harmless = "window.hacked === undefined \
            && document.querySelector('img[src=x], svg[onload], a[href^=\"javascript:\"]') === null";
        assert_eq!(browser.value(harmless), true, "{what}");
    };
    browser.open(&url);
    browser.wait_for("document.querySelectorAll('td a.mark').length > 0");
    let page = browser.text("main");
    assert!(page.matches("window.hacked=1").count() > 3, "{page}");
    check(&mut browser, "the run's page");
    browser.click("td a.mark");
    browser.click(".prompts summary");
    browser.wait_for("document.querySelectorAll('.prompts pre').length >= 2");
    let prompts = browser.text(".prompts");
    assert!(prompts.matches("window.hacked=1").count() > 3, "{prompts}");
    check(&mut browser, "an episode's page");
    assert_no_problem(&mut browser);
    for page in [
        bench.out("pages/run1/report.html"),
        run.join("report/report.html"),
        bench.out("both/report.html"),
    ] {
        let text = fs::read_to_string(&page).unwrap();
        assert!(text.contains("window.hacked=1"), "{} shows no text of the run", page.display());
        browser.open(&format!("file://{}", page.display()));
        browser.wait_for("document.readyState === 'complete'");
        check(&mut browser, &page.display().to_string());
    }
    assert_no_problem(&mut browser);
}

#[test]
fn a_folder_that_is_no_run_or_not_empty_is_refused() {
    let bench = Bench::new();
    let ended = bench.run(&["view", "nothing", "--out", "pages"]).expect(2);
    assert!(ended.stderr.contains("holds no run"), "{}", ended.stderr);
    let run = blocked(&bench, "r", "working", &["--cases", "t02-02"]);
    let run = run.to_str().unwrap();
    let ended = bench.run(&["view", run, "--out", "r"]).expect(2);
    assert!(ended.stderr.contains("choose another --out"), "{}", ended.stderr);
    // Twice into the same folder; a damaged line is left out and told.
    bench.run(&["view", run, "--out", "pages"]).expect(0);
    let log = bench.out("r/episodes.jsonl");
    let text = fs::read_to_string(&log).unwrap();
    fs::write(&log, text.replacen("{\"key\"", "{\"kez\"", 1)).unwrap();
    bench.run(&["view", run, "--out", "pages"]).expect(0);
    let data = fs::read_to_string(bench.out("pages/run1/run.js")).unwrap();
    assert!(data.contains("1 damaged lines"), "{data}");
    let manifest = bench.out("r/manifest.json");
    fs::write(manifest, "{").unwrap();
    bench.run(&["view", run, "--out", "pages"]).expect(2);
}
