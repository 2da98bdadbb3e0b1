//! A profile as tables for a terminal.

use orchestrator::profile::recorder::{AccessPart, StepClass};
use report::table::table;

use super::page::{find, ns, us};
use super::{AccessRun, CacheState, Profile};

/// The tables: accesses by memory, searches by size, and the floors in a line.
pub(crate) fn summary(profile: &Profile) -> String {
    let mut text = String::new();
    text += "Accesses to memory, from observation to recall (later steps): medians of the parts, then the whole\n";
    let header =
        ["memory", "wire", "embed", "search", "assemble", "p50", "p90", "p99", "max", "first p50"];
    let is_shown = |run: &&AccessRun| run.lanes == 1 || run.caches == CacheState::Warm;
    for run in profile.runs.iter().filter(is_shown) {
        let mut accesses = table(&header, 1);
        for memory in run.memories() {
            let times = |step, part| find(run, memory, step, part);
            let Some(total) = times(StepClass::Later, AccessPart::Total) else { continue };
            let p50 =
                |step, part| times(step, part).map_or_else(|| "-".to_owned(), |t| us(t.p50_us));
            let mut row = vec![memory.to_string()];
            let parts =
                [AccessPart::Wire, AccessPart::Embedding, AccessPart::Search, AccessPart::Assembly];
            row.extend(parts.map(|part| p50(StepClass::Later, part)));
            let tail = [total.p50_us, total.p90_us, total.p99_us, total.max_us];
            row.extend(tail.map(us));
            row.push(p50(StepClass::First, AccessPart::Total));
            accesses.add_row(row);
        }
        text += &format!("\n{}\n{accesses}\n", run.name());
    }
    if !profile.searches.is_empty() {
        let header = ["entries", "at once", "p50", "p99", "max", "queries/s", "GB/s read"];
        let mut searches = table(&header, 1);
        for search in &profile.searches {
            let times = &search.latency_ns;
            let mut row = vec![search.entries.to_string(), search.batch.to_string()];
            row.extend([times.p50, times.p99, times.max].map(|time| ns(time as f64)));
            row.push(format!("{:.0}", search.queries_per_s));
            row.push(format!("{:.1}", search.bytes_per_s / 1e9));
            searches.add_row(row);
        }
        text += &format!("\nSearch alone\n{searches}\n");
    }
    let floors = &profile.floors;
    text += &format!(
        "\nFloors of this machine: {} for a cache line to another core, {} to copy a frame,\n\
         {:.1} GB/s read from memory with one thread, {:.1} with all cores",
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
    fn the_summary_has_every_memory_every_search_and_every_problem() {
        let text = summary(&super::super::tests::profile());
        assert!(text.lines().all(|line| line.chars().count() <= 100), "{text}");
        let lines = |part: &str| text.lines().filter(|line| line.contains(part)).count();
        assert_eq!(lines("full-context"), 4, "{text}");
        assert_eq!((lines("GB/s read "), lines("Not measured: something")), (1, 1), "{text}");
        assert!(text.contains("100 ns for a cache line to another core"), "{text}");
    }
}
