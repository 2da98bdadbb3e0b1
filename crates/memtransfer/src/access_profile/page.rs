//! A profile as a page: floors, accesses by memory, polling, lanes, sizes.

use std::collections::BTreeSet;

use anyhow::Result;
use domain::MemoryKind;
use orchestrator::profile::recorder::{AccessLatency, AccessPart, StepClass};
use report::{
    Curve, Curves, ReportBlock, ReportDocument, ReportFigure, ReportSection, RowGroup, Stack,
    StackRow, Table, TableCell, TableColumn, TableRow, curves, stack,
};
use run_log::latency::LatencySummary;

use super::{AccessRun, CacheState, Profile};

/// The page, before it has a form.
pub(crate) fn document(profile: &Profile) -> Result<ReportDocument> {
    let mut sections = vec![about(profile), floors(profile)];
    sections.push(memories(profile)?);
    sections.extend(waiting(profile));
    sections.extend(lanes(profile)?);
    sections.extend(sizes(profile)?);
    Ok(ReportDocument { title: "MemTransfer: access to memory".to_owned(), sections })
}

fn about(profile: &Profile) -> ReportSection {
    let mut blocks = vec![
        ReportBlock::Text(
            "An access begins when the simulator has published an observation, and ends when the policy has the \
             recall that answers it. Its parts are the messages there and back (wire), the embeddings that the answer \
             needs (embedding), the nearest remembered view (search), and the recall itself (assembly). All processes \
             stamp their messages with the same clock."
                .to_owned(),
        ),
        ReportBlock::Terms(vec![
            ("machine".to_owned(), profile.machine.summary()),
            ("program".to_owned(), {
                let commit = profile.commit.as_deref().unwrap_or("unknown");
                format!("memtransfer {}, commit {commit}", profile.version)
            }),
            ("encoder".to_owned(), profile.encoder.clone()),
            (
                "cold".to_owned(),
                "nothing is cached: every view is rendered and embedded for the first time".to_owned(),
            ),
            (
                "warm".to_owned(),
                "views were rendered before the first step, and their embeddings are in the cache folder".to_owned(),
            ),
            (
                "first, later".to_owned(),
                "the first step of an episode, which waits for its memory to be built, and all others".to_owned(),
            ),
        ]),
    ];
    blocks.extend(
        profile
            .problems
            .iter()
            .map(|problem| ReportBlock::Notice(format!("Not measured: {problem}"))),
    );
    ReportSection::new("s-about", "What was measured", blocks)
}

fn floors(profile: &Profile) -> ReportSection {
    let floors = &profile.floors;
    let gb = |bytes: f64| format!("{:.1} GB/s", bytes / 1e9);
    let rows = vec![
        ("a cache line from one core to another".to_owned(), vec![ns(floors.cache_line_ns)]),
        ("a memcpy of a frame of 448 x 448 pixels".to_owned(), vec![ns(floors.frame_copy_ns)]),
        ("reading memory with one thread".to_owned(), vec![gb(floors.read_one_thread)]),
        ("reading memory with all cores".to_owned(), vec![gb(floors.read_all_cores)]),
    ];
    let caption = "What this machine achieves at best, measured in the same session.";
    let table = Table::of_text("t-floors", caption, (&["floor"], &["figure"]), rows);
    ReportSection::new("s-floors", "The machine's floors", vec![ReportBlock::Table(table)])
}

/// The run with one lane, blocking.
fn single_lane(profile: &Profile, caches: CacheState) -> Option<&AccessRun> {
    profile.runs.iter().find(|run| run.caches == caches && run.lanes == 1 && run.spin_us == 0)
}

fn memories(profile: &Profile) -> Result<ReportSection> {
    let mut blocks = Vec::new();
    for caches in [CacheState::Warm, CacheState::Cold] {
        let Some(run) = single_lane(profile, caches) else { continue };
        blocks.push(ReportBlock::Figure(stacked(run)?));
        blocks.push(ReportBlock::Table(distribution(run)));
    }
    Ok(ReportSection::new("s-memories", "By memory", blocks))
}

/// The parts of later steps, stacked.
fn stacked(run: &AccessRun) -> Result<ReportFigure> {
    let parts = [AccessPart::Wire, AccessPart::Embedding, AccessPart::Search, AccessPart::Assembly];
    // Cold, the few steps that wait for an embedding matter; warm, a median is not moved by outliers.
    let (name, value): (_, fn(&LatencySummary) -> f64) = match run.caches {
        CacheState::Cold => ("means", |times| times.mean_us),
        CacheState::Warm => ("medians", |times| times.p50_us),
    };
    let rows = run.memories().into_iter().map(|memory| {
        let length = |part| find(run, memory, StepClass::Later, part).map(value);
        StackRow {
            heading: None,
            label: memory.to_string(),
            lengths: parts.iter().map(|part| length(*part)).collect(),
        }
    });
    let plot = Stack {
        id: format!("f-split-{}", run.caches),
        caption: format!("An access by memory, {}, later steps: {name} of the parts.", run.name()),
        axis: "microseconds",
        to: None,
        parts: parts.iter().map(AccessPart::to_string).collect(),
        rows: rows.collect(),
    };
    Ok(stack(&plot))
}

fn distribution(run: &AccessRun) -> Table {
    let groups = run.memories().into_iter().map(|memory| {
        let of = |latency: &&AccessLatency| latency.memory == memory;
        let rows: Vec<TableRow> = run
            .latencies
            .iter()
            .filter(of)
            .map(|latency| TableRow {
                label: format!("{} {}", latency.step, latency.part),
                published: false,
                cells: cells(&latency.times),
            })
            .collect();
        RowGroup { label: Some(memory.to_string()), rows }
    });
    Table {
        id: format!("t-split-{}", run.caches),
        caption: format!(
            "Accesses by memory, {}: {} episodes, {} steps.",
            run.name(),
            run.episodes,
            run.steps
        ),
        stubs: vec!["Memory".to_owned(), "Steps and part".to_owned()],
        columns: TIMES.iter().map(|name| TableColumn::new(*name)).collect(),
        groups: groups.collect(),
    }
}

/// Blocking beside polling.
fn waiting(profile: &Profile) -> Option<ReportSection> {
    let runs: Vec<&AccessRun> = profile
        .runs
        .iter()
        .filter(|run| run.caches == CacheState::Warm && run.lanes == 1)
        .collect();
    if runs.len() < 2 {
        return None;
    }
    let groups = runs.iter().map(|run| {
        let row = |memory: MemoryKind| {
            let total = find(run, memory, StepClass::Later, AccessPart::Total)?;
            let label = memory.to_string();
            Some(TableRow { label, published: false, cells: cells(total) })
        };
        RowGroup {
            label: Some(run.name()),
            rows: run.memories().into_iter().filter_map(row).collect(),
        }
    });
    let table = Table {
        id: "t-waiting".to_owned(),
        caption: "Whole accesses of later steps, of processes that sleep at once and of processes that poll first. With more \
                  processes than cores, those that poll keep the others from working."
            .to_owned(),
        stubs: vec!["Waiting".to_owned(), "Memory".to_owned()],
        columns: TIMES.iter().map(|name| TableColumn::new(*name)).collect(),
        groups: groups.collect(),
    };
    Some(ReportSection::new("s-waiting", "Blocking and polling", vec![ReportBlock::Table(table)]))
}

fn lanes(profile: &Profile) -> Result<Option<ReportSection>> {
    let runs: Vec<&AccessRun> = profile
        .runs
        .iter()
        .filter(|run| run.caches == CacheState::Warm && run.spin_us == 0)
        .collect();
    if runs.len() < 2 {
        return Ok(None);
    }
    let memories: BTreeSet<MemoryKind> = runs.iter().flat_map(|run| run.memories()).collect();
    let plot = |id: &str, what: &str, at: fn(&LatencySummary) -> f64| {
        let curve = |memory: MemoryKind| {
            let point = |run: &&AccessRun| {
                let total = find(run, memory, StepClass::Later, AccessPart::Total)?;
                Some((f64::from(run.lanes), at(total)))
            };
            let points: Vec<(f64, f64)> = runs.iter().filter_map(point).collect();
            let name = memory.to_string();
            (!points.is_empty()).then_some(Curve { name, is_bound: false, points })
        };
        curves(&Curves {
            id: id.to_owned(),
            caption: format!(
                "{what} of whole accesses against lanes; warm, blocking, later steps."
            ),
            across: "lanes".to_owned(),
            up: "microseconds".to_owned(),
            curves: memories.iter().copied().filter_map(curve).collect(),
        })
    };
    let rows = runs.iter().map(|run| {
        let rate = run.steps as f64 / run.seconds.max(f64::MIN_POSITIVE);
        let cells = vec![run.steps.to_string(), format!("{rate:.0}")];
        (run.lanes.to_string(), cells)
    });
    let caption = "Throughput from the first command to the last decision, first steps included.";
    Ok(Some(ReportSection::new(
        "s-lanes",
        "Against lanes",
        vec![
            ReportBlock::Text(
                "With many lanes a step waits for others, in queues and for cores: latency grows together with \
                 throughput."
                    .to_owned(),
            ),
            ReportBlock::Figure(plot("f-lanes-p50", "The median", |times| times.p50_us)),
            ReportBlock::Figure(plot("f-lanes-p99", "The 99th percentile", |times| times.p99_us)),
            ReportBlock::Table(Table::of_text("t-lanes", caption, (&["Lanes"], &["steps", "steps/s"]), rows)),
        ],
    )))
}

fn sizes(profile: &Profile) -> Result<Option<ReportSection>> {
    if profile.searches.is_empty() {
        return Ok(None);
    }
    let batches: BTreeSet<usize> = profile.searches.iter().map(|search| search.batch).collect();
    let mut shown: Vec<Curve> = batches
        .into_iter()
        .map(|batch| Curve {
            name: if batch == 1 { "one query".to_owned() } else { format!("{batch} at once") },
            is_bound: false,
            points: profile
                .searches
                .iter()
                .filter(|search| search.batch == batch)
                .map(|search| (f64::from(search.entries), search.seconds() * 1e6))
                .collect(),
        })
        .collect();
    let single = profile.searches.iter().filter(|search| search.batch == 1);
    shown.push(Curve {
        name: "reading all vectors once, at the floor".to_owned(),
        is_bound: true,
        points: single
            .map(|search| {
                let bytes = f64::from(search.entries) * search.dimension as f64 * 4.0;
                (f64::from(search.entries), bytes / profile.floors.read_all_cores * 1e6)
            })
            .collect(),
    });
    let figure = curves(&Curves {
        id: "f-sizes".to_owned(),
        caption: "The median time of a search against the entries of the memory.".to_owned(),
        across: "entries".to_owned(),
        up: "microseconds".to_owned(),
        curves: shown,
    });
    let rows = profile.searches.iter().map(|search| {
        let times = &search.latency_ns;
        let mut cells =
            vec![search.batch.to_string(), search.threads.to_string(), search.real.to_string()];
        cells.extend(
            [times.p50, times.p90, times.p99, times.p999, times.max].map(|time| ns(time as f64)),
        );
        cells.push(format!("{:.0}", search.queries_per_s));
        cells.push(format!("{:.1}", search.bytes_per_s / 1e9));
        cells.push(format!("{:.1}", search.bytes as f64 / f64::from(1 << 20)));
        cells.push(format!("{:.2}", search.build_s));
        (search.entries.to_string(), cells)
    });
    let columns = [
        "at once",
        "threads",
        "real",
        "p50",
        "p90",
        "p99",
        "p99.9",
        "max",
        "queries/s",
        "GB/s read",
        "MiB",
        "build s",
    ];
    let caption = "Searches alone, among real embeddings and seeded neighbours of them. GB/s: what a search \
                   reads.";
    let table = Table::of_text("t-sizes", caption, (&["Entries"], &columns), rows);
    Ok(Some(ReportSection::new(
        "s-sizes",
        "Against the size of the memory",
        vec![ReportBlock::Figure(figure), ReportBlock::Table(table)],
    )))
}

/// The columns of a distribution.
const TIMES: [&str; 7] = ["count", "mean", "p50", "p90", "p99", "p99.9", "max"];

fn cells(times: &LatencySummary) -> Vec<TableCell> {
    let shown = [times.p50_us, times.p90_us, times.p99_us, times.p999_us, times.max_us].map(us);
    let first = [times.count.to_string(), us(times.mean_us)];
    first.into_iter().chain(shown).map(TableCell::Value).collect()
}

/// The latency of a part of the accesses to a memory, if there were any.
pub(crate) fn find(
    run: &AccessRun,
    memory: MemoryKind,
    step: StepClass,
    part: AccessPart,
) -> Option<&LatencySummary> {
    let is =
        |found: &&AccessLatency| found.memory == memory && found.step == step && found.part == part;
    run.latencies.iter().find(is).map(|found| &found.times)
}

/// A time in microseconds, in a suitable unit.
pub(crate) fn us(time: f64) -> String {
    ns(time * 1e3)
}

/// A time in nanoseconds, in a suitable unit.
pub(crate) fn ns(time: f64) -> String {
    match time {
        time if time >= 1e9 => format!("{:.2} s", time / 1e9),
        time if time >= 1e6 => format!("{:.2} ms", time / 1e6),
        time if time >= 1e3 => format!("{:.1} us", time / 1e3),
        time => format!("{time:.0} ns"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_a_suitable_unit() {
        for (time, text) in
            [(250.0, "250 ns"), (62_000.0, "62.0 us"), (4.5e6, "4.50 ms"), (2e9, "2.00 s")]
        {
            assert_eq!(ns(time), text);
        }
    }

    #[test]
    fn a_small_profile_has_a_page() {
        let mut little = super::super::tests::profile();
        little.runs.truncate(1);
        little.searches.clear();
        let page = document(&little).unwrap();
        let ids: Vec<&str> = page.sections.iter().map(|section| section.id.as_str()).collect();
        assert_eq!(ids, ["s-about", "s-floors", "s-memories"]);
    }
}
