//! Gates: what a run is required to show, decided by intervals (specification, section 7).
//!
//! A gate says of one figure on which side of a bound it has to lie. It is passed where the whole 95 % interval satisfies it,
//! failed where none of the interval does, and otherwise undecided. So a run can only pass by having measured enough.
//!
//! The interval is two-sided, so a gate whose true figure lies on the wrong side is passed in about 2.5 % of runs. That all of
//! several gates are passed although one of them should not be is no more likely, since that one would have to be passed, too
//! (the intersection-union test of R. L. Berger, "Multiparameter hypothesis testing and acceptance sampling",
//! Technometrics 24, 1982). So nothing is corrected for the number of gates.

use std::collections::BTreeSet;
use std::str::FromStr;

use conditions::{BadCondition, Condition};
use domain::names::{UnknownName, named};
use run_log::RunLog;
use serde::Serialize;

use super::compare::{CompareError, are_two_runs};
use super::comparison::{Pairing, Side};
use super::condition::ConditionScore;
use super::interval::Interval;
use super::{Derived, Scores, Spread};

named! {
    /// A figure of a condition that has an interval.
    GateFigure, "figure with an interval" {
        /// Success rate.
        SuccessRate = "sr",
        /// Success weighted by path length.
        PathLength = "spl",
        /// F.
        Follow = "follow",
        /// C.
        Recovery = "recovery",
        /// Delta.
        Change = "change",
        /// R.
        Retention = "retention",
    }

    /// How a figure has to compare with a bound.
    GateOperator, "operator" {
        /// At least.
        AtLeast = ">=",
        /// At most.
        AtMost = "<=",
        /// More than.
        Above = ">",
        /// Less than.
        Below = "<",
    }

    /// What became of a gate.
    Verdict, "verdict" {
        /// The whole interval satisfies it.
        Passed = "passed",
        /// None of the interval does.
        Failed = "failed",
        /// Neither, or the figure was not measured in full.
        Undecided = "undecided",
    }
}

impl GateFigure {
    /// The unit that its numbers have in tables; empty for plain numbers.
    const fn unit(self) -> &'static str {
        match self {
            Self::SuccessRate | Self::Follow | Self::Recovery => "%",
            Self::Change => "points",
            Self::PathLength | Self::Retention => "",
        }
    }

    /// The values that it can have.
    const fn range(self) -> Interval {
        match self {
            Self::SuccessRate | Self::Follow | Self::Recovery => Interval::PERCENT,
            // The difference of two differences of rates.
            Self::Change => Interval { low: -200.0, high: 200.0 },
            Self::PathLength => Interval::SHARE,
            Self::Retention => Interval::POSITIVE,
        }
    }

    /// Digits after the point with which tables print it.
    pub const fn digits(self) -> usize {
        match self {
            Self::SuccessRate | Self::Follow | Self::Recovery | Self::Change => 1,
            Self::Retention => 2,
            Self::PathLength => 3,
        }
    }

    /// The figure of a condition with its interval; `None` where it was not measured or is not defined.
    fn of(self, score: &ConditionScore) -> Option<(f64, Option<Interval>)> {
        let spread = |spread: Spread| (spread.mean, spread.interval);
        let derived = |derived: Derived| (derived.value, derived.interval);
        match self {
            Self::SuccessRate => Some(spread(score.sr)),
            Self::PathLength => Some(spread(score.spl)),
            Self::Follow => score.blocked?.follow.map(spread),
            Self::Recovery => score.blocked?.recovery.map(spread),
            Self::Change => score.blocked?.change.map(derived),
            Self::Retention => score.blocked?.retention.map(derived),
        }
    }
}

impl GateOperator {
    fn holds(self, value: f64, bound: f64) -> bool {
        match self {
            Self::AtLeast => value >= bound,
            Self::AtMost => value <= bound,
            Self::Above => value > bound,
            Self::Below => value < bound,
        }
    }

    /// The verdict on a figure with this interval.
    fn decide(self, Interval { low, high }: Interval, bound: f64) -> Verdict {
        // Each holds on one side of the bound, so on the whole interval where it does at both ends.
        match (self.holds(low, bound), self.holds(high, bound)) {
            (true, true) => Verdict::Passed,
            (false, false) => Verdict::Failed,
            _ => Verdict::Undecided,
        }
    }
}

/// What is required of a figure of one condition. Written `episodic/new/unchanged/4: sr >= 60`, with or without the unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Gate {
    condition: Condition,
    figure: GateFigure,
    operator: GateOperator,
    bound: f64,
}

/// A text that is not a gate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BadGate {
    /// A part is missing.
    #[error(
        "`{0}` is not a gate: write CONDITION: FIGURE OPERATOR NUMBER, for example `episodic/new/unchanged/4: sr >= 60`"
    )]
    Parts(String),
    /// The condition is none.
    #[error(transparent)]
    Condition(#[from] BadCondition),
    /// The figure or the operator is none.
    #[error(transparent)]
    Name(#[from] UnknownName),
    /// The bound is no number.
    #[error("`{0}` is not a number")]
    Number(String),
    /// The unit is another.
    #[error("{figure} has {}, not `{given}`", unit_words(*figure))]
    Unit {
        /// The figure.
        figure: GateFigure,
        /// The unit.
        given: String,
    },
    /// The figure is never on the other side of the bound.
    #[error("{figure} lies from {} to {}, and the bound is {bound}", figure.range().low, figure.range().high)]
    Range {
        /// The figure.
        figure: GateFigure,
        /// The bound.
        bound: f64,
    },
    /// Every value of the figure satisfies it.
    #[error("every value of {figure} is {operator} {bound}, so this requires nothing")]
    Always {
        /// The figure.
        figure: GateFigure,
        /// The operator.
        operator: GateOperator,
        /// The bound.
        bound: f64,
    },
    /// No value of the figure satisfies it.
    #[error("no value of {figure} is {operator} {bound}, so this cannot be passed")]
    Never {
        /// The figure.
        figure: GateFigure,
        /// The operator.
        operator: GateOperator,
        /// The bound.
        bound: f64,
    },
    /// A bound without a unit that may be meant as a fraction.
    #[error("{figure} is in percent: write `{} %`, or `{bound} %` if that is meant", rounded(bound * 100.0))]
    Fraction {
        /// The figure.
        figure: GateFigure,
        /// The bound.
        bound: f64,
    },
}

/// Without the digits that come from a fraction's rounding.
fn rounded(percent: f64) -> f64 {
    (percent * 1e6).round() / 1e6
}

fn unit_words(figure: GateFigure) -> String {
    match figure.unit() {
        "" => "no unit".to_owned(),
        unit => format!("the unit `{unit}`"),
    }
}

impl FromStr for Gate {
    type Err = BadGate;

    fn from_str(text: &str) -> Result<Self, BadGate> {
        let parts = || BadGate::Parts(text.to_owned());
        let (condition, required) = text.split_once(':').ok_or_else(parts)?;
        let condition = Condition::logged(condition.trim())?;
        let of_operator = |c: char| ['<', '>', '='].contains(&c);
        let begin = required.find(of_operator).ok_or_else(parts)?;
        let (figure, rest) = required.split_at(begin);
        let end = rest.find(|c| !of_operator(c)).ok_or_else(parts)?;
        let (operator, bound) = rest.split_at(end);
        let (figure, operator) =
            (figure.trim().parse::<GateFigure>()?, operator.parse::<GateOperator>()?);
        // Reports print a typographic minus.
        let bound = bound.trim().replace('−', "-");
        let is_of_number = |c: char| c.is_ascii_digit() || ['.', '-', '+'].contains(&c);
        let end = bound.find(|c| !is_of_number(c)).unwrap_or(bound.len());
        let (number, unit) = bound.split_at(end);
        let unit = unit.trim();
        let number = match number.parse::<f64>() {
            Ok(number) => number,
            Err(_) => return Err(BadGate::Number(bound)),
        };
        if !unit.is_empty() && unit != figure.unit() {
            return Err(BadGate::Unit { figure, given: unit.to_owned() });
        }
        let Interval { low, high } = figure.range();
        if !(low..=high).contains(&number) {
            return Err(BadGate::Range { figure, bound: number });
        }
        if unit.is_empty()
            && figure.unit() == GateFigure::SuccessRate.unit()
            && number > 0.0
            && number <= 1.0
        {
            return Err(BadGate::Fraction { figure, bound: number });
        }
        match (operator.holds(low, number), operator.holds(high, number)) {
            (true, true) => return Err(BadGate::Always { figure, operator, bound: number }),
            (false, false) => return Err(BadGate::Never { figure, operator, bound: number }),
            _ => {}
        }
        Ok(Self { condition, figure, operator, bound: number })
    }
}

/// Why gates cannot be checked.
#[derive(Debug, thiserror::Error)]
pub enum GateError {
    /// The run does not have the condition.
    #[error(transparent)]
    Unknown(#[from] UnknownName),
    /// The run consists of streams.
    #[error("{run} consists of streams, and gates are on figures of conditions without streams")]
    OfStreams {
        /// The run's folder.
        run: String,
    },
    /// The runs cannot be compared.
    #[error(transparent)]
    Compare(#[from] CompareError),
    /// There is nothing that the other run could be compared by.
    #[error("{run} has no condition, so it requires nothing")]
    NoCondition {
        /// The other run's folder.
        run: String,
    },
}

/// A gate and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GateResult {
    /// The name of the condition.
    pub condition: String,
    /// The figure.
    pub figure: GateFigure,
    /// The other run, where the figure's difference to that run's on the same cases and repetitions is meant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub against: Option<String>,
    /// How it has to compare with the bound.
    pub operator: GateOperator,
    /// The bound.
    pub bound: f64,
    /// The figure's value, or the difference; `None` where it was not measured or is not defined.
    pub value: Option<f64>,
    /// Its 95 % interval.
    pub interval: Option<Interval>,
    /// The cases that it is of.
    pub cases: usize,
    /// What became of the gate.
    pub verdict: Verdict,
    /// Why the gate is undecided, unless the interval has values on both sides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

impl GateResult {
    /// The gate alone: `episodic/new/unchanged/4: sr >= 60`.
    pub fn gate(&self) -> String {
        let Self { condition, figure, against, operator, bound, .. } = self;
        let difference = against.as_ref().map(|run| format!(" minus {run}'s"));
        format!("{condition}: {figure}{} {operator} {bound}", difference.unwrap_or_default())
    }
}

/// A figure that was measured, or why a gate on it is undecided.
struct Measured {
    value: Option<f64>,
    interval: Option<Interval>,
    cases: usize,
    problem: Option<String>,
}

impl Measured {
    fn not(problem: impl Into<String>) -> Self {
        Self { value: None, interval: None, cases: 0, problem: Some(problem.into()) }
    }
}

impl Gate {
    /// The verdict on what was measured; `against` as in [`GateResult`].
    fn decided(self, against: Option<String>, measured: Measured) -> GateResult {
        let Self { condition, figure, operator, bound } = self;
        let Measured { value, interval, cases, problem } = measured;
        let (verdict, reason) = match (problem, interval) {
            (Some(problem), _) => (Verdict::Undecided, Some(problem)),
            (None, None) => (Verdict::Undecided, Some("it has no interval".to_owned())),
            (None, Some(interval)) => (operator.decide(interval, bound), None),
        };
        GateResult {
            condition: condition.to_string(),
            figure,
            against,
            operator,
            bound,
            value,
            interval,
            cases,
            verdict,
            reason,
        }
    }

    /// Decides the gate for the run `log` with these `scores`.
    ///
    /// # Errors
    /// When the run does not have the condition, or consists of streams.
    pub fn check(self, log: &RunLog, scores: &Scores) -> Result<GateResult, GateError> {
        without_streams(log)?;
        let known = conditions(log, scores);
        if !known.contains(&self.condition) {
            let (given, known) =
                (self.condition.to_string(), known.iter().map(ToString::to_string));
            return Err(UnknownName::new("condition of the run", &given, known).into());
        }
        let measured = match scores.of(&self.condition) {
            None => Measured::not("no episode is finished"),
            Some(score) => {
                let (value, interval) = self.figure.of(score).unzip();
                let problem = incomplete(log, score).or_else(|| {
                    value.is_none().then(|| {
                        match score.blocked {
                            Some(_) => "it was not measured or is not defined",
                            None => "of blocked routes only",
                        }
                        .to_owned()
                    })
                });
                Measured { value, interval: interval.flatten(), cases: score.cases, problem }
            }
        };
        Ok(self.decided(None, measured))
    }
}

/// Requires of each condition of the run `base` that the success rate of the run `log` is there lower by less than `margin`
/// percentage points, on the cases and repetitions that both have.
///
/// # Errors
/// When episodes of the two cannot be paired, or `base` has no condition.
pub fn no_worse_than(
    (log, scores): (&RunLog, &Scores),
    (base, base_scores): (&RunLog, &Scores),
    margin: f64,
) -> Result<Vec<GateResult>, GateError> {
    are_two_runs(log, base)?;
    let required = conditions(base, base_scores);
    if required.is_empty() {
        return Err(GateError::NoCondition { run: base.dir.display().to_string() });
    }
    let known = conditions(log, scores);
    let measured = |condition: &Condition| {
        if !known.contains(condition) {
            return Measured::not(format!("{} does not have this condition", log.name));
        }
        let sides = [(log, scores), (base, base_scores)];
        let problem = sides.into_iter().find_map(|(log, scores)| {
            let problem = match scores.of(condition) {
                None => Some("no episode is finished".to_owned()),
                Some(score) => incomplete(log, score),
            };
            problem.map(|problem| format!("{problem} in {}", log.name))
        });
        let side = |log| Side { name: String::new(), log, condition: *condition };
        match Pairing::of(side(log), side(base)) {
            None => Measured::not(
                problem.unwrap_or_else(|| "no case and repetition in common".to_owned()),
            ),
            Some(pairing) => {
                let [sr, _] = pairing.differences();
                let cases = pairing.cases();
                Measured { value: Some(sr.mean), interval: sr.interval, cases, problem }
            }
        }
    };
    let decided = |condition: Condition| {
        let figure = GateFigure::SuccessRate;
        let measured = measured(&condition);
        // Minus 0 would be printed so.
        let gate = Gate { condition, figure, operator: GateOperator::Above, bound: 0.0 - margin };
        gate.decided(Some(base.name.clone()), measured)
    };
    Ok(required.into_iter().map(decided).collect())
}

/// The conditions that a run has, whether an episode is finished or not.
fn conditions(log: &RunLog, scores: &Scores) -> BTreeSet<Condition> {
    let planned = log.manifest.settings.conditions();
    planned.into_iter().chain(scores.conditions.iter().map(|score| score.condition)).collect()
}

fn without_streams(log: &RunLog) -> Result<(), GateError> {
    let run = || log.dir.display().to_string();
    match log.manifest.settings.stream {
        Some(_) => Err(GateError::OfStreams { run: run() }),
        None => Ok(()),
    }
}

/// Why the run does not have all episodes of a condition; `None` where it has.
fn incomplete(log: &RunLog, score: &ConditionScore) -> Option<String> {
    if log.manifest.unit.is_some() {
        return Some("the run is a unit of a plan: merge the units first".to_owned());
    }
    let missing = score.planned - score.episodes;
    (missing > 0).then(|| format!("{missing} of {} episodes are missing", score.planned))
}

#[cfg(test)]
mod tests;
