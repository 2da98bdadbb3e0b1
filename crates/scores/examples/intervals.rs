//! Prints how often the 95 % intervals of scores hold the true figure, and how often the sign test finds a difference
//! where there is none: in a single comparison, and in a family of them before and after the correction.
//!
//!     cargo run --release -p scores --example intervals [DRAWS [SEED]]
//!
//! Runs are drawn whose figures are known, and scored as any run. A table has a row for each number of cases and a column for each
//! success rate: the percentage of drawn runs whose interval holds the true figure.

#![expect(clippy::print_stdout, reason = "a program that prints")]

use std::fmt::Write;

use conditions::Condition;
use domain::{Arm, StreamOrder};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rigs::records::{log, record, sequence, stream_log, under};
use run_log::{Ending, EpisodeRecord, RunLog};
use scores::{Derived, Interval, LEVEL, Pairing, Side, holm, score};

/// True success rates.
const RATES: [f64; 9] = [0.02, 0.05, 0.1, 0.2, 0.5, 0.8, 0.9, 0.95, 0.98];

/// Numbers of cases.
const SIZES: [usize; 6] = [5, 10, 20, 50, 100, 300];

/// Numbers of streams.
const STREAMS: [usize; 4] = [3, 5, 10, 20];

/// Steps of a reference.
const REFERENCE: u32 = 10_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let draws = arguments.next().map_or(Ok(2000), |text| text.parse())?;
    let seed = arguments.next().map_or(Ok(1), |text| text.parse())?;
    println!("{draws} draws, seed {seed}.\n");
    println!("{}", levels(&mut Random::new(seed), draws));
    println!("{}", families(seed, draws));
    for simulation in SIMULATIONS {
        println!("{}", simulation.text(seed, draws, simulation.sizes));
    }
    Ok(())
}

/// Random numbers from a seed.
struct Random(ChaCha8Rng);

impl Random {
    fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// From 0 to 1, 1 excluded.
    fn share(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn is_below(&mut self, probability: f64) -> bool {
        self.share() < probability
    }
}

/// How the episodes of a case come about.
#[derive(Clone, Copy)]
struct Design {
    /// Repetitions of each case.
    repetitions: u32,
    /// The share of cases whose outcome is the same in all repetitions; the others are thrown anew each time.
    decided: f64,
    /// The shortest path of a success as a share of what it takes; the ratio is uniform from here to 1.
    shortest: f64,
}

const ONE: Design = Design { repetitions: 1, decided: 0.0, shortest: 0.5 };
const THREE: Design = Design { repetitions: 3, ..ONE };
const MIXED: Design = Design { decided: 0.3, ..THREE };
const SHORT: Design = Design { shortest: 0.98, ..ONE };

/// Draws the repetitions of one case with the true success rate `rate`.
fn draw(records: &mut [EpisodeRecord], rate: f64, design: Design, random: &mut Random) {
    let decided = random.is_below(design.decided).then(|| random.is_below(rate));
    for record in records {
        let success = decided.unwrap_or_else(|| random.is_below(rate));
        settle(record, success, design.shortest, random);
    }
}

fn settle(record: &mut EpisodeRecord, success: bool, shortest: f64, random: &mut Random) {
    record.ending = if success { Ending::Complete } else { Ending::OutOfSteps };
    record.reference = REFERENCE;
    let ratio = shortest + (1.0 - shortest) * random.share();
    record.steps = (f64::from(REFERENCE) / ratio).round() as u32;
}

/// A log of `cases` cases: of each, the repetitions under the first condition, then those under the next.
fn empty(cases: usize, conditions: &[(&str, u32)]) -> RunLog {
    let mut episodes = Vec::new();
    for case in 0..cases {
        for (name, repetitions) in conditions {
            let condition = condition(name);
            let of_run = |run| EpisodeRecord { run, ..record(&format!("c{case:03}"), true) };
            episodes.extend((1..=*repetitions).map(|run| under(condition, of_run(run))));
        }
    }
    let mut log = log(episodes);
    log.timings.clear();
    log
}

fn condition(name: &str) -> Condition {
    name.parse().unwrap_or_else(|_| unreachable!("the names in this file are conditions"))
}

/// Runs that are drawn, and the tables of their figures.
struct Simulation {
    sampling: Sampling,
    sizes: &'static [usize],
    /// The titles of the tables of the figures of [`Sampling::draw`], in its order; no title, no table.
    titles: [&'static str; 2],
}

/// How runs are drawn.
#[derive(Clone, Copy)]
enum Sampling {
    /// One condition: success rate, SPL.
    One(Design),
    /// Two conditions: the differences of success rate and of SPL.
    Two(Design, Sides),
    /// Two conditions on the unchanged and on the blocked route: change, retention.
    Blocked(Design),
    /// Streams: success of learning episodes.
    Streams,
}

/// A true figure, and the interval found.
type Found = (f64, Option<Interval>);

/// How the second side of a comparison goes with the first.
#[derive(Clone, Copy)]
struct Sides {
    /// By how much its true success rate is less; by as much more where that is below 0.
    less: f64,
    /// The share of its episodes with the same outcome as the first side's.
    same: f64,
}

const EQUAL: Sides = Sides { less: 0.0, same: 0.0 };
const CLOSE: Sides = Sides { less: 0.0, same: 0.7 };
const WORSE: Sides = Sides { less: 0.3, same: 0.0 };

/// What is left of the success rate on the blocked route in [`Sampling::Blocked`].
const RETAINED: f64 = 0.6;
/// Success rates of working memory there, unchanged and blocked.
const BASELINE: [f64; 2] = [0.4, 0.3];
/// The conditions.
const FOUR: [&str; 4] = [
    "episodic/new/unchanged/4",
    "episodic/new/blocked/4",
    "working/new/unchanged/none",
    "working/new/blocked/none",
];

const fn over_cases(sampling: Sampling, titles: [&'static str; 2]) -> Simulation {
    Simulation { sampling, sizes: &SIZES, titles }
}

const SIMULATIONS: [Simulation; 10] = [
    over_cases(
        Sampling::One(ONE),
        ["SR, 1 repetition", "SPL, 1 repetition, ratio uniform from 0.5 to 1"],
    ),
    over_cases(Sampling::One(SHORT), ["", "SPL, 1 repetition, ratio uniform from 0.98 to 1"]),
    over_cases(Sampling::One(THREE), ["SR, 3 repetitions, cases alike", ""]),
    over_cases(
        Sampling::One(MIXED),
        [
            "SR, 3 repetitions, 30 % of cases always or never succeed",
            "SPL, 3 repetitions, 30 % of cases always or never succeed, ratio uniform from 0.5 to 1",
        ],
    ),
    over_cases(Sampling::Two(ONE, EQUAL), ["Difference of SR: none, sides independent", ""]),
    over_cases(Sampling::Two(ONE, CLOSE), ["Difference of SR: none, 70 % of outcomes shared", ""]),
    over_cases(
        Sampling::Two(ONE, WORSE),
        ["Difference of SR: 30 points", "Difference of SPL: 30 points of SR"],
    ),
    over_cases(Sampling::Two(MIXED, WORSE), ["Difference of SR: 30 points, 3 repetitions", ""]),
    over_cases(Sampling::Blocked(ONE), ["Delta", "R, where it has an interval"]),
    Simulation {
        sampling: Sampling::Streams,
        sizes: &STREAMS,
        titles: ["Success over streams of 24 learning episodes, where streams differ", ""],
    },
];

/// How often intervals held the true figure.
#[derive(Default, Clone, Copy)]
struct Tally {
    intervals: u32,
    held: u32,
    width: f64,
}

impl Tally {
    fn add(&mut self, Interval { low, high }: Interval, truth: f64) {
        self.intervals += 1;
        // Sums of many values are exact to some digits only.
        self.held += u32::from(low <= truth + 1e-9 && truth <= high + 1e-9);
        self.width += high - low;
    }

    /// The percentage of intervals that held the figure; `None` of none.
    fn percent(self) -> Option<f64> {
        (self.intervals > 0).then(|| 100.0 * f64::from(self.held) / f64::from(self.intervals))
    }
}

impl Simulation {
    /// The tables, for these `sizes`.
    fn text(&self, seed: u64, draws: u32, sizes: &[usize]) -> String {
        let rates: Vec<String> =
            RATES.iter().map(|rate| format!("{:.0} %", 100.0 * rate)).collect();
        let unit = if matches!(self.sampling, Sampling::Streams) { "streams" } else { "cases" };
        let mut texts = self.titles.map(|title| {
            format!(
                "{title}\n\n| {unit} | {} | least | mean | mean width |\n|---:|{}\n",
                rates.join(" | "),
                "---:|".repeat(RATES.len() + 3)
            )
        });
        for &size in sizes {
            // Every cell has a seed of its own, so that it does not matter which is drawn first.
            let cell = |rate: f64| {
                let mut random = Random::new(seed ^ ((size as u64) << 32) ^ rate.to_bits());
                self.sampling.tally(size, rate, draws, &mut random)
            };
            let cell = &cell;
            let cells: Vec<[Tally; 2]> = std::thread::scope(|scope| {
                let threads = RATES.map(|rate| scope.spawn(move || cell(rate)));
                threads.into_iter().flat_map(std::thread::ScopedJoinHandle::join).collect()
            });
            for (figure, text) in texts.iter_mut().enumerate() {
                let tallies: Vec<Tally> = cells.iter().map(|cell| cell[figure]).collect();
                *text += &row(size, &tallies);
            }
        }
        let titled = self.titles.iter().zip(texts).filter(|(title, _)| !title.is_empty());
        titled.map(|(_, text)| text).collect::<Vec<_>>().join("\n")
    }
}

fn row(size: usize, tallies: &[Tally]) -> String {
    let held: Vec<Option<f64>> = tallies.iter().map(|tally| tally.percent()).collect();
    let (intervals, width) = tallies.iter().fold((0, 0.0), |(intervals, width), tally| {
        (intervals + tally.intervals, width + tally.width)
    });
    let shown = |held: &Option<f64>| held.map_or("-".to_owned(), |percent| format!("{percent:.1}"));
    let cells: Vec<String> = held.iter().map(shown).collect();
    let known: Vec<f64> = held.into_iter().flatten().collect();
    let least = known.iter().copied().fold(f64::INFINITY, f64::min);
    let mean = known.iter().sum::<f64>() / known.len() as f64;
    let width = width / f64::from(intervals);
    format!("| {size} | {} | {least:.1} | {mean:.1} | {width:.3} |\n", cells.join(" | "))
}

impl Sampling {
    /// Draws as many runs.
    fn tally(self, size: usize, rate: f64, draws: u32, random: &mut Random) -> [Tally; 2] {
        let mut log = self.log(size);
        let mut tallies = [Tally::default(); 2];
        for _ in 0..draws {
            for ((truth, found), tally) in
                self.draw(&mut log, rate, random).into_iter().zip(&mut tallies)
            {
                if let Some(interval) = found {
                    tally.add(interval, truth);
                }
            }
        }
        tallies
    }

    /// The log into which runs of `cases` cases, or streams, are drawn.
    fn log(self, cases: usize) -> RunLog {
        match self {
            Self::One(design) => empty(cases, &[(FOUR[0], design.repetitions)]),
            Self::Two(design, _) => {
                empty(cases, &[FOUR[0], FOUR[2]].map(|name| (name, design.repetitions)))
            }
            Self::Blocked(design) => empty(cases, &FOUR.map(|name| (name, design.repetitions))),
            Self::Streams => streams(cases),
        }
    }

    /// Draws a run and scores it.
    fn draw(self, log: &mut RunLog, rate: f64, random: &mut Random) -> [Found; 2] {
        match self {
            Self::One(design) => {
                draw_cases(log, &[rate], design, random);
                let found = &score(log).conditions[0];
                let spl = rate * mean_ratio(design);
                [(100.0 * rate, found.sr.interval), (spl, found.spl.interval)]
            }
            Self::Two(design, sides) => {
                draw_sides(log, rate, sides, design, random);
                let difference = rate - sides.second(rate);
                let found = paired(log).map(|found| found.differences());
                let [sr, spl] = found.map_or([None; 2], |found| found.map(|one| one.interval));
                [(100.0 * difference, sr), (difference * mean_ratio(design), spl)]
            }
            Self::Blocked(design) => {
                let rates = [rate, RETAINED * rate, BASELINE[0], BASELINE[1]];
                draw_cases(log, &rates, design, random);
                let change = (rates[1] - rates[0]) - (rates[3] - rates[2]);
                let scores = score(log);
                let found = scores.of(&condition(FOUR[1])).and_then(|score| score.blocked);
                let interval =
                    |derived: Option<Derived>| derived.and_then(|derived| derived.interval);
                let [change_found, retention] =
                    found.map_or([None; 2], |found| [found.change, found.retention]).map(interval);
                [(100.0 * change, change_found), (RETAINED, retention)]
            }
            Self::Streams => {
                draw_streams(log, rate, random);
                let success = score(log).streams.and_then(|found| found.conditions[0].success);
                [(100.0 * rate, success.and_then(|found| found.interval)), (0.0, None)]
            }
        }
    }
}

impl Sides {
    /// The true success rate of the second side.
    fn second(self, rate: f64) -> f64 {
        (rate - self.less).abs()
    }
}

fn mean_ratio(design: Design) -> f64 {
    0.5 * (design.shortest + 1.0)
}

/// The first condition of [`FOUR`] and its third, paired.
fn paired(log: &RunLog) -> Option<Pairing<'_>> {
    let side = |name: &str| Side { name: name.to_owned(), log, condition: condition(name) };
    Pairing::of(side(FOUR[0]), side(FOUR[2]))
}

/// Draws the conditions of every case, each at its rate.
fn draw_cases(log: &mut RunLog, rates: &[f64], design: Design, random: &mut Random) {
    let each = design.repetitions as usize;
    for records in log.episodes.chunks_mut(each * rates.len()) {
        for (records, &rate) in records.chunks_mut(each).zip(rates) {
            draw(records, rate, design, random);
        }
    }
}

/// Draws both sides of a comparison.
fn draw_sides(log: &mut RunLog, rate: f64, sides: Sides, design: Design, random: &mut Random) {
    let each = design.repetitions as usize;
    for records in log.episodes.chunks_mut(2 * each) {
        let (first, second) = records.split_at_mut(each);
        draw(first, rate, design, random);
        draw(second, sides.second(rate), design, random);
        for (record, other) in second.iter_mut().zip(first) {
            if random.is_below(sides.same) {
                settle(record, other.is_success(), design.shortest, random);
            }
        }
    }
}

/// A log of `streams` streams of 24 learning episodes each.
fn streams(streams: usize) -> RunLog {
    let cases = ["a", "b", "c", "d", "e", "f"];
    let blocks: [(u32, &[&str]); 2] = [(0, &cases), (1, &cases)];
    let condition =
        Condition { arm: Arm::Learning, ..condition("episodic/new/unchanged/original") };
    let of_stream =
        |stream| sequence((condition, 1), (stream, StreamOrder::Drawn), &blocks, 2, |_, _| true);
    let episodes = (0..streams as u32).flat_map(of_stream).collect();
    let mut log = stream_log(episodes, [2, cases.len() as u32, 2]);
    log.timings.clear();
    log
}

/// Draws streams. Half of them succeed more often than `rate`, the others less, by half of the distance to the nearer end.
fn draw_streams(log: &mut RunLog, rate: f64, random: &mut Random) {
    let number = |record: &EpisodeRecord| record.stream.as_ref().map(|stream| stream.stream);
    for records in log.episodes.chunk_by_mut(|a, b| number(a) == number(b)) {
        let distance = 0.5 * rate.min(1.0 - rate);
        let own = if random.is_below(0.5) { rate + distance } else { rate - distance };
        draw(records, own, ONE, random);
    }
}

/// How often the sign test finds a difference at 5 % between conditions that do not differ, with 100 cases.
fn levels(random: &mut Random, draws: u32) -> String {
    let mut text = "Comparisons of conditions that do not differ, 100 cases: percentage with p < 0.05\n\n\
                    | repetitions | 10 %, cases alike | 50 %, cases alike | 10 %, 30 % of cases decided | 50 %, 30 % of cases decided |\n\
                    |---|---:|---:|---:|---:|\n"
        .to_owned();
    for repetitions in [[1, 1], [3, 3], [3, 1], [3, 5]] {
        let mut log = two(repetitions);
        let mut cells = Vec::new();
        for decided in [0.0, 0.3] {
            for rate in [0.1, 0.5] {
                let found = (0..draws)
                    .filter(|_| differ(&mut log, rate, decided, random).is_some_and(|p| p < 0.05));
                cells.push(format!("{:.1}", 100.0 * found.count() as f64 / f64::from(draws)));
            }
        }
        let [a, b] = repetitions;
        let _ = writeln!(text, "| {a} : {b} | {} |", cells.join(" | "));
    }
    text
}

/// A log of 100 cases under two conditions with different repetitions.
fn two([a, b]: [u32; 2]) -> RunLog {
    empty(100, &[(FOUR[0], a), (FOUR[2], b)])
}

/// Draws two conditions with the same success rate in every case. Returns p of their comparison.
fn differ(log: &mut RunLog, rate: f64, decided: f64, random: &mut Random) -> Option<f64> {
    for records in log.episodes.chunk_by_mut(|a, b| a.case == b.case) {
        // What decides a case decides it on both sides.
        draw(records, rate, Design { decided, ..ONE }, random);
    }
    paired(log).map(|found| found.p())
}

/// How a family of comparisons is drawn: external memories against four built-in ones, in two settings, so that comparisons
/// share sides.
#[derive(Clone, Copy)]
struct Family {
    /// External memories; there are 8 comparisons of each.
    memories: usize,
    /// The share of them that succeed in 30 points more, or less, of their cases; only the others can be found different where they
    /// are not.
    different: f64,
    cases: usize,
    repetitions: u32,
    rate: f64,
}

/// Built-in memories, and settings.
const BUILT_IN: usize = 4;
const SETTINGS: usize = 2;

impl Family {
    /// Draws the success of each case: how often in its repetitions. Some cases are easier than others on all sides.
    fn side(self, rate: f64, ease: &[f64], random: &mut Random) -> Vec<u32> {
        let draw = |ease: &f64| {
            let share = (rate + ease).clamp(0.0, 1.0);
            (0..self.repetitions).map(|_| u32::from(random.is_below(share))).sum()
        };
        ease.iter().map(draw).collect()
    }

    /// Draws a family. Returns whether a comparison without a difference has p below 5 %, before and after the correction.
    fn finds(self, tests: &[Vec<f64>], random: &mut Random) -> [bool; 2] {
        let spread = 0.5 * self.rate.min(1.0 - self.rate);
        let mut p = Vec::new();
        let mut is_null = Vec::new();
        for _ in 0..SETTINGS {
            let ease: Vec<f64> =
                (0..self.cases).map(|_| spread * (2.0 * random.share() - 1.0)).collect();
            let built_in: Vec<Vec<u32>> =
                (0..BUILT_IN).map(|_| self.side(self.rate, &ease, random)).collect();
            for memory in 0..self.memories {
                let differs = (memory as f64) < self.different * self.memories as f64;
                let rate = if differs { (self.rate - 0.3).abs() } else { self.rate };
                let own = self.side(rate, &ease, random);
                for other in &built_in {
                    let count = |is_more: fn(&u32, &u32) -> bool| {
                        own.iter().zip(other).filter(|(own, other)| is_more(own, other)).count()
                    };
                    let (better, worse) = (count(|a, b| a > b), count(|a, b| a < b));
                    p.push(tests[better + worse][better.min(worse)]);
                    is_null.push(!differs);
                }
            }
        }
        let finds = |p: &[f64]| p.iter().zip(&is_null).any(|(p, is_null)| *is_null && *p < LEVEL);
        [finds(&p), finds(&holm(&p))]
    }
}

/// p of the sign test for each number of unequal cases and each smaller count among them.
fn sign_tests(cases: usize) -> Vec<Vec<f64>> {
    let of = |unequal: usize| {
        // Pascal's rule, halved in each row: the probabilities of so many heads.
        let mut heads = vec![1.0];
        for _ in 0..unequal {
            let shifted = [0.0].into_iter().chain(heads.iter().copied());
            let same = heads.iter().copied().chain([0.0]);
            heads = shifted.zip(same).map(|(fewer, same)| 0.5 * (fewer + same)).collect();
        }
        let mut tail = 0.0;
        let two_sided = |probability: &f64| {
            tail += probability;
            (2.0 * tail).min(1.0)
        };
        heads.iter().map(two_sided).collect()
    };
    (0..=cases).map(of).collect()
}

/// How often families of comparisons find a difference where there is none.
fn families(seed: u64, draws: u32) -> String {
    let mut text = format!(
        "Families of comparisons of external memories with {BUILT_IN} built-in ones in {SETTINGS} settings: percentage in which a \
         difference is found where there is none, before and after the correction (Holm), and below which the latter is with a \
         confidence of 95 %\n\n\
         | comparisons | memories that differ | cases | repetitions | success | before | after | below |\n\
         |---:|---:|---:|---:|---:|---:|---:|---:|\n"
    );
    let mut all = Vec::new();
    for (memories, different) in [(1, 0.0), (5, 0.0), (5, 0.4), (20, 0.0)] {
        for (cases, repetitions) in [(20, 1), (100, 1), (100, 3)] {
            for rate in [0.1, 0.5] {
                all.push(Family { memories, different, cases, repetitions, rate });
            }
        }
    }
    for (number, family) in (0_u64..).zip(all) {
        let tests = sign_tests(family.cases);
        let mut random = Random::new(seed ^ (number << 32));
        let mut found = [0; 2];
        for _ in 0..draws {
            for (count, finds) in found.iter_mut().zip(family.finds(&tests, &mut random)) {
                *count += u32::from(finds);
            }
        }
        let percent = |count: u32| 100.0 * f64::from(count) / f64::from(draws);
        let Family { memories, different, cases, repetitions, rate } = family;
        let _ = writeln!(
            text,
            "| {} | {:.0} % | {cases} | {repetitions} | {:.0} % | {:.1} | {:.1} | {:.1} |",
            memories * BUILT_IN * SETTINGS,
            100.0 * different,
            100.0 * rate,
            percent(found[0]),
            percent(found[1]),
            100.0 * upper_limit(found[1], draws),
        );
    }
    text
}

/// The one-sided upper limit of a share with a confidence of 95 % (C. J. Clopper and E. S. Pearson, Biometrika 26, 1934): the
/// share with which at most `found` of `draws` are found in 5 % of such simulations.
fn upper_limit(found: u32, draws: u32) -> f64 {
    let at_most = |share: f64| {
        let mut log_probability = f64::from(draws) * (1.0 - share).ln();
        let mut sum = log_probability.exp();
        for count in 1..=found {
            let ways = f64::from(draws - count + 1) / f64::from(count);
            log_probability += (ways * share / (1.0 - share)).ln();
            sum += log_probability.exp();
        }
        sum
    };
    let (mut low, mut high) = (f64::from(found) / f64::from(draws), 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if at_most(middle) > 0.05 { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corrected_families_find_differences_where_there_are_none_in_few_draws() {
        let family = Family { memories: 5, different: 0.0, cases: 50, repetitions: 1, rate: 0.5 };
        let tests = sign_tests(family.cases);
        let mut random = Random::new(1);
        let found: Vec<[bool; 2]> = (0..400).map(|_| family.finds(&tests, &mut random)).collect();
        let count = |which: usize| found.iter().filter(|finds| finds[which]).count();
        // At most 20 on average; more than 35 are as good as impossible. Uncorrected, they are more than 100.
        assert!(count(0) > 100 && count(1) <= 35, "{} and {}", count(0), count(1));
    }

    #[test]
    fn the_table_of_sign_tests_is_that_of_comparisons() {
        let tests = sign_tests(10);
        assert_eq!(
            (tests[0][0], tests[6][0], tests[5][1], tests[10][2]),
            (1.0, 0.03125, 0.375, 0.109_375)
        );
        // None of 59: 1 - 0.05^(1/59).
        assert!((upper_limit(0, 59) - (1.0 - 0.05_f64.powf(1.0 / 59.0))).abs() < 1e-9);
    }

    #[test]
    fn tables_have_a_row_for_each_size_and_are_the_same_each_time() {
        for simulation in SIMULATIONS {
            let text = || simulation.text(1, 20, &simulation.sizes[1..3]);
            let rows = text().lines().filter(|line| line.starts_with("| ")).count();
            let tables = simulation.titles.iter().filter(|title| !title.is_empty()).count();
            assert_eq!(rows, 3 * tables, "{}", text());
            assert_eq!(text(), text());
        }
    }

    #[test]
    fn the_sign_test_holds_its_level_also_with_unequal_repetitions() {
        let mut random = Random::new(1);
        // 7 of 200 on average; more than 20 are as good as impossible. Means of 3 and of 1 repetitions would differ in 130.
        for repetitions in [[3, 3], [3, 1], [3, 5]] {
            let mut log = two(repetitions);
            let found = (0..200)
                .filter(|_| differ(&mut log, 0.1, 0.0, &mut random).is_some_and(|p| p < 0.05));
            assert!(found.count() <= 20, "{repetitions:?}");
        }
    }

    #[test]
    fn intervals_hold_the_true_rate_in_nearly_all_runs() {
        let mut random = Random::new(1);
        for size in [5, 20, 50] {
            let tallies =
                RATES.map(|rate| Sampling::One(ONE).tally(size, rate, 100, &mut random)[0]);
            let held: u32 = tallies.iter().map(|tally| tally.held).sum();
            // Of 900 runs about 97.5 to 99 %.
            assert!(held > 864, "{size} cases: {held}");
        }
    }
}
