//! What stderr shows while a run goes on: a bar, or lines where there is no terminal.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::documents::BuildStage;

/// How often a line is written where there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

/// How often the bar is drawn anew.
const DRAWS_PER_S: u8 = 5;

/// The display of one session of a run.
#[derive(Debug)]
pub struct Progress {
    tally: Tally,
    /// When the first step of this session was taken.
    running_since: Option<Instant>,
    phase: String,
    display: Display,
}

#[derive(Debug)]
enum Display {
    Bar(ProgressBar),
    Lines { last: Option<Instant> },
    Nothing,
}

/// The display while documents are built, before a run or for their own sake.
#[derive(Debug)]
pub struct BuildProgress {
    display: Display,
    said: String,
}

impl BuildProgress {
    /// A display that shows nothing yet, and never anything if `quiet`.
    pub fn new(quiet: bool) -> Self {
        Self { display: Display::new(quiet), said: String::new() }
    }

    /// Building is at `stage` now.
    pub fn show(&mut self, stage: BuildStage) {
        let (what, counts) = match stage {
            BuildStage::Waiting => ("another build in the same folder has to end first", None),
            BuildStage::Starting => ("starting simulator and memory", None),
            BuildStage::Views(done, total) => {
                ("looking at the demonstrations", Some((done, total)))
            }
            BuildStage::Writing(done, total) => ("writing documents", Some((done, total))),
        };
        let line = match counts {
            Some((done, total)) => format!("{what}: {done}/{total}"),
            None => what.to_owned(),
        };
        match &mut self.display {
            Display::Bar(bar) => {
                let (done, total) = counts.unwrap_or_default();
                bar.set_length(total);
                bar.set_position(done);
                bar.set_message(line);
            }
            Display::Lines { last } => {
                let is_new = self.said != what;
                if is_new || last.is_none_or(|last| last.elapsed() >= LINE_INTERVAL) {
                    eprintln!("{line}");
                    *last = Some(Instant::now());
                }
            }
            Display::Nothing => {}
        }
        what.clone_into(&mut self.said);
    }

    /// Takes the bar away.
    pub fn close(self) {
        if let Display::Bar(bar) = &self.display {
            bar.finish_and_clear();
        }
    }
}

impl Display {
    fn new(quiet: bool) -> Self {
        if quiet {
            return Self::Nothing;
        }
        if !std::io::stderr().is_terminal() {
            return Self::Lines { last: None };
        }
        let target = ProgressDrawTarget::stderr_with_hz(DRAWS_PER_S);
        let bar = ProgressBar::with_draw_target(Some(0), target);
        if let Ok(style) = ProgressStyle::with_template("{bar:24} {msg}") {
            bar.set_style(style);
        }
        Self::Bar(bar)
    }
}

/// What has been done so far.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    /// Episodes of the whole run.
    total: u64,
    /// Those that earlier sessions finished, and how many of them were successful.
    earlier: (u64, u64),
    /// Those of this session, and how many of them were successful.
    finished: (u64, u64),
    /// Those given up.
    errored: u64,
    /// Steps of this session.
    steps: u64,
}

impl Progress {
    /// The display of a run of `total` episodes of which `finished` are done, `successes` of them
    /// successfully.
    pub fn new(total: usize, finished: usize, successes: usize, quiet: bool) -> Self {
        let display = Display::new(quiet);
        if let Display::Bar(bar) = &display {
            bar.set_length(total as u64);
        }
        let tally = Tally {
            total: total as u64,
            earlier: (finished as u64, successes as u64),
            ..Tally::default()
        };
        Self { tally, running_since: None, phase: String::new(), display }
    }

    /// What is going on before steps are taken: starting, loading the encoder, ...
    pub fn phase(&mut self, phase: &str) {
        if phase != self.phase {
            self.phase = phase.to_owned();
            match &self.display {
                Display::Bar(bar) => bar.set_message(self.phase.clone()),
                Display::Lines { .. } => eprintln!("{phase}"),
                Display::Nothing => {}
            }
        }
    }

    /// Steps were taken.
    pub fn steps(&mut self, count: u64) {
        if count > 0 {
            self.running_since.get_or_insert_with(Instant::now);
            self.tally.steps += count;
        }
    }

    /// An episode ended.
    pub fn finished(&mut self, success: bool) {
        self.tally.finished.0 += 1;
        self.tally.finished.1 += u64::from(success);
    }

    /// An episode was given up.
    pub fn errored(&mut self) {
        self.tally.errored += 1;
    }

    /// Draws anew, if it is time to.
    pub fn tick(&mut self) {
        let Some(since) = self.running_since else { return };
        let line = || self.tally.line(since.elapsed());
        match &mut self.display {
            Display::Bar(bar) => {
                bar.set_position(self.tally.done());
                bar.set_message(line());
            }
            Display::Lines { last } => {
                if last.is_none_or(|last| last.elapsed() >= LINE_INTERVAL) {
                    eprintln!("{}", line());
                    *last = Some(Instant::now());
                }
            }
            Display::Nothing => {}
        }
    }

    /// Says something that stays, above the bar. It is said even where progress is not.
    pub fn note(&self, note: &str) {
        match &self.display {
            Display::Bar(bar) => bar.suspend(|| eprintln!("{note}")),
            Display::Lines { .. } | Display::Nothing => eprintln!("{note}"),
        }
    }

    /// Takes the bar away; where there is none, says where things stand at the end.
    pub fn close(self) {
        match (&self.display, self.running_since) {
            (Display::Bar(bar), _) => bar.finish_and_clear(),
            (Display::Lines { .. }, Some(since)) => {
                eprintln!("{}", self.tally.line(since.elapsed()));
            }
            (Display::Lines { .. } | Display::Nothing, _) => {}
        }
    }
}

impl Tally {
    fn done(&self) -> u64 {
        self.earlier.0 + self.finished.0 + self.errored
    }

    /// Everything there is to say, after `running` of this session.
    fn line(&self, running: Duration) -> String {
        let mut parts = vec![format!("{}/{} episodes", self.done(), self.total)];
        let seconds = running.as_secs_f64();
        // Over less than a second a rate says nothing.
        if seconds >= 1.0 {
            parts.push(format!("{:.0} steps/s", self.steps as f64 / seconds));
        }
        let (episodes, successes) =
            (self.earlier.0 + self.finished.0, self.earlier.1 + self.finished.1);
        if episodes > 0 {
            parts.push(format!("SR {:.1} %", 100.0 * successes as f64 / episodes as f64));
        }
        if self.errored > 0 {
            parts.push(format!("{} given up", self.errored));
        }
        // Earlier sessions say nothing about how fast this one is.
        let now = self.finished.0 + self.errored;
        if now > 0 {
            let left = self.total.saturating_sub(self.done()) as f64 * seconds / now as f64;
            parts.push(format!("{} left", span(left)));
        }
        parts.join(", ")
    }
}

/// A time as people say it: `48 s`, `3 min 20 s`, `1 h 05 min`.
fn span(seconds: f64) -> String {
    let s = seconds.round() as u64;
    match s {
        0..60 => format!("{s} s"),
        60..3600 => format!("{} min {:02} s", s / 60, s % 60),
        _ => format!("{} h {:02} min", s / 3600, s / 60 % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_says_how_far_how_fast_how_well_and_how_long() {
        let tally = Tally { total: 400, ..Tally::default() };
        let after = |tally: Tally, s| tally.line(Duration::from_secs(s));
        assert_eq!(after(tally, 0), "0/400 episodes");
        let tally = Tally { steps: 1000, finished: (50, 20), ..tally };
        assert_eq!(after(tally, 10), "50/400 episodes, 100 steps/s, SR 40.0 %, 1 min 10 s left");
        // A resumed run counts everything, and takes its time from what this session did.
        let tally = Tally { earlier: (100, 100), errored: 50, ..tally };
        assert_eq!(
            after(tally, 10),
            "200/400 episodes, 100 steps/s, SR 80.0 %, 50 given up, 20 s left"
        );
    }

    #[test]
    fn times_are_written_as_people_say_them() {
        for (seconds, expected) in
            [(0.2, "0 s"), (59.6, "1 min 00 s"), (200.0, "3 min 20 s"), (3900.0, "1 h 05 min")]
        {
            assert_eq!(span(seconds), expected);
        }
    }
}
