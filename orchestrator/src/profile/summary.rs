//! A profile in a terminal.

use domain::Representation;

use super::page::{find, ns};
use super::recorder::{Part, StepKind};
use super::{Mode, Profile};
use results::table::table;

/// The tables: accesses by representation, searches by size, and the floors in a line.
pub fn summary(profile: &Profile) -> String {
    let mut text = String::new();
    let header = [
        "walk",
        "memory",
        "wire",
        "embed",
        "search",
        "assemble",
        "access p50",
        "p90",
        "p99",
        "p99.9",
        "max",
        "first step p50",
    ];
    let mut accesses = table(&header, 2);
    let shown = |walk: &&super::Walk| walk.lanes == 1 || walk.mode == Mode::Warm;
    for walk in profile.walks.iter().filter(shown) {
        for &representation in Representation::ALL {
            let times = |step, part| find(walk, representation, step, part);
            let Some(total) = times(StepKind::Later, Part::Total) else { continue };
            let p50 =
                |step, part| times(step, part).map_or_else(|| "-".to_owned(), |t| ns(t.p50 as f64));
            let mut row = vec![walk.name(), representation.name().to_owned()];
            let parts = [Part::Wire, Part::Embedding, Part::Search, Part::Assembly];
            row.extend(parts.map(|part| p50(StepKind::Later, part)));
            let tail = [total.p50, total.p90, total.p99, total.p999, total.max];
            row.extend(tail.map(|time| ns(time as f64)));
            row.push(p50(StepKind::First, Part::Total));
            accesses.add_row(row);
        }
    }
    text += &format!(
        "Access to memory, from observation to recall: medians of the parts, then the whole (later steps)\n{accesses}\n"
    );
    if !profile.searches.is_empty() {
        let header = [
            "search",
            "entries",
            "at once",
            "p50",
            "p99",
            "max",
            "queries/s",
            "GB/s read",
            "recall@1",
            "recall@10",
        ];
        let mut searches = table(&header, 1);
        for search in &profile.searches {
            let times = &search.latency_ns;
            let mut row =
                vec![search.search.clone(), search.entries.to_string(), search.batch.to_string()];
            row.extend([times.p50, times.p99, times.max].map(|time| ns(time as f64)));
            row.push(format!("{:.0}", search.queries_per_s));
            row.push(
                search
                    .bytes_per_s
                    .map_or_else(|| "-".to_owned(), |rate| format!("{:.1}", rate / 1e9)),
            );
            row.extend(
                [search.recall_at_1, search.recall_at_10].map(|recall| format!("{recall:.4}")),
            );
            searches.add_row(row);
        }
        text += &format!("\nSearch by itself\n{searches}\n");
    }
    let floors = &profile.floors;
    text += &format!(
        "\nFloors of this machine: a cache line to another core {}, a memcpy of a frame {}, reading memory {:.1} GB/s \
         with one thread, {:.1} with all cores",
        ns(floors.cache_line_ns),
        ns(floors.frame_copy_ns),
        floors.read_one_thread / 1e9,
        floors.read_all_cores / 1e9
    );
    for problem in &profile.problems {
        text += &format!("\nNot measured: {problem}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_shows_every_representation_every_search_and_what_is_missing() {
        let text = summary(&crate::profile::tests::profile());
        let lines = |part: &str| text.lines().filter(|line| line.contains(part)).count();
        assert_eq!(lines("full-context"), 4, "{text}");
        assert_eq!((lines("approximate"), lines("Not measured: something")), (1, 1), "{text}");
        assert!(text.contains("a cache line to another core 100 ns"), "{text}");
    }
}
