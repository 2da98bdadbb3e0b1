//! Gates in a terminal: a line each.

use run_log::Difference;
use scores::gate::{GateResult, Verdict};

use super::table::{WIDTH, wrap};
use super::view::{interval_text, signed};

/// The width of the longest verdict, and of the space after it.
const VERDICT: usize = 11;

/// What became of the gates, as text, at most 100 columns wide. `differing` are the settings in which the run differs from one that it
/// has to be no worse than.
pub fn gates(results: &[GateResult], differing: &[Difference]) -> String {
    let mut text = "Gates\n".to_owned();
    for result in results {
        // A long name of a condition takes a second line.
        for (index, line) in wrap(&line(result), WIDTH - VERDICT).iter().enumerate() {
            let verdict = if index == 0 { result.verdict.name() } else { "" };
            text += &format!("{verdict:<VERDICT$}{line}\n");
        }
    }
    for Difference { key, there, here } in differing {
        let note = format!(
            "Note: {key} differs: {there} in this run, {here} in the one that it is compared with."
        );
        text += &(wrap(&note, WIDTH).join("\n") + "\n");
    }
    let count = |verdict| results.iter().filter(|result| result.verdict == verdict).count();
    let [passed, failed, undecided] =
        [Verdict::Passed, Verdict::Failed, Verdict::Undecided].map(count);
    let note = format!(
        "{passed} of {} passed, {failed} failed, {undecided} undecided. Passed: the whole 95 % interval, in brackets, satisfies \
         the gate; failed: none of it does; undecided, which is not passed: neither.",
        results.len()
    );
    text + "\n" + &wrap(&note, WIDTH).join("\n") + "\n"
}

/// The gate, then its figure with the interval, or why it is undecided.
fn line(result: &GateResult) -> String {
    let GateResult { figure, against, value, interval, cases, reason, .. } = result;
    let digits = figure.digits();
    let shown = |value: f64| match against {
        Some(_) => signed(value, digits),
        None => signed(value, digits).replace('+', ""),
    };
    let value = value.map(|value| {
        let interval = interval.map(|interval| format!(" {}", interval_text(interval, digits)));
        let cases = against.as_ref().map(|_| format!(", {cases} cases"));
        format!(": {}{}{}", shown(value), interval.unwrap_or_default(), cases.unwrap_or_default())
    });
    let reason = reason.as_ref().map(|reason| format!(": {reason}"));
    format!("{}{}{}", result.gate(), value.unwrap_or_default(), reason.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use rigs::records::{log, record};
    use scores::gate::{Gate, no_worse_than};
    use scores::score;

    use super::*;

    #[test]
    fn each_gate_has_a_line_and_a_long_one_is_wrapped() {
        let run = |successes: usize| {
            log((0..50).map(|case| record(&format!("c{case:02}"), case < successes)).collect())
        };
        let (run, mut base) = (run(40), run(41));
        base.name = "a-run-with-quite-a-long-name-on-the-main-branch".to_owned();
        base.manifest.settings.groups.clear();
        let scores = score(&run);
        let gate = |text: &str| {
            let gate: Gate =
                format!("episodic/original/unchanged/original: {text}").parse().unwrap();
            gate.check(&run, &scores).unwrap()
        };
        let mut results =
            ["sr >= 60", "sr < 60", "sr >= 80", "spl > 0.1", "change > 0"].map(gate).to_vec();
        results.extend(no_worse_than((&run, &scores), (&base, &score(&base)), 10.0).unwrap());
        let differing =
            Difference { key: "seed".to_owned(), there: "1".to_owned(), here: "2".to_owned() };
        let text = gates(&results, &[differing]);
        insta::assert_snapshot!(text, @"
        Gates
        passed     episodic/original/unchanged/original: sr >= 60: 80.0 [67.4, 90.3]
        failed     episodic/original/unchanged/original: sr < 60: 80.0 [67.4, 90.3]
        undecided  episodic/original/unchanged/original: sr >= 80: 80.0 [67.4, 90.3]
        passed     episodic/original/unchanged/original: spl > 0.1: 0.640 [0.542, 0.727]
        undecided  episodic/original/unchanged/original: change > 0: of blocked routes only
        passed     episodic/original/unchanged/original: sr minus
                   a-run-with-quite-a-long-name-on-the-main-branch's > -10: −2.0 [−8.7, 4.8], 50 cases
        Note: seed differs: 1 in this run, 2 in the one that it is compared with.

        3 of 6 passed, 1 failed, 2 undecided. Passed: the whole 95 % interval, in brackets, satisfies the
        gate; failed: none of it does; undecided, which is not passed: neither.
        ");
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH));
    }
}
