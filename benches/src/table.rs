//! The table of targets in docs/performance.md.
//!
//! A row shows every figure with a target whose id starts with the row's prefix. Without one it says that nothing was
//! measured.

use crate::BENCHES;
use crate::figure::{Summary, shown};
use crate::results::{Measured, Results};

/// A target.
#[derive(Debug, Clone, Copy)]
struct Wanted {
    what: &'static str,
    against: &'static str,
    target: &'static str,
    /// Prefix of the ids of its figures; its first component names the bench.
    prefix: &'static str,
}

const WANTED: &[Wanted] = &[
    Wanted {
        what: "polled hop through the wire types",
        against: "iceoryx2's own ping-pong",
        target: "within 1.5 x",
        prefix: "hop.",
    },
    Wanted {
        what: "one lane, four processes, warm views, `random`",
        against: "a bare four-process chain of the same messages",
        target: "within 1.5 x",
        prefix: "chain.1.",
    },
    Wanted {
        what: "64 lanes, warm, `random` / `grounded` / Python returning at once",
        against: "the bare chain",
        target: "200,000 / 80,000 / 30,000 steps per second",
        prefix: "chain.64.",
    },
    Wanted {
        what: "cold rendering without anti-aliasing",
        against: "ViZDoom at 512 x 384, its size nearest to ours",
        target: "faster than ViZDoom",
        prefix: "render.1-sample",
    },
    Wanted {
        what: "cold rendering with 4x MSAA",
        against: "MiniWorld at the same number of pixels",
        target: "five times MiniWorld",
        prefix: "render.4-samples",
    },
    Wanted {
        what: "repeated views",
        against: "a memcpy of the frame",
        target: "no work on pixels",
        prefix: "render.repeated",
    },
    Wanted {
        what: "embedding, cold",
        against: "ONNX Runtime from Python, same model, same threads",
        target: "2 x, top-1 retrieval unchanged",
        prefix: "embed.",
    },
    Wanted {
        what: "exact search, 1k to 10M vectors of 384",
        against: "FAISS flat, same threads; memory bandwidth",
        target: "one query: at or above FAISS and 80 % of the bandwidth; a batch of 64: five times FAISS",
        prefix: "search.",
    },
    Wanted {
        what: "approximate search",
        against: "FAISS HNSW, usearch",
        target: "same recall, no slower",
        prefix: "approximate.",
    },
    Wanted {
        what: "cold run: rendering, embedding, deciding",
        against: "the slowest stage alone",
        target: "overlap of 90 %",
        prefix: "overlap.",
    },
    Wanted {
        what: "the paper suite with `grounded`",
        against: "",
        target: "warm 1 minute, cold under 8",
        prefix: "suite.",
    },
    Wanted {
        what: "memory over 30,000 episodes",
        against: "frame store and models",
        target: "no growth",
        prefix: "growth.",
    },
    Wanted {
        what: "how time grows with cases and episodes",
        against: "",
        target: "linear in cases and in episodes",
        prefix: "curves.",
    },
];

/// Column titles.
pub const HEADER: [&str; 8] =
    ["what", "against", "target", "ours", "baseline", "ours / baseline", "target met", "command"];

/// The rows as text: one for each figure with a target, and one for each target without a figure.
pub fn rows(results: &Results) -> Vec<[String; 8]> {
    let mut rows = Vec::new();
    for wanted in WANTED {
        let bench = wanted.prefix.split('.').next().unwrap_or_default();
        let exists = BENCHES.iter().any(|known| known.name == bench);
        let command =
            if exists { format!("`cargo xtask bench --only {bench}`") } else { "–".to_owned() };
        let first = rows.len();
        let outcome = results.of(bench);
        let figures = outcome.map_or(&[][..], |outcome| &outcome.figures);
        for measured in figures {
            let figure = &measured.figure;
            if figure.target.is_some() && figure.id.starts_with(wanted.prefix) {
                rows.push(row(wanted, measured, &command));
            }
        }
        if rows.len() == first {
            let why = match outcome.and_then(|outcome| outcome.error.as_ref()) {
                Some(_) => "the bench failed",
                None if exists => "not measured yet",
                None => "no bench yet",
            };
            let [what, against, target] =
                [wanted.what, wanted.against, wanted.target].map(str::to_owned);
            let none = || "–".to_owned();
            rows.push([what, against, target, why.to_owned(), none(), none(), none(), command]);
        }
    }
    rows
}

fn row(wanted: &Wanted, measured: &Measured, command: &str) -> [String; 8] {
    let figure = &measured.figure;
    let none = || "–".to_owned();
    let target = figure.target.as_ref().map_or_else(none, |target| target.text.clone());
    let against = figure.baseline.as_ref().map_or_else(
        || wanted.against.to_owned(),
        |baseline| format!("{} {}", baseline.name, baseline.version).trim().to_owned(),
    );
    [
        figure.what.clone(),
        against,
        target,
        measured.summary.map_or_else(none, |summary| with_unit(summary, &figure.unit)),
        measured.baseline_summary.map_or_else(none, |summary| with_unit(summary, &figure.unit)),
        measured.ratio.map_or_else(none, spread),
        match measured.meets_target {
            Some(true) => "yes".to_owned(),
            Some(false) => "no".to_owned(),
            None => none(),
        },
        command.to_owned(),
    ]
}

/// Formats a median with its unit and range.
pub fn with_unit(summary: Summary, unit: &str) -> String {
    format!("{} {unit} {}", shown(summary.median), range(summary)).trim_end().to_owned()
}

/// Formats a median and its range.
pub fn spread(summary: Summary) -> String {
    format!("{} {}", shown(summary.median), range(summary)).trim().to_owned()
}

/// Formats the range, unless it is a single value.
fn range(Summary { min, max, .. }: Summary) -> String {
    if min == max { String::new() } else { format!("({} to {})", shown(min), shown(max)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::{Better, Bound, Figure};
    use crate::results::BenchOutcome;

    #[test]
    fn a_row_has_its_figures_or_says_that_there_are_none() {
        let mut results = Results::here();
        let outcome = |name: &str, error: Option<&str>, figures: Vec<Figure>| BenchOutcome {
            name: name.to_owned(),
            about: String::new(),
            began: String::new(),
            commit: None,
            seconds: 0.0,
            error: error.map(str::to_owned),
            figures: figures.into_iter().map(Into::into).collect(),
        };
        let hop = Figure::new("hop.round-trip", "a round trip", "ns", Better::Lower)
            .ours([500.0, 510.0, 490.0])
            .baseline("iceoryx2", "0.10", [400.0, 400.0, 400.0])
            .target(Bound::Ratio(1.5), "within 1.5 x");
        let floor = Figure::new("hop.floor", "no target", "ns", Better::Lower).ours([1.0]);
        results.add(outcome("hop", None, vec![hop, floor]));
        results.add(outcome("growth", Some("no shared memory"), Vec::new()));
        let rows = rows(&results);
        assert_eq!(rows.len(), WANTED.len());
        let cells: Vec<&str> = rows[0].iter().map(String::as_str).collect();
        assert_eq!(
            cells,
            [
                "a round trip",
                "iceoryx2 0.10",
                "within 1.5 x",
                "500 ns (490 to 510)",
                "400 ns",
                "1.25 (1.23 to 1.27)",
                "yes",
                "`cargo xtask bench --only hop`"
            ]
        );
        assert_eq!(rows[1][3], "not measured yet");
        // Every command names a bench that exists.
        assert!(rows.iter().all(|row| (row[3] == "no bench yet") == (row[7] == "–")));
        let failed: Vec<_> = rows.iter().filter(|row| row[3] == "the bench failed").collect();
        assert_eq!((failed.len(), failed[0][7].as_str()), (1, "`cargo xtask bench --only growth`"));
    }

    #[test]
    fn every_row_names_a_bench_once() {
        let mut prefixes: Vec<&str> = WANTED.iter().map(|wanted| wanted.prefix).collect();
        prefixes.dedup();
        assert_eq!(prefixes.len(), WANTED.len());
        assert!(prefixes.iter().all(|prefix| prefix.contains('.')));
    }
}
