//! The whole benchmark on four cases: every condition of the paper, and its report.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use memtransfer_tests::{Bench, records, sorted_log};

/// A case of each group of tasks: basic, multi-object, return loop, revisit.
const CASES: &str = "t01-01,t03-02,t07-01,t09-05";

/// Those cases under all 53 conditions, once.
const RUN: [&str; 10] =
    ["run", "--suite", "paper", "--policy", "grounded", "--runs", "1", "--cases", CASES, "--out"];

/// Images per request at the default settings (specification, section 5).
const IMAGES: [(&str, u64); 6] = [
    ("working", 7),
    ("full-context", 47),
    ("summary", 7),
    ("semantic", 7),
    ("hybrid", 7),
    ("episodic", 14),
];

#[test]
fn every_condition_of_the_paper_runs_and_is_reported() {
    let bench = Bench::new();
    let out = bench.out("paper");
    bench.run(&[&RUN[..], &["paper"]].concat()).expect(0);

    let records = records(&out);
    let keys: BTreeSet<&str> =
        records.iter().map(|record| record["key"].as_str().unwrap()).collect();
    assert_eq!((records.len(), keys.len()), (212, 212), "every episode is logged once");
    let most: BTreeMap<&str, u64> = IMAGES.into_iter().collect();
    for record in records.iter().filter(|record| record["window"].is_null()) {
        let count = |field: &str| record[field].as_u64().unwrap();
        let (images, requests) = (count("images"), count("requests"));
        let most = most[record["memory"].as_str().unwrap()];
        assert!(images <= most * requests, "{}: {images} in {requests} requests", record["key"]);
    }

    // The log does not depend on the number of lanes.
    let other = [&RUN[..], &["other", "--lanes", "3"]].concat();
    bench.run(&other).expect(0);
    assert!(sorted_log(&out) == sorted_log(&bench.out("other")), "the logs differ");

    // No cell of the report is empty, and every condition was run.
    bench.run(&["report", "paper"]).expect(0);
    let pages = out.join("report");
    let page = fs::read_to_string(pages.join("report.html")).unwrap();
    assert!(page.contains("grounded, scripted stand-in"), "the stand-in is named");
    let mut cells = 0;
    for table in fs::read_dir(pages.join("tables")).unwrap() {
        for row in fs::read_to_string(table.unwrap().path()).unwrap().lines() {
            for cell in row.split(',') {
                assert!(!["", "not run"].contains(&cell.trim()), "an empty cell in {row}");
                cells += 1;
            }
        }
    }
    assert!(cells > 500, "{cells} cells");
    assert!(!page.contains("src=\"http"), "the page loads something from the network");
    for file in ["conditions.csv", "episodes.csv", "conditions.parquet", "episodes.parquet"] {
        assert!(fs::metadata(pages.join(file)).unwrap().len() > 0, "{file}");
    }
}
