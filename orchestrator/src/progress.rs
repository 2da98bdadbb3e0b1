//! Shows on stderr how far something is: a bar in a terminal that can erase it, otherwise a line every few seconds.

use std::io::Write;
use std::time::{Duration, Instant};

use crate::documents::BuildStage;
use crate::status::duration;

/// What is shown on stderr.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verbosity {
    /// Progress and notes.
    Progress,
    /// Notes only.
    Notes,
    /// Nothing.
    Silent,
}

impl Verbosity {
    /// That of a command which is given `--quiet`, or is not.
    pub const fn of_quiet(quiet: bool) -> Self {
        if quiet { Self::Notes } else { Self::Progress }
    }
}

/// Shows how far the building of documents is.
#[derive(Debug)]
pub struct BuildProgress {
    display: ProgressDisplay,
    /// What is done while a document is written.
    title: String,
    /// Of what is counted now.
    pace: Option<Pace>,
}

impl BuildProgress {
    /// A display that shows nothing yet.
    pub fn new(verbosity: Verbosity) -> Self {
        Self::titled(verbosity, None)
    }

    /// One that says what is being written; `None`: documents.
    pub fn titled(verbosity: Verbosity, title: Option<String>) -> Self {
        let title = title.unwrap_or_else(|| "writing documents".to_owned());
        Self { display: ProgressDisplay::new(verbosity), title, pace: None }
    }

    /// Shows `stage`.
    pub fn show(&mut self, stage: BuildStage) {
        let (phase, counts) = match stage {
            BuildStage::Waiting => ("waiting for another build in the same folder", None),
            BuildStage::Starting => ("starting the builder", None),
            BuildStage::Writing(done, total) => (&*self.title, Some((done, total))),
        };
        let left = counts.and_then(|counts| time_left(&mut self.pace, counts));
        let left = left.map_or_else(String::new, |left| format!(", {} left", duration(left)));
        self.display.show(phase, counts.unwrap_or_default(), || match counts {
            Some((done, total)) => format!("{phase}: {done}/{total}{left}"),
            None => phase.to_owned(),
        });
    }

    /// Removes the bar. Where there is no terminal, a line says whether the documents are complete.
    pub fn close(self, complete: bool) {
        let state = if complete { "done" } else { "not complete" };
        self.display.close(|| format!("documents: {state}"));
    }
}

/// How fast parts are done.
#[derive(Debug, Clone, Copy)]
struct Pace {
    /// When the first number of them was reported.
    start: Instant,
    /// That number, of parts that were done before.
    first: u64,
    /// The last number that was reported.
    last: u64,
}

/// The time that the rest of `total` parts takes, if it goes on at this pace; `None` before one is done. When `done` falls, something
/// else is counted, at a pace of its own.
fn time_left(pace: &mut Option<Pace>, (done, total): (u64, u64)) -> Option<Duration> {
    let now = Pace { start: Instant::now(), first: done, last: done };
    let Pace { start, first, last } = pace.filter(|pace| pace.last <= done).unwrap_or(now);
    *pace = Some(Pace { start, first, last: last.max(done) });
    let done_now = (done > first).then_some(done - first)?;
    let rate = total.saturating_sub(done) as f64 / done_now as f64;
    Duration::try_from_secs_f64(start.elapsed().as_secs_f64() * rate).ok()
}

/// Time between two lines where there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

/// Time between two drawings of the bar.
const DRAW_INTERVAL: Duration = Duration::from_millis(200);

/// Characters of the bar.
const BAR: u64 = 24;

/// Columns of a terminal that does not report its width.
const COLUMNS: usize = 100;

/// The display of progress.
#[derive(Debug)]
pub struct ProgressDisplay {
    target: ProgressTarget,
    phase: String,
    shown: Option<Instant>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ProgressTarget {
    Bar,
    Lines,
    Nothing,
    /// As `Nothing`, and no notes.
    Silence,
}

impl ProgressDisplay {
    /// A display that shows nothing yet.
    pub fn new(verbosity: Verbosity) -> Self {
        let target = match verbosity {
            Verbosity::Progress if program::is_screen(&std::io::stderr()) => ProgressTarget::Bar,
            Verbosity::Progress => ProgressTarget::Lines,
            Verbosity::Notes => ProgressTarget::Nothing,
            Verbosity::Silent => ProgressTarget::Silence,
        };
        Self { target, phase: String::new(), shown: None }
    }

    /// Shows `line`, with `done` of `total` in the bar. A new `phase` is shown at once, everything else at intervals.
    pub fn show(&mut self, phase: &str, (done, total): (u64, u64), line: impl FnOnce() -> String) {
        let interval = match self.target {
            ProgressTarget::Bar => DRAW_INTERVAL,
            ProgressTarget::Lines => LINE_INTERVAL,
            ProgressTarget::Nothing | ProgressTarget::Silence => return,
        };
        let is_new = self.phase != phase;
        if !is_new && self.shown.is_some_and(|shown| shown.elapsed() < interval) {
            return;
        }
        phase.clone_into(&mut self.phase);
        self.shown = Some(Instant::now());
        if self.target == ProgressTarget::Lines {
            return say(&line());
        }
        let columns = terminal_size::terminal_size_of(std::io::stderr());
        let columns = columns.map_or(COLUMNS, |(width, _)| usize::from(width.0));
        erase_line();
        write_to_stderr(&bar(done, total, &line(), columns));
    }

    /// Prints a message that stays, above the bar; also where no progress is shown.
    pub fn note(&mut self, note: &str) {
        if self.target == ProgressTarget::Silence {
            return;
        }
        if self.target == ProgressTarget::Bar && self.shown.take().is_some() {
            erase_line();
        }
        say(note);
    }

    /// Removes the bar; where there are lines, prints the `last` one.
    pub fn close(self, last: impl FnOnce() -> String) {
        match self.target {
            _ if self.shown.is_none() => {}
            ProgressTarget::Bar => erase_line(),
            ProgressTarget::Lines => say(&last()),
            ProgressTarget::Nothing | ProgressTarget::Silence => {}
        }
    }
}

fn erase_line() {
    write_to_stderr("\r\x1b[2K");
}

/// Prints a message to stderr. A message that cannot be printed is lost, and does no harm: the terminal may be closed while
/// a run is stopping, or going on.
pub fn say(message: &str) {
    // A process or a server may have said what the message repeats.
    write_to_stderr(&format!("{}\n", program::printable(message)));
}

fn write_to_stderr(text: &str) {
    let mut stderr = std::io::stderr().lock();
    let _ = stderr.write_all(text.as_bytes()).and_then(|()| stderr.flush());
}

/// A bar and a text, in as many columns as there are.
fn bar(done: u64, total: u64, text: &str, columns: usize) -> String {
    let full = (BAR * done.min(total)).checked_div(total).unwrap_or(0) as usize;
    let empty = BAR as usize - full;
    let bar = format!("[{}{}] {text}", "#".repeat(full), ".".repeat(empty));
    // A line that wraps could not be erased.
    program::printable(&bar).chars().take(columns.saturating_sub(1)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_left_follows_from_what_is_done_now() {
        let mut pace = None;
        // Three of ten were done before.
        assert_eq!(time_left(&mut pace, (3, 10)), None);
        let earlier = |pace: Option<Pace>| {
            pace.map(|pace| Pace { start: pace.start - Duration::from_secs(600), ..pace })
        };
        pace = earlier(pace);
        let minutes = |left: Option<Duration>| left.map(|left| left.as_secs() / 60);
        assert!(minutes(time_left(&mut pace, (5, 10))) >= Some(25));
        assert_eq!(time_left(&mut pace, (10, 10)), Some(Duration::ZERO));
        // The next document, of which nothing is done.
        assert_eq!(time_left(&mut pace, (0, 4)), None);
        pace = earlier(pace);
        assert!(minutes(time_left(&mut pace, (1, 4))) >= Some(30));
    }

    #[test]
    fn a_bar_fits_its_columns() {
        assert_eq!(bar(1, 2, "x", 100), "[############............] x");
        assert_eq!(bar(0, 0, "x", 100), "[........................] x");
        assert_eq!(bar(5, 2, "abc", 20).chars().count(), 19);
    }
}
