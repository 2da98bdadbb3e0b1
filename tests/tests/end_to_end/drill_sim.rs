//! The simulated drill: a few seeds hold, and defects that are planted are found.

use std::process::Command;

use memtransfer_tests::{Bench, Ended, program};
use serde_json::Value;

/// Runs `drill-sim` with `args`. Returns its exit status and its summary.
fn drill(bench: &Bench, args: &[&str]) -> (Option<i32>, Value) {
    let summary = bench.out("summary.json");
    let mut command = Command::new(program("drill-sim"));
    let ended = Ended::run(command.args(args).arg("--json").arg(&summary));
    let text = std::fs::read_to_string(&summary);
    let text = text.unwrap_or_else(|error| panic!("{error}: {}", ended.stderr));
    (ended.status, serde_json::from_str(&text).unwrap())
}

#[test]
fn runs_among_faults_have_the_log_of_an_undisturbed_run_and_planted_defects_are_found() {
    let bench = Bench::new();
    // The faults of the last one concern an external memory.
    let (status, summary) = drill(&bench, &["--seed", "0,1,2,3,4,5,6,7,16"]);
    assert_eq!(summary["violations"], Value::Array(Vec::new()));
    assert_eq!((status, &summary["figures"]["seeds"]), (Some(0), &Value::from(9)));
    assert!(summary["faults"].as_object().is_some_and(|faults| faults.len() > 3), "{summary:#}");
    assert_eq!(summary["faults"]["death of an external memory"], Value::from(1), "{summary:#}");

    // A seed without stalls, full queues and jumps, in which sessions may take long.
    let defects = ["LostLine", "DoubledLine", "LeftOpen", "WaitsInVain", "OtherDecisions"];
    let plants = "lost-line,doubled-line,left-open,waits-in-vain,other-decisions";
    let (status, summary) = drill(&bench, &["--seed", "2", "--plant", plants]);
    assert_eq!(status, Some(1), "{summary:#}");
    let violations = summary["violations"].as_array().unwrap();
    assert_eq!(violations.len(), defects.len(), "{summary:#}");
    for (defect, violation) in defects.iter().zip(violations) {
        let found = format!("planted {defect}): ");
        assert!(violation.as_str().unwrap().contains(&found), "no {found} in {violation}");
    }
}
