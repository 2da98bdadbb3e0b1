//! Banks and conflicting demonstrations through the real processes.

use memtransfer_tests::{Bench, records, sorted_log, words};

#[test]
fn a_slice_of_the_suite_growth() {
    let bench = Bench::new();
    let run = |out: &str, lanes: &str| {
        let line = "run --suite growth --policy grounded --limit 2 --max-steps 20";
        bench.run(&[&words(line)[..], &["--lanes", lanes, "--out", out]].concat()).expect(0)
    };
    let ended = run("wide", "16");
    assert!(ended.stdout.contains("Banks of different sizes"), "{}", ended.stdout);
    run("one", "1");
    assert_eq!(sorted_log(&bench.out("one")), sorted_log(&bench.out("wide")), "1 lane or 16");

    let records = records(&bench.out("wide"));
    // Working memory; episodic and adaptive with six banks; full context with three.
    assert_eq!(records.len(), 2 * (1 + 2 * 6 + 3));
    let retrieved = records.iter().filter(|record| record["retrieved"].is_string());
    assert_eq!(retrieved.clone().count(), 2 * 2 * 6);
    let of_others = |bank: &str| {
        let of_bank = retrieved.clone().filter(|record| record["demonstrations"] == bank);
        of_bank.filter(|record| record["retrieved"].as_str().unwrap().contains(':')).count()
    };
    assert_eq!(of_others("bank-1"), 0);
    assert!(of_others("bank-400") > 0, "nothing from another case");

    let too_large = words("run --demos bank-401 --memory episodic --out too-large");
    let refused = bench.run(&too_large).expect(2);
    assert!(refused.stderr.contains("the largest bank is bank-400"), "{}", refused.stderr);
}

#[test]
fn a_slice_of_the_suite_conflict() {
    let bench = Bench::new();
    let line = "run --suite conflict --policy grounded --limit 4 --max-steps 30 \
                --memory working,full-context,episodic,adaptive --out run";
    let ended = bench.run(&words(line)).expect(0);
    assert!(ended.stdout.contains("from before and after the way was blocked"), "{}", ended.stdout);
    let records = records(&bench.out("run"));
    assert_eq!(records.len(), 4 * 2 * (1 + 3 * 4));
    let (mut stale, mut after) = (0, 0);
    for record in &records {
        let blocked = &record["blocked"];
        assert_eq!(record["route"] == "blocked", blocked.is_object());
        let words = record["retrieved"].as_str().unwrap_or_default();
        let from = |letter| words.split(' ').filter(|word| word.starts_with(letter)).count() as u64;
        after += from('a');
        if let Some(found) = blocked["stale"].as_u64() {
            assert_eq!(blocked["retrievals"].as_u64(), Some(from('a') + from('o')), "{record}");
            // A demonstration from after the event is valid.
            let outdated = if blocked["invalidated"] == true { from('o') } else { 0 };
            assert_eq!(found, outdated, "{record}");
            stale += found;
        }
        match record["demonstrations"].as_str().unwrap() {
            "original" => assert_eq!(from('a'), 0),
            "after" => assert_eq!(from('o'), 0),
            _ => {}
        }
    }
    assert!(stale > 0 && after > 0, "{stale} stale, {after} from after the event");
}
