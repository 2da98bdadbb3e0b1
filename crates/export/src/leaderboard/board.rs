//! Entries arranged for comparison: a section for each protocol, a table for each start and route.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};

use report::table::{WIDTH, table, wrap};
use results::policy::PolicyLabel;
use serde_json::Value;

use super::{Entry, EntryFigure, Score};

/// A leaderboard.
#[derive(Debug)]
pub struct Board {
    /// Its sections. Figures of different sections cannot be compared.
    pub sections: Vec<BoardSection>,
}

/// The entries with one protocol.
#[derive(Debug)]
pub struct BoardSection {
    /// The suite.
    pub suite: String,
    /// The first digits of the hash of the protocol.
    pub id: String,
    /// Name and value of everything in the protocol.
    pub protocol: Vec<(String, String)>,
    /// In what it differs from the first section of the same suite, if there is one.
    pub differs: Vec<String>,
    /// Its tables.
    pub tables: Vec<BoardTable>,
}

/// Results with one start and route.
#[derive(Debug)]
pub struct BoardTable {
    /// Start and route in words.
    pub title: String,
    /// The figures that any row has.
    pub columns: Vec<&'static BoardColumn>,
    /// The rows, by the first figure, the best first.
    pub rows: Vec<BoardRow>,
}

/// A column of figures.
#[derive(Debug, PartialEq, Eq)]
pub struct BoardColumn {
    name: &'static str,
    /// Its heading, with the unit.
    pub title: &'static str,
    digits: usize,
}

/// A result.
#[derive(Debug)]
pub struct BoardRow {
    /// The run.
    pub run: String,
    /// When it began.
    pub date: String,
    /// The policy.
    pub policy: PolicyLabel,
    /// The memory.
    pub memory: String,
    /// The demonstrations.
    pub demonstrations: String,
    /// Variations of the prompt and arm; empty for the standard.
    pub variation: String,
    /// Episodes or sequences.
    pub count: usize,
    /// As many as the run has.
    pub planned: usize,
    figures: Vec<Option<EntryFigure>>,
}

/// All figures in the order of their columns.
static COLUMNS: [BoardColumn; 13] = [
    BoardColumn { name: "sr", title: "Success, %", digits: 1 },
    BoardColumn { name: "spl", title: "SPL", digits: 3 },
    BoardColumn { name: "success", title: "Success, %", digits: 1 },
    BoardColumn { name: "acc", title: "ACC, %", digits: 1 },
    BoardColumn { name: "bwt", title: "BWT, points", digits: 1 },
    BoardColumn { name: "fwt", title: "FWT, points", digits: 1 },
    BoardColumn { name: "forgetting", title: "Forgetting, points", digits: 1 },
    BoardColumn { name: "t_ndtw", title: "t-nDTW", digits: 3 },
    BoardColumn { name: "follow", title: "Follow, %", digits: 1 },
    BoardColumn { name: "recovery", title: "Recovery, %", digits: 1 },
    BoardColumn { name: "steps", title: "Steps", digits: 1 },
    BoardColumn { name: "images_per_request", title: "Images a request", digits: 1 },
    BoardColumn { name: "tokens_per_100", title: "Tokens for 100 cases", digits: 0 },
];

/// A cell as it is shown and sorted.
#[derive(Debug, PartialEq)]
pub struct BoardCell {
    /// The mean; empty if it was not measured.
    pub figure: String,
    /// The 95 % interval; empty if there is none.
    pub interval: String,
    /// What it is sorted by; empty if it was not measured.
    pub value: String,
}

impl BoardRow {
    /// The cells of `columns`.
    pub fn cells(&self, columns: &[&'static BoardColumn]) -> Vec<BoardCell> {
        let cell = |(figure, column): (&Option<EntryFigure>, &&BoardColumn)| {
            let shown = |value: f64| format!("{value:.*}", column.digits);
            let interval = figure.and_then(|figure| figure.low.zip(figure.high));
            let interval = interval.map(|(low, high)| format!("[{}, {}]", shown(low), shown(high)));
            BoardCell {
                figure: figure.map(|figure| shown(figure.mean)).unwrap_or_default(),
                interval: interval.unwrap_or_default(),
                value: figure.map(|figure| figure.mean.to_string()).unwrap_or_default(),
            }
        };
        self.figures.iter().zip(columns).map(cell).collect()
    }

    /// Whether episodes or sequences are missing.
    pub fn is_incomplete(&self) -> bool {
        self.count < self.planned
    }

    /// The number of episodes, with the planned one where some are missing.
    pub fn counted(&self) -> String {
        match self.is_incomplete() {
            true => format!("{} of {}", self.count, self.planned),
            false => self.count.to_string(),
        }
    }
}

impl Board {
    /// Arranges `entries`.
    pub fn new(entries: &[Entry]) -> Self {
        let mut by_protocol: BTreeMap<(&str, String), Vec<&Entry>> = BTreeMap::new();
        for entry in entries {
            let protocol = serde_json::to_string(&entry.protocol).unwrap_or_default();
            by_protocol.entry((entry.suite(), protocol)).or_default().push(entry);
        }
        let mut first: BTreeMap<&str, (&Entry, String)> = BTreeMap::new();
        let mut sections = Vec::new();
        for ((suite, protocol), entries) in &by_protocol {
            let Some(entry) = entries.first() else { continue };
            let id = blake3::hash(protocol.as_bytes()).to_hex()[..8].to_owned();
            let differs = match first.get(suite) {
                Some((other, of)) => differences(&entry.protocol, &other.protocol, of),
                None => Vec::new(),
            };
            first.entry(suite).or_insert((entry, id.clone()));
            let shown = entry.protocol.iter().map(|(name, value)| (name.clone(), word(value)));
            sections.push(BoardSection {
                suite: (*suite).to_owned(),
                id,
                protocol: shown.collect(),
                differs,
                tables: tables(entries),
            });
        }
        Self { sections }
    }

    /// The suites, each once.
    pub fn suites(&self) -> BTreeSet<&str> {
        self.sections.iter().map(|section| section.suite.as_str()).collect()
    }

    /// It as text for a terminal.
    pub fn text(&self) -> String {
        let mut text = String::new();
        for section in &self.sections {
            text.push_str(&format!("Suite {}, protocol {}\n", section.suite, section.id));
            for differs in &section.differs {
                for line in wrap(&format!("not comparable: {differs}"), WIDTH - 2) {
                    text.push_str(&format!("  {line}\n"));
                }
            }
            for one in &section.tables {
                text.push_str(&format!("\n{}\n{}\n", one.title, one.text().trim_end()));
            }
            text.push('\n');
        }
        text.trim_end().to_owned()
    }
}

/// What a reader has to know before the figures are compared: `seed: 2 here, 1 in protocol 3f2a`.
fn differences(
    here: &BTreeMap<String, Value>,
    there: &BTreeMap<String, Value>,
    id: &str,
) -> Vec<String> {
    let shown = |value: Option<&String>| value.map_or("not set".to_owned(), Clone::clone);
    let (here, there) = (words(here), words(there));
    let keys: BTreeSet<&String> = here.keys().chain(there.keys()).collect();
    keys.into_iter()
        .filter(|key| here.get(*key) != there.get(*key))
        .map(|key| {
            let (here, there) = (shown(here.get(key)), shown(there.get(key)));
            format!("{key} is {here} here and {there} in protocol {id}")
        })
        .collect()
}

/// The values as they are shown, those of a table each by itself: `stream.blocks`.
fn words(of: &BTreeMap<String, Value>) -> BTreeMap<String, String> {
    let parts = |(key, value): (&String, &Value)| match value.as_object() {
        Some(table) => {
            table.iter().map(|(part, value)| (format!("{key}.{part}"), word(value))).collect()
        }
        None => vec![(key.clone(), word(value))],
    };
    of.iter().flat_map(parts).collect()
}

/// A value as it is shown: texts without quotes, hashes shortened.
fn word(value: &Value) -> String {
    match value.as_str() {
        Some(text) if text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit()) => {
            text[..12].to_owned()
        }
        Some(text) => text.to_owned(),
        None => value.to_string(),
    }
}

fn tables(entries: &[&Entry]) -> Vec<BoardTable> {
    let mut settings: BTreeMap<String, Vec<(&Entry, &Score)>> = BTreeMap::new();
    for &entry in entries {
        for score in &entry.scores {
            let title = match score.condition() {
                Some(one) => format!("{} start, {} route", one.start, one.route),
                None => "conditions that this version does not know".to_owned(),
            };
            settings.entry(title).or_default().push((entry, score));
        }
    }
    settings.into_iter().map(|(title, scores)| BoardTable::new(title, &scores)).collect()
}

impl BoardTable {
    fn new(title: String, scores: &[(&Entry, &Score)]) -> Self {
        let is_measured = |column: &&BoardColumn| {
            scores.iter().any(|(_, one)| one.figures.contains_key(column.name))
        };
        let columns: Vec<&'static BoardColumn> = COLUMNS.iter().filter(is_measured).collect();
        let mut rows: Vec<BoardRow> =
            scores.iter().map(|(entry, score)| row(entry, score, &columns)).collect();
        // The two main figures.
        let means = |row: &BoardRow| {
            // Figures that are the same on paper differ by rounding.
            let mean =
                |figure: &Option<EntryFigure>| figure.map(|figure| (figure.mean * 1e9).round());
            row.figures.iter().take(2).map(mean).collect::<Vec<_>>()
        };
        rows.sort_by(|a, b| {
            let by_figure = means(b).partial_cmp(&means(a)).unwrap_or(Ordering::Equal);
            by_figure.then_with(|| (&a.run, &a.memory).cmp(&(&b.run, &b.memory)))
        });
        Self { title, columns, rows }
    }

    fn text(&self) -> String {
        let mut header = vec!["run", "policy", "memory", "demos", "n"];
        // The two main figures; the page has the others.
        let columns = &self.columns[..self.columns.len().min(2)];
        header.extend(columns.iter().map(|column| column.title));
        let mut text = table(&header, 4);
        for row in &self.rows {
            let memory = match row.variation.is_empty() {
                true => row.memory.clone(),
                false => format!("{} ({})", row.memory, row.variation),
            };
            let mut cells =
                vec![row.run.clone(), row.policy.to_string(), memory, row.demonstrations.clone()];
            cells.push(row.counted());
            let figures = row.cells(columns).into_iter();
            cells.extend(figures.map(|cell| format!("{} {}", cell.figure, cell.interval)));
            text.add_row(cells);
        }
        text.to_string()
    }
}

fn row(entry: &Entry, score: &Score, columns: &[&'static BoardColumn]) -> BoardRow {
    // memory/start/route/demonstrations, then what deviates.
    let mut words = score.condition.split('/');
    let memory = words.next().unwrap_or_default().to_owned();
    let demonstrations = words.nth(2).unwrap_or_default().to_owned();
    let version = entry.memories.get(&memory);
    let memory = version.map_or(memory.clone(), |version| format!("{memory} {version}"));
    BoardRow {
        run: entry.run.clone(),
        date: entry.date.clone().unwrap_or_default(),
        policy: entry.policy.label(),
        memory,
        demonstrations,
        variation: words.collect::<Vec<_>>().join(", "),
        count: score.count,
        planned: score.planned,
        figures: columns.iter().map(|column| score.figures.get(column.name).copied()).collect(),
    }
}

#[cfg(test)]
mod tests {
    use domain::StreamOrder;
    use results::log::EpisodeRecord;
    use results::log::testing::{keyed, log, record, stream_log, stream_record};

    use super::*;

    #[test]
    fn runs_whose_figures_differ_by_rounding_stand_in_the_order_of_their_names() {
        // 3 and 5 of 6 cases are 66.66666666666666 % on average, 2 of 3 are 66.66666666666667 %.
        let run_of = |name: &str, counts: &[(usize, usize)]| {
            let of_run = |(run, &(successes, cases)): (u32, &(usize, usize))| {
                let of_case = move |case: usize| {
                    let record = record(&format!("t01-{case:02}"), case < successes);
                    keyed(EpisodeRecord { run, ..record })
                };
                (0..cases).map(of_case)
            };
            let mut log = log((1..).zip(counts).flat_map(of_run).collect());
            log.name = name.to_owned();
            Entry::of(&log).unwrap()
        };
        let (lower, higher) = (run_of("a", &[(3, 6), (5, 6)]), run_of("b", &[(2, 3)]));
        for entries in [[lower.clone(), higher.clone()], [higher, lower]] {
            let board = Board::new(&entries);
            let rows = &board.sections[0].tables[0].rows;
            assert_eq!(rows.iter().map(|row| row.run.as_str()).collect::<Vec<_>>(), ["a", "b"]);
        }
    }

    #[test]
    fn runs_with_another_protocol_are_apart_and_the_difference_is_named() {
        let entry = |name: &str, success: bool, seed: u64| {
            let mut log = log(vec![record("t01-01", success), record("t01-02", true)]);
            log.name = name.to_owned();
            log.manifest.settings.seed = seed;
            Entry::of(&log).unwrap()
        };
        let board = Board::new(&[
            entry("weak", false, 1),
            entry("strong", true, 1),
            entry("other", true, 2),
        ]);
        assert_eq!(board.sections.len(), 2);
        let runs = |section: &BoardSection| {
            section.tables[0].rows.iter().map(|row| row.run.clone()).collect::<Vec<_>>()
        };
        assert_eq!(runs(&board.sections[0]), ["strong", "weak"]);
        assert_eq!(runs(&board.sections[1]), ["other"]);
        let text = board.text();
        let ids: Vec<&str> = board.sections.iter().map(|section| section.id.as_str()).collect();
        let text = text.replace(ids[0], "FIRST").replace(ids[1], "SECOND");
        insta::assert_snapshot!(text, @"
        Suite quick, protocol FIRST

        original start, unchanged route
        ────────────────────────────────────────────────────────────────────────────────────────────────────
        run     policy                       memory    demos     n          Success, %                   SPL
        ────────────────────────────────────────────────────────────────────────────────────────────────────
        strong  grounded, scripted stand-in  episodic  original  2  100.0 [0.0, 100.0]  0.800 [0.000, 1.000]
        weak    grounded, scripted stand-in  episodic  original  2   50.0 [0.0, 100.0]  0.400 [0.000, 1.000]
        ────────────────────────────────────────────────────────────────────────────────────────────────────

        Suite quick, protocol SECOND
          not comparable: seed is 2 here and 1 in protocol FIRST

        original start, unchanged route
        ───────────────────────────────────────────────────────────────────────────────────────────────────
        run    policy                       memory    demos     n          Success, %                   SPL
        ───────────────────────────────────────────────────────────────────────────────────────────────────
        other  grounded, scripted stand-in  episodic  original  2  100.0 [0.0, 100.0]  0.800 [0.000, 1.000]
        ───────────────────────────────────────────────────────────────────────────────────────────────────
        ");
        assert!(text.lines().all(|line| line.chars().count() <= 100));
    }

    #[test]
    fn of_stream_settings_those_that_differ_are_named() {
        let entry = |blocks, orders: &[StreamOrder]| {
            let mut log = stream_log(vec![stream_record("t01-01", true)], [blocks, 1, 2]);
            log.manifest.settings.stream.as_mut().unwrap().orders = orders.to_vec();
            Entry::of(&log).unwrap()
        };
        let board = Board::new(&[entry(2, &StreamOrder::ALL), entry(3, &[StreamOrder::Drawn])]);
        let text = board.text();
        let text = text.replace(&board.sections[0].id, "FIRST");
        let lines: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("  ")).collect();
        insta::assert_snapshot!(lines.join("\n"), @r#"
        not comparable: stream.blocks is 3 here and 2 in protocol FIRST
        not comparable: stream.orders is ["drawn"] here and ["drawn","reversed","shuffled"] in protocol
        FIRST
        "#);
        assert!(text.lines().all(|line| line.chars().count() <= 100));
    }
}
