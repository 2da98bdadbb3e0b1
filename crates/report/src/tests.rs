//! The report of a made-up run, and that it is complete.

use conditions::settings::Drawn;
use conditions::{Condition, PolicyKind};
use rigs::records::{model_document, model_settings};
use run_log::{BlockedRecord, EpisodeError, EpisodeRecord};

use super::testing::{made_up, made_up_streams, paper_conditions};
use super::view::THEIRS;
use super::*;

fn published() -> Published {
    Published::paper().unwrap()
}

fn paper_log() -> RunLog {
    made_up(&paper_conditions(), &[1, 2, 3, 4, 5, 6, 7, 8, 9, 10])
}

fn only(names: &[&str]) -> Vec<(Condition, u32)> {
    names.iter().map(|name| (name.parse().unwrap(), 2)).collect()
}

fn titles(document: &ReportDocument) -> Vec<&str> {
    document.sections.iter().map(|section| section.title.as_str()).collect()
}

fn table<'a>(document: &'a ReportDocument, id: &str) -> &'a Table {
    document.tables().find(|table| table.id == id).unwrap()
}

fn texts(row: &TableRow) -> Vec<String> {
    row.cells.iter().map(TableCell::text).collect()
}

/// All texts of `document`, and its tables as CSV.
fn plain(document: &ReportDocument) -> String {
    let block = |block: &ReportBlock| match block {
        ReportBlock::Text(text) => format!("{text}\n"),
        ReportBlock::Notice(text) => format!("Notice: {text}\n"),
        ReportBlock::Terms(terms) => {
            terms.iter().map(|(term, meaning)| format!("{term}: {meaning}\n")).collect()
        }
        ReportBlock::Figure(figure) => format!("Figure: {}\n", figure.caption),
        ReportBlock::Table(table) => {
            let mut rows = Vec::new();
            csv::write_table(table, None, &mut rows).unwrap();
            let notes: String =
                table.notes().iter().map(|note| format!("Note: {note}\n")).collect();
            format!("{}\n{}{notes}", table.caption, String::from_utf8(rows).unwrap())
        }
    };
    let section = |section: &ReportSection| {
        let blocks: Vec<String> = section.blocks.iter().map(block).collect();
        format!("{} {}\n\n{}", "#".repeat(section.level.into()), section.title, blocks.join("\n"))
    };
    document.sections.iter().map(section).collect::<Vec<_>>().join("\n")
}

#[test]
fn controls_have_a_section_and_stand_in_no_table_of_the_paper() {
    let frozen = ["working/new/unchanged/none", "working/new/blocked/none"];
    let of = |route: &str| {
        [
            format!("episodic/new/{route}/4"),
            format!("episodic/new/{route}/original/oracle"),
            format!("episodic/new/{route}/4/wrong"),
            format!("summary/new/{route}/4"),
            format!("summary/new/{route}/original/wrong"),
        ]
    };
    let names = frozen.map(str::to_owned).into_iter().chain(of("unchanged")).chain(of("blocked"));
    let conditions: Vec<_> = names.map(|name| (name.parse().unwrap(), 2)).collect();
    let is_frozen = |(condition, _): &&(Condition, u32)| condition.arm == domain::Arm::Frozen;
    let without: Vec<_> = conditions.iter().filter(is_frozen).copied().collect();
    let [with, without] =
        [&conditions, &without].map(|of| document(&[made_up(of, &[1, 2])], &published()));
    let title = "Controls: right and wrong content";
    assert!(titles(&with).contains(&title) && !titles(&without).contains(&title));
    let section = with.sections.iter().find(|section| section.title == title).unwrap();
    let shown = ReportDocument { title: String::new(), sections: vec![section.clone()] };
    insta::assert_snapshot!("controls", plain(&shown));
    for id in ["main", "blocked", "groups", "pairs", "failures", "worst-cases"] {
        assert_eq!(table(&with, id), table(&without, id), "{id}: controls are left out");
    }
    let labels = |id: &str| -> Vec<String> {
        let rows = table(&with, id).groups.iter().flat_map(|group| &group.rows);
        rows.map(|row| row.label.clone()).collect()
    };
    let conditions = ["new, 4", "new, oracle", "new, 4, wrong", "new blocked, 4, wrong"];
    assert!(conditions.iter().all(|label| labels("conditions").contains(&(*label).to_owned())));
    assert_eq!(labels("blocked-others"), ["original, wrong", "oracle", "4, wrong"]);
    let text = terminal::summary(&made_up(&conditions_with_arms(), &[1, 2]));
    let wide = text.lines().find(|line| line.chars().count() > 100);
    assert_eq!(wide, None);
    assert!(text.contains("Controls: cases that need memory"), "{text}");
}

/// All memories in each arm, on both routes.
fn conditions_with_arms() -> Vec<(Condition, u32)> {
    let arms = [domain::Arm::Frozen, domain::Arm::Oracle, domain::Arm::Wrong];
    let all = paper_conditions().into_iter();
    all.flat_map(|(condition, runs)| arms.map(|arm| (condition.with_arm(arm), runs)))
        .collect::<std::collections::BTreeMap<_, _>>()
        .into_iter()
        .collect()
}

/// Checks that every row has a cell for each column.
fn rows_are_whole(document: &ReportDocument) {
    for table in document.tables() {
        for row in table.groups.iter().flat_map(|group| &group.rows) {
            assert_eq!(row.cells.len(), table.columns.len(), "{}: {}", table.id, row.label);
        }
    }
}

/// Every cell with its place.
fn cells(document: &ReportDocument) -> Vec<(String, &TableCell)> {
    let of = |table: &'_ Table| -> Vec<String> {
        table
            .groups
            .iter()
            .flat_map(|group| group.rows.iter().map(move |row| (group.label.clone(), row)))
            .flat_map(|(group, row)| {
                let columns = table.columns.iter();
                columns.map(move |column| {
                    let group = group.as_deref().unwrap_or("");
                    format!("{}: {group} {}: {} {}", table.id, row.label, column.over, column.name)
                })
            })
            .collect()
    };
    document.tables().flat_map(|table| of(table).into_iter().zip(table.cells())).collect()
}

#[test]
fn the_paper_suite_fills_every_cell() {
    let log = paper_log();
    let published = published();
    let document = document(std::slice::from_ref(&log), &published);
    let cells = cells(&document);
    assert!(cells.len() > 800, "{}", cells.len());
    rows_are_whole(&document);
    for (place, cell) in cells {
        assert!(!cell.text().trim().is_empty(), "{place} is empty");
        assert_ne!(*cell, TableCell::Missing(Missing::NotRun), "{place}: the whole suite was run");
    }
    for figure in document.figures() {
        assert!(!figure.svg().contains("not run"), "{}", figure.id);
    }
}

#[test]
fn what_was_not_run_is_left_out_and_named_in_one_line() {
    let log = made_up(&only(&["working/new/unchanged/none", "episodic/new/unchanged/4"]), &[1]);
    let document = document(&[log], &published());
    let titles = titles(&document);
    assert!(!titles.contains(&"RQ2: a blocked route"), "{titles:?}");
    let line = document.sections[0].blocks.iter().find_map(|block| match block {
        ReportBlock::Text(text) if text.starts_with("Sections without a figure") => Some(text),
        _ => None,
    });
    insta::assert_snapshot!(line.unwrap(), @"Sections without a figure of this run are left out: RQ1: demonstrations from other starts; RQ2: a blocked route; RQ3: histories of other tasks; Design choices.");
    let cells = cells(&document);
    let found = |place: &str| {
        let cell = cells.iter().find(|(at, _)| at == place);
        cell.unwrap_or_else(|| panic!("no cell {place}")).1.text()
    };
    // The group of a representation that was not run and the column of a setting that was not run are absent.
    assert!(
        !cells
            .iter()
            .any(|(at, _)| at.starts_with("main: Hybrid") || at.contains("Original start"))
    );
    assert_eq!(found("main: Working memory this run: Mtok 1 demo"), "n/m");
    assert_eq!(found("main: Episodic published: New start, 4 demos SR %"), "66.0 ± 1.0");
    assert!(cells.iter().all(|(_, cell)| !cell.text().is_empty()));
    // Plots show the run's conditions, and call the published points published.
    let figure = document.figures().find(|figure| figure.id == "main-figure").unwrap();
    assert!(
        figure.svg().contains("published") && !figure.svg().contains("Hybrid"),
        "{}",
        figure.svg()
    );
}

#[test]
fn demonstrations_elsewhere_are_compared_with_those_of_here_and_with_none() {
    let conditions = [
        "working/new/unchanged/none",
        "semantic/new/unchanged/original",
        "semantic/new/unchanged/elsewhere",
        "episodic/new/unchanged/4",
        "episodic/new/unchanged/elsewhere",
        "hybrid/new/unchanged/4",
    ];
    let log = made_up(&only(&conditions), &[1, 9]);
    let here = document(std::slice::from_ref(&log), &published());
    let rows = table(&here, "elsewhere").groups.iter().flat_map(|group| {
        group.rows.iter().map(move |row| {
            let label = group.label.as_deref().unwrap();
            format!("{label}: {}: {}", row.label, texts(row).join(" | "))
        })
    });
    insta::assert_snapshot!(rows.collect::<Vec<_>>().join("\n"));
    let log = made_up(&only(&["working/new/unchanged/none", "episodic/new/unchanged/4"]), &[1]);
    let without = document(&[log], &published());
    assert!(without.tables().all(|table| table.id != "elsewhere"));
}

#[test]
fn blocked_routes_have_rows_for_all_demonstrations_and_conflicts_are_of_one_start() {
    let conditions = [
        "working/original/unchanged/none",
        "working/new/unchanged/none",
        "working/new/blocked/none",
        "episodic/original/unchanged/original",
        "episodic/new/unchanged/original",
        "episodic/new/blocked/original",
        "episodic/new/blocked/after",
        "episodic/new/unchanged/original/h20",
        "episodic/new/blocked/original/h20",
    ];
    let mut log = made_up(&only(&conditions), &[1, 9]);
    for record in log.episodes.iter_mut().filter(|record| record.had_conflict().is_some()) {
        let blocked = BlockedRecord { invalidated: true, ..BlockedRecord::default() };
        record.blocked = Some(blocked);
    }
    let document = document(std::slice::from_ref(&log), &published());
    let rows = |id: &str| -> Vec<String> {
        let groups = table(&document, id).groups.iter();
        let rows = groups.flat_map(|group| group.rows.iter().map(move |row| (group, row)));
        let own = rows.filter(|(_, row)| !row.published);
        let label = |group: &RowGroup| group.label.clone().unwrap();
        own.map(|(group, row)| {
            format!("{}: {}: {}", label(group), row.label, texts(row).join(" | "))
        })
        .collect()
    };
    insta::assert_snapshot!(rows("blocked").join("\n"), @"Working memory: this run: 0.0 | 0.25 [0.00, 5.11] | 80.0 ± 14.1 [62.4, 92.1] | 2.8 ± 3.9 [0.0, 19.4]");
    insta::assert_snapshot!(rows("blocked-others").join("\n"), @"
    Episodic: original: −30.0 [−47.5, −7.1] | 0.40 [0.21, 0.70] | 75.0 ± 7.1 [55.0, 90.5] | 30.8 ± 17.0 [13.3, 52.5]
    Episodic: original, h20: n/m | 0.40 [0.19, 0.76] | 77.5 ± 3.5 [60.1, 89.9] | 22.5 ± 3.5 [8.3, 42.4]
    Episodic: after: n/m | n/m | 82.5 ± 3.5 [64.8, 94.3] | 27.2 ± 3.1 [12.7, 46.4]
    ");
    let conflict = rows("conflict");
    insta::assert_snapshot!(conflict.join("\n"), @"
    Working memory: none: 10.0 ± 0.0 [1.4, 25.8] | 2.5 ± 3.5 [0.0, 17.2] | 80.0 ± 14.1 [62.4, 92.1] | n/a
    Episodic: before: 62.5 ± 3.5 [44.7, 78.0] | 25.0 ± 7.1 [12.4, 42.1] | 75.0 ± 7.1 [55.0, 90.5] | undef.
    Episodic: after: not run | 22.5 ± 3.5 [10.1, 39.9] | 82.5 ± 3.5 [64.8, 94.3] | undef.
    Episodic, h20: before: 62.5 ± 3.5 [46.2, 76.6] | 25.0 ± 0.0 [12.4, 42.1] | 77.5 ± 3.5 [60.1, 89.9] | undef.
    ");
    let scores = score(&log).conflicts;
    let of = |name: &str| {
        let found = scores.iter().find(|score| score.condition.to_string() == name).unwrap();
        format!("{:.1} ", found.sr.mean)
    };
    let before = conflict.iter().find(|row| row.starts_with("Episodic: before: ")).unwrap();
    let [unchanged, blocked] =
        [1, 2].map(|at| before.split(['|', ':']).nth(at + 1).unwrap().trim());
    assert!(unchanged.starts_with(&of("episodic/new/unchanged/original")), "{unchanged}");
    assert!(blocked.starts_with(&of("episodic/new/blocked/original")), "{blocked}");
    let summary = summary(&log);
    assert!(summary.contains("original, h20") && summary.contains("Episodic, h20"), "{summary}");
    assert!(summary.lines().all(|line| line.chars().count() <= 100), "{summary}");
}

#[test]
fn external_memories_stand_in_every_table_after_the_built_in_ones() {
    let conditions = [
        "working/new/unchanged/none",
        "working/new/blocked/none",
        "episodic/original/unchanged/original",
        "episodic/new/unchanged/4",
        "episodic/new/blocked/4",
        "episodic/new/unchanged/irrelevant",
        "top-3/original/unchanged/original",
        "top-3/new/unchanged/4",
        "top-3/new/blocked/4",
        "top-3/new/unchanged/irrelevant",
        "top-3/original/unchanged/nearby",
        "bm25/new/unchanged/4",
        "bm25/new/blocked/4",
    ]
    .map(|name| (Condition::logged(name).unwrap(), 2));
    let mut log = made_up(&conditions, &[1, 9]);
    for record in log.episodes.iter_mut().filter(|record| record.memory.name() == "top-3") {
        record.retrieved = Some("o1+n2 -".to_owned());
    }
    let document = document(std::slice::from_ref(&log), &published());
    for id in ["main", "blocked", "mixed", "groups", "cost", "pairs", "conditions", "transfer"] {
        let table = table(&document, id);
        let labels: Vec<&str> =
            table.groups.iter().filter_map(|group| group.label.as_deref()).collect();
        let external: Vec<&str> =
            labels.iter().copied().filter(|label| ["bm25", "top-3"].contains(label)).collect();
        let expected: &[&str] = match id {
            // One of them ran at the original start, and under mixed histories.
            "transfer" => &["top-3"],
            _ => &["bm25", "top-3"],
        };
        assert_eq!(external, expected, "{id}: {labels:?}");
        assert!(labels.ends_with(expected), "{id}: {labels:?}");
        for group in table
            .groups
            .iter()
            .filter(|group| group.label.as_deref().is_some_and(|label| external.contains(&label)))
        {
            assert!(group.rows.iter().all(|row| !row.published), "{id}: the paper has none");
        }
    }
    let supplied = &table(&document, "supplied").groups[0].rows;
    let labels: Vec<&str> = supplied.iter().map(|row| row.label.as_str()).collect();
    assert_eq!(labels, ["Working memory", "Episodic", "bm25", "top-3"]);
    assert_eq!(texts(&supplied[3])[5..], ["40", "50", "120.6", "n/m"]);
    let pairs = table(&document, "external-pairs");
    let labels: Vec<&str> =
        pairs.groups.iter().flat_map(|group| &group.rows).map(|row| row.label.as_str()).collect();
    insta::assert_snapshot!(labels.join("\n"));
    // What was made up once is read again: names in a log are known.
    let text = serde_json::to_string(&log.episodes).unwrap();
    assert_eq!(serde_json::from_str::<Vec<EpisodeRecord>>(&text).unwrap(), log.episodes);
    let summary = summary(&log);
    assert!(summary.lines().all(|line| line.chars().count() <= 100), "{summary}");
}

/// A run with a condition of each memory that supplies documents, and one of working memory.
fn log_with_documents() -> RunLog {
    let of = |memory: &str| format!("{memory}/new/unchanged/original");
    let conditions = ["summary", "semantic", "hybrid"].map(of);
    let names: Vec<&str> = conditions.iter().map(String::as_str).collect();
    made_up(&only(&[&names[..], &["working/new/unchanged/none"]].concat()), &[1, 2])
}

/// The same run with documents by the model `author`, for the model `own`.
fn log_by_models(author: &str, own: &str) -> RunLog {
    let mut log = log_with_documents();
    log.manifest.settings.policy = PolicyKind::Openai;
    log.manifest.settings.model = Some(model_settings(own));
    log.manifest.documents.values_mut().for_each(|facts| *facts = model_document(author));
    log
}

#[test]
fn rows_of_memories_say_who_wrote_their_documents() {
    let labels = |log: &RunLog| -> Vec<String> {
        let document = document(std::slice::from_ref(log), &published());
        let main = table(&document, "main");
        main.groups.iter().filter_map(|group| group.label.clone()).collect()
    };
    let of_others = |text: &str| text.contains("The paper's documents were written by its own");
    let script = log_with_documents();
    let expected = ["Working memory", "Summary (extractive)", "Semantic (extractive)"];
    assert_eq!(labels(&script), [&expected[..], &["Hybrid (extractive)"]].concat());
    let page = plain(&document(std::slice::from_ref(&script), &published()));
    assert!(of_others(&page), "{page}");
    let shown = summary(&script);
    assert!(shown.contains("Summary (extractive)") && !of_others(&shown), "{shown}");

    let own = log_by_models("m", "m");
    assert_eq!(labels(&own), ["Working memory", "Summary", "Semantic", "Hybrid"]);
    assert!(!of_others(&plain(&document(std::slice::from_ref(&own), &published()))));
    let shown = summary(&own).replace('\n', " ");
    assert!(!shown.contains("Summary ("), "{shown}");
    let expected = "m wrote semantic/original, summary/original for this run, in 10 requests with 2200 tokens; tokens per \
                    100 cases leave these out, as the paper's do.";
    assert!(shown.contains(expected), "{shown}");

    let other = log_by_models("n", "m");
    assert_eq!(labels(&other)[1..], ["Summary (by n)", "Semantic (by n)", "Hybrid (by n)"]);
}

#[test]
fn runs_with_documents_by_others_are_named_beside_each_other() {
    let named = |log: RunLog, name: &str| RunLog { name: name.to_owned(), ..log };
    let logs = [
        named(log_with_documents(), "script"),
        named(log_by_models("m", "m"), "own"),
        named(log_by_models("m", "n"), "other"),
    ];
    let page = plain(&document(&logs, &published()));
    for expected in [
        "The documents of summary memory have different authors: extractive in script; by m in own, other.",
        "author of document summary/original differs: extractive in script, the model m in own.",
    ] {
        assert!(page.contains(expected), "{expected}:\n{page}");
    }
    for (begin, end) in [
        ("script,Semantic (extractive),", ",\"grounded, scripted stand-in\""),
        ("own,Semantic,", ",openai (m)"),
        ("other,Semantic (by m),", ",openai (n)"),
    ] {
        let is_row = |line: &str| line.starts_with(begin) && line.ends_with(end);
        assert!(page.lines().any(is_row), "{begin}:\n{page}");
    }
    assert!(!page.contains("The documents of episodic"), "{page}");
    let alike = [&logs[1], &logs[2]].map(RunLog::clone);
    assert!(!plain(&document(&alike, &published())).contains("different authors"));
}

#[test]
fn every_published_condition_is_one_of_the_paper_suite() {
    let conditions: Vec<String> =
        paper_conditions().iter().map(|(condition, _)| condition.to_string()).collect();
    for published in published().conditions {
        let parsed: Condition = published.name.parse().unwrap();
        assert_eq!(parsed.to_string(), published.name);
        assert!(conditions.contains(&published.name), "{}", published.name);
    }
}

#[test]
fn the_page_names_the_policy_and_is_self_contained() {
    let mut log = made_up(&only(&["working/new/unchanged/none"]), &[1]);
    let page =
        |log: &RunLog| html::render(&document(std::slice::from_ref(log), &published())).unwrap();
    let text = page(&log);
    assert!(text.contains("no claim about any model"), "the page names the stand-in");
    for foreign in ["<script", "http://", "https://", "src=", "@import", "url("] {
        // A namespace is not an address.
        let text = text.replace("http://www.w3.org/2000/svg", "");
        assert!(!text.contains(foreign), "{foreign}");
    }
    log.manifest.settings.policy = PolicyKind::Random;
    log.manifest.settings.frames = conditions::Frames::Blank;
    let text = page(&log);
    assert!(
        !text.contains("stand-in") && text.contains("lower bound") && text.contains("Control:")
    );
}

/// Plates are what the paper's warehouse lacks. Other worlds have none, whatever a manifest says.
#[test]
fn the_paper_s_figures_stand_beside_a_sentence_about_plates() {
    let mut log = paper_log();
    let sections = |log: &RunLog| {
        let document = document(std::slice::from_ref(log), &published());
        let mentions = |section: &&ReportSection| {
            section.blocks.iter().any(
                |block| matches!(block, ReportBlock::Text(text) if text.contains("had plates")),
            )
        };
        let sections = document.sections.iter().filter(mentions);
        (sections.map(|section| section.id.clone()).collect::<Vec<_>>(), plain(&document))
    };
    log.manifest.settings.plates = Drawn::On;
    let (found, text) = sections(&log);
    let beside = ["s-main", "s-transfer", "s-blocked", "s-mixed", "s-groups", "s-design"];
    assert_eq!(found, beside);
    assert!(text.contains("Appearance of the world: plates."), "{text}");
    log.manifest.settings.plates = Drawn::Off;
    let (found, text) = sections(&log);
    assert!(found.is_empty() && !text.contains("Appearance of the world"), "{text}");
    log.manifest.settings.plates = Drawn::On;
    log.manifest.settings.world_cmd = Some("python world.py".to_owned());
    let (found, text) = sections(&log);
    assert!(found.is_empty() && !text.contains("Appearance of the world"), "{text}");
}

#[test]
fn two_runs_stand_beside_each_other_and_are_paired() {
    let conditions = only(&["working/new/unchanged/none", "episodic/new/unchanged/4"]);
    let first = made_up(&conditions, &[1, 2]);
    let mut second = made_up(&conditions[1..], &[1, 2]);
    second.name = "other".to_owned();
    second.manifest.settings.policy = PolicyKind::Random;
    let document = document(&[first, second], &published());
    assert_eq!(
        titles(&document),
        [
            "The runs ranked",
            "The runs side by side",
            "Definitions",
            "Provenance of made-up",
            "Provenance of other"
        ]
    );
    let ranked = table(&document, "ranking-1").columns.iter().map(|column| column.name.as_str());
    assert_eq!(ranked.take(3).collect::<Vec<_>>(), ["Memory", "SR %", "SPL"]);
    let beside = table(&document, "side-by-side");
    assert_eq!((beside.columns.len(), beside.groups.len()), (4, 2));
    let compared = table(&document, "compare-run1-run2");
    let rows: Vec<_> = compared.groups.iter().flat_map(|group| &group.rows).collect();
    assert_eq!(rows.len(), 1, "they share one condition");
    assert_eq!(rows[0].label, "episodic/new/unchanged/4");
    // The same made-up episodes on both sides: no difference, no case better or worse, p = 1.
    let concluded = table(&document, "compare-run1-run2-conclusions");
    let cells = texts(&concluded.groups[0].rows[0]);
    assert_eq!(cells[..5], ["20", "0", "0", "1.000", "1.000"]);
    let mut ids: Vec<&String> = document.tables().map(|table| &table.id).collect();
    ids.extend(document.figures().map(|figure| &figure.id));
    ids.extend(document.sections.iter().map(|section| &section.id));
    let count = ids.len();
    ids.sort();
    ids.dedup();
    assert_eq!(ids.len(), count, "every id is there once");
}

#[test]
fn a_small_run() {
    let names = [
        "working/new/unchanged/none",
        "working/new/blocked/none",
        "episodic/original/unchanged/original",
        "episodic/new/unchanged/4",
        "episodic/new/blocked/4",
    ];
    let document = document(&[made_up(&only(&names), &[1, 9])], &published());
    insta::assert_snapshot!(plain(&document));
}

#[test]
fn a_report_is_a_folder_of_files_and_the_same_each_time() {
    let log = made_up(&only(&["working/new/unchanged/none", "episodic/new/unchanged/4"]), &[1]);
    let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let with_latex = Options { latex: true, ..Options::default() };
    let page = write(std::slice::from_ref(&log), first.path(), with_latex).unwrap();
    assert_eq!(page, first.path().join("report.html"));
    write(std::slice::from_ref(&log), second.path(), with_latex).unwrap();
    for name in [
        "report.html",
        "conditions.csv",
        "conditions.parquet",
        "episodes.csv",
        "episodes.parquet",
        "tables/main.csv",
        "tables/main.tex",
        "figures/main-figure.svg",
        "figures/main-figure.pdf",
    ] {
        let content = |dir: &tempfile::TempDir| fs::read(dir.path().join(name)).unwrap();
        assert!(!content(&first).is_empty(), "{name}");
        assert_eq!(content(&first), content(&second), "{name}");
    }
    let episodes = fs::read_to_string(first.path().join("episodes.csv")).unwrap();
    assert_eq!(episodes.lines().count(), 1 + log.episodes.len());
}

/// The files in `dir`, with their paths in it.
fn files(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        match path.is_dir() {
            true => {
                let inner = files(&path).into_iter();
                found.extend(inner.map(|(file, content)| (format!("{name}/{file}"), content)));
            }
            false => found.push((name, fs::read(path).unwrap())),
        }
    }
    found
}

#[test]
fn every_file_of_a_report_names_its_policy() {
    let mut beyond = made_up(
        &only(&[
            "working/new/unchanged/none",
            "working/new/blocked/none",
            "episodic/new/blocked/original",
            "episodic/new/blocked/after",
            "episodic/new/unchanged/elsewhere",
            "episodic/new/unchanged/bank-4",
            "episodic/new/unchanged/bank-16",
        ]),
        &[1, 9],
    );
    for timings in &mut beyond.timings {
        (timings.recalls.store_bytes, timings.recalls.requests) = (Some(4096), timings.steps);
    }
    beyond.requests = vec![rigs::records::request(&beyond.episodes[0].key, 1)];
    let small = vec![beyond.clone()];
    let both = vec![beyond.clone(), RunLog { name: "other".to_owned(), ..beyond }];
    let paper = made_up(&paper_conditions(), &[1, 9]);
    for (policy, role) in [
        (PolicyKind::Grounded, Some("grounded, scripted stand-in")),
        (PolicyKind::Random, Some("random, lower bound")),
        (PolicyKind::Expert, Some("expert, upper bound")),
        (PolicyKind::External, None),
    ] {
        let all = match policy {
            PolicyKind::Grounded => {
                vec![vec![paper.clone()], vec![made_up_streams()], both.clone()]
            }
            _ => vec![],
        };
        for mut logs in all.into_iter().chain([small.clone()]) {
            for log in &mut logs {
                log.manifest.settings.policy = policy;
            }
            let dir = tempfile::tempdir().unwrap();
            write(&logs, dir.path(), Options { latex: true, ..Options::default() }).unwrap();
            // The names by which a report is replaced and removed are those of all its files.
            let others = report_names().unwrap().others_in(dir.path()).unwrap();
            assert!(others.is_empty(), "{others:?}");
            let streams_alone = |log: &RunLog| log.manifest.settings.stream.is_some();
            for (name, content) in files(dir.path()) {
                let text = String::from_utf8_lossy(&content);
                let found = |words: &str| text.contains(words);
                match role {
                    // It has no rows.
                    _ if name == "conditions.parquet" && logs.iter().all(streams_alone) => {}
                    Some(label) if name.ends_with(".parquet") => {
                        let role = label.split_once(", ").unwrap().1;
                        assert!(found(role), "{name} does not say {role}");
                    }
                    // The whole label is in two columns there.
                    Some(label) if name.ends_with(".csv") && !name.starts_with("tables/") => {
                        let mut lines = text.lines().skip(1);
                        let label = label.replace(", ", ",");
                        assert!(lines.all(|line| line.contains(&label)), "{name}: {label}");
                    }
                    // Its letters are outlines; its title is the caption, which is checked below.
                    _ if name.ends_with(".pdf") => assert!(content.starts_with(b"%PDF"), "{name}"),
                    Some(label) if name.ends_with(".csv") => {
                        let mut lines = text.lines().skip(1);
                        let is_named = |line: &str| line.contains(label) || line.ends_with(THEIRS);
                        assert!(lines.all(is_named), "{name}: {label}\n{text}");
                    }
                    Some(label) => assert!(found(label), "{name} does not say {label}"),
                    None => {
                        for words in ["stand-in", "lower bound", "upper bound"] {
                            assert!(!found(words), "{name} says {words}");
                        }
                    }
                }
            }
            let summary = summary(&logs[0]);
            assert!(role.is_none_or(|label| summary.contains(label)), "{summary}");
            let document = document(&logs, &published());
            for section in document.sections.iter().filter(|section| section.id != "s-method") {
                assert!(section.policy.is_some(), "{}", section.id);
            }
            let captions = document.tables().map(|table| &table.caption);
            for caption in captions.chain(document.figures().map(|figure| &figure.caption)) {
                assert!(role.is_none_or(|label| caption.contains(label)), "{caption}");
            }
        }
    }
}

#[test]
fn cases_that_fail_are_named() {
    let log = made_up(&only(&["working/new/unchanged/none"]), &[1, 9]);
    let document = document(&[log], &published());
    let rows = &table(&document, "worst-cases").groups[0].rows;
    assert!((1..=10).contains(&rows.len()));
    assert!(rows[0].label.starts_with('t') && rows[0].cells[3].text().ends_with(&rows[0].label));
}

#[test]
fn a_run_of_streams_has_its_own_sections_and_no_row_in_the_others() {
    let mut log = made_up_streams();
    let lost = log.episodes.pop().unwrap();
    let document = document(std::slice::from_ref(&log), &published());
    insta::assert_snapshot!(titles(&document).join("\n"), @"
    What was run
    Streams
    Streams: what is kept and what carries over
    Streams: adaptation, stale reuse and orders
    Streams: cost against size
    Streams: cases that need memory
    What memory supplied
    Time by stage
    Definitions
    Provenance
    ");
    let ids: Vec<&str> = document.tables().map(|table| table.id.as_str()).collect();
    insta::assert_snapshot!(ids.join(" "), @"facts stream-success stream-differences stream-transfer stream-matrix stream-adaptation stream-orders stream-cost necessity supplied time provenance");
    rows_are_whole(&document);
    let notice = document.sections[1].blocks.first();
    let expected = "Streams: 1 of 96 sequences are not complete and enter no figure; the same command continues the run.";
    assert_eq!(notice, Some(&ReportBlock::Notice(expected.to_owned())));
    // Where that does not help, the report does not say it.
    let ended = EpisodeError {
        key: lost.key.clone(),
        session: 1,
        error: format!("snapshot s is missing. {}, delete its lines", domain::SEQUENCE_ENDED),
    };
    let damaged = RunLog { errors: vec![ended], ..log.clone() };
    let text = html::render(&super::document(&[damaged], &published())).unwrap();
    assert!(!text.contains("; the same command"), "{text}");
    assert_eq!(text.matches("errors.jsonl says what to delete before the same command").count(), 2);
    let summary = summary(&log);
    insta::assert_snapshot!("summary_of_streams", summary);
    let wide = summary.lines().find(|line| line.chars().count() > 100);
    assert_eq!(wide, None);
    log.episodes.push(lost);
    let dir = tempfile::tempdir().unwrap();
    write(std::slice::from_ref(&log), dir.path(), Options::default()).unwrap();
    let rows = fs::read_to_string(dir.path().join("streams.csv")).unwrap();
    assert_eq!(rows.lines().count(), 1 + 8);
}

/// The figures of `log` as a file of its own.
fn own_figures(log: &RunLog, change: impl Fn(String) -> String) -> Published {
    let dir = tempfile::tempdir().unwrap();
    let page = write(std::slice::from_ref(log), dir.path(), Options::default()).unwrap();
    let file = page.with_file_name("published.toml");
    let text = change(fs::read_to_string(&file).unwrap());
    fs::write(&file, text).unwrap();
    Published::read(&file).unwrap()
}

/// The report about `log` beside these figures.
fn reproduction(log: &RunLog, published: &Published) -> ReportDocument {
    arrange(&views(std::slice::from_ref(log), published), true)
}

fn notice_of_reproduction(document: &ReportDocument) -> &str {
    let section = document.sections.iter().find(|section| section.id == "s-reproduction").unwrap();
    let notice = section.blocks.iter().find_map(|block| match block {
        ReportBlock::Notice(text) => Some(text),
        _ => None,
    });
    notice.unwrap()
}

#[test]
fn a_run_beside_its_own_figures_covers_all_of_them() {
    let log = paper_log();
    let published = own_figures(&log, |text| text);
    let document = reproduction(&log, &published);
    rows_are_whole(&document);
    assert_eq!(document.sections[1].id, "s-reproduction");
    insta::assert_snapshot!(notice_of_reproduction(&document), @"341 of 341 published figures lie in this run's intervals. Not counted: 65 published figures have no interval in this run.");
    for row in table(&document, "reproduction").groups.iter().flat_map(|group| &group.rows) {
        let [_, _, difference, place] = &texts(row)[..] else { panic!("four columns") };
        assert!(difference.trim_matches(['0', '.']).is_empty(), "{}: {difference}", row.label);
        assert!(["inside", "n/a"].contains(&place.as_str()), "{}: {place}", row.label);
    }
    let facts = table(&document, "configuration").groups.iter().flat_map(|group| &group.rows);
    let differing: Vec<_> = facts.filter(|row| texts(row)[2] != "same").collect();
    assert!(differing.is_empty(), "{differing:?}");
    // Its tables have the figures of the file where they had the paper's.
    let cells = cells(&document);
    let of = |source: &str| {
        let place = format!("main: Episodic {source}: New start, 4 demos SR %");
        cells.iter().find(|(at, _)| *at == place).unwrap().1.text()
    };
    assert!(of("this run").starts_with(&of("published")), "{} {}", of("this run"), of("published"));
    assert!(!plain(&document).contains("The paper's documents were written by"));
}

#[test]
fn figures_that_differ_are_above_or_below_and_facts_are_compared() {
    let names =
        ["working/new/unchanged/none", "episodic/new/unchanged/4", "episodic/new/blocked/4"];
    let log = made_up(&only(&names), &[1, 9]);
    let episodic =
        score(&log).conditions.into_iter().find(|score| score.condition.to_string() == names[1]);
    let interval = episodic.unwrap().sr.interval.unwrap();
    let text = format!(
        "title = \"Figures\"\nsource = \"table 1\"\npolicy = \"some-model\"\n\n[configuration]\ncases = 20\nruns = 3\n\
         window = 6\nencoder = \"ViT-B/16\"\nmax-steps = 200\nmodel = \"some-model\"\n\n\
         [[condition]]\nname = \"{}\"\nruns = 2\nsr = {{ mean = {:?}, std = 1.0 }}\nspl = 0.0\nmtok = 3\nimg = 7.0\n\
         change = 1.0\n\n\
         [[condition]]\nname = \"{}\"\nsr = {{ mean = {:?}, std = 3.0 }}\ngroups = {{ basic = 50, other = 1 }}\n\n\
         [[condition]]\nname = \"{}\"\nretention = {{ mean = 9.5, std = 0.5 }}\nsr = 0.0\n\n\
         [[condition]]\nname = \"hybrid/new/unchanged/4\"\nsr = 50.0\n",
        names[1], interval.high, names[0], 100.0, names[2]
    );
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("figures.toml");
    fs::write(&file, text).unwrap();
    let document = reproduction(&log, &Published::read(&file).unwrap());
    rows_are_whole(&document);
    let section = document.sections.iter().find(|section| section.id == "s-reproduction").unwrap();
    let sections = vec![section.clone()];
    insta::assert_snapshot!(plain(&ReportDocument { title: String::new(), sections }));
}

#[test]
fn fractions_and_unknown_task_groups_are_suspected() {
    let log = made_up(&only(&["episodic/new/unchanged/4"]), &[1, 9]);
    let suspected = |figures: &str| -> Vec<String> {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("figures.toml");
        let text = format!(
            "title = \"t\"\npolicy = \"p\"\n[[condition]]\nname = \"episodic/new/unchanged/4\"\n{figures}\n"
        );
        fs::write(&file, text).unwrap();
        let document = reproduction(&log, &Published::read(&file).unwrap());
        let section =
            document.sections.iter().find(|section| section.id == "s-reproduction").unwrap();
        let notices = section.blocks.iter().filter_map(|block| match block {
            ReportBlock::Notice(text) => Some(text.clone()),
            _ => None,
        });
        // The first says how many figures lie in the run's intervals.
        notices.skip(1).collect()
    };
    let fractions = "No published percentage is above 1. The format has percentages from 0 to 100: if these are fractions, nothing \
                     below is true of them.";
    assert_eq!(suspected("sr = 0.66\ngroups = { basic = 1.0 }"), [fractions]);
    for fine in ["sr = 66\ngroups = { basic = 0.5 }", "sr = 0", "spl = 0.5", "sr = 1.5"] {
        assert!(suspected(fine).is_empty(), "{fine}");
    }
    let [unknown] = &suspected("sr = 66\ngroups = { basc = 50, revisit = 50 }")[..] else {
        panic!("one notice")
    };
    assert!(
        unknown.starts_with("The world of this run has no task group basc; it has basic, "),
        "{unknown}"
    );
}

#[test]
fn nothing_in_common_is_said() {
    let log = made_up(&only(&["episodic/new/unchanged/4"]), &[1]);
    let published = own_figures(&log, |text| text.replace("episodic/new/", "hybrid/new/"));
    let document = reproduction(&log, &published);
    insta::assert_snapshot!(notice_of_reproduction(&document), @"This run has none of the published conditions.");
    assert!(document.tables().all(|table| table.id != "reproduction"));
    rows_are_whole(&document);
}

#[test]
fn the_paper_s_figures_are_compared_on_demand() {
    let log = paper_log();
    let document = reproduction(&log, &published());
    insta::assert_snapshot!(notice_of_reproduction(&document), @"48 of 134 published figures lie in this run's intervals. Not counted: 24 published figures have no interval in this run. 10 published figures were not measured in this run.");
    let rows = table(&document, "reproduction").groups.iter().map(|group| group.rows.len());
    // Every printed figure: see the test of the file.
    let all = (6 + 6 + 4 + 5 + 15 + 3) + (6 + 6 + 4 + 5 + 15) + 21 + 10 + 4 * 5 + 2 + 40;
    assert_eq!(rows.sum::<usize>(), all);
}
