//! Published figures that a run's stand beside: those of the paper (`assets/published.toml`), or any table in the same format,
//! which `docs/reproduction.md` defines.

pub(crate) mod configuration;
pub(crate) mod figures;
mod write;

pub(crate) use write::of_run;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use conditions::Condition;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use toml::Spanned;

const PAPER: &str = include_str!("../../../assets/published.toml");

/// Published figures of one policy.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Published {
    /// What they were published in.
    pub title: String,
    /// Where in it, or by whom; may be empty.
    pub source: String,
    /// The policy that the figures are of.
    pub policy: String,
    /// What was configured, as it is printed, by the name of the setting or fact.
    pub configuration: BTreeMap<String, String>,
    /// What else differs from a run of `memtransfer`, in sentences.
    pub notes: Vec<String>,
    /// An entry for each condition with a figure.
    pub conditions: Vec<PublishedCondition>,
    /// Whether they are the paper's, about which some sentences of a report are.
    pub is_paper: bool,
}

/// The figures of one condition. Units as in [`ConditionScore`](scores::ConditionScore), tokens in millions.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[expect(missing_docs, reason = "the figures are those of ConditionScore and are named like them")]
pub struct PublishedCondition {
    /// The condition as it is written.
    #[serde(deserialize_with = "condition_name")]
    pub name: String,
    /// The place in the publication; may be empty.
    #[serde(default)]
    pub source: String,
    /// Repetitions, where they are others than the configuration's.
    pub runs: Option<NonZeroU32>,
    /// Cases, where they are others than the configuration's.
    pub cases: Option<NonZeroU32>,
    #[serde(default, deserialize_with = "percentage")]
    pub sr: Option<PublishedFigure>,
    #[serde(default, deserialize_with = "share")]
    pub spl: Option<PublishedFigure>,
    #[serde(default, deserialize_with = "positive")]
    pub img: Option<PublishedFigure>,
    #[serde(default, deserialize_with = "positive")]
    pub mtok: Option<PublishedFigure>,
    #[serde(default, deserialize_with = "percentage")]
    pub follow: Option<PublishedFigure>,
    #[serde(default, deserialize_with = "percentage")]
    pub recovery: Option<PublishedFigure>,
    #[serde(default, deserialize_with = "points")]
    pub change: Option<PublishedFigure>,
    #[serde(default, deserialize_with = "positive")]
    pub retention: Option<PublishedFigure>,
    #[serde(default, deserialize_with = "percentage")]
    pub from_others: Option<PublishedFigure>,
    /// Success rates by task group: basic, multi-object, return-loops, revisit.
    #[serde(default, deserialize_with = "percentages")]
    pub groups: BTreeMap<String, PublishedFigure>,
}

/// A figure and, where it is printed, its standard deviation over runs. In a file a number, or a table with `mean` and `std`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PublishedFigure {
    /// The figure, or its mean over runs.
    pub mean: f64,
    /// The standard deviation.
    pub std: Option<f64>,
}

/// Why a file of published figures cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PublishedError {
    /// The system refused.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The text is not in the format.
    #[error("{file}: {problem}")]
    Invalid {
        /// The file.
        file: String,
        /// What is wrong, and in which line.
        problem: String,
    },
}

/// A file as it is written.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct PublishedFile {
    title: String,
    #[serde(default)]
    source: String,
    policy: String,
    #[serde(default)]
    configuration: BTreeMap<Spanned<String>, Fact>,
    #[serde(default)]
    notes: Vec<String>,
    #[serde(rename = "condition")]
    conditions: Vec<Spanned<PublishedCondition>>,
}

impl Published {
    /// Returns the figures that the paper prints.
    ///
    /// # Errors
    /// When the built-in file is invalid; a test checks that it is not.
    pub fn paper() -> Result<Self, PublishedError> {
        Ok(Self { is_paper: true, ..Self::parse("assets/published.toml", PAPER)? })
    }

    /// Reads the figures in the file `path`.
    ///
    /// # Errors
    /// When it cannot be read, or is not in the format; the message names line and field.
    pub fn read(path: &Path) -> Result<Self, PublishedError> {
        let text = durable::input::read_text(path)
            .map_err(|source| PublishedError::Read { path: path.to_owned(), source })?;
        Self::parse(&path.display().to_string(), &text)
    }

    /// The figures in `text`; `file` names it in messages.
    fn parse(file: &str, text: &str) -> Result<Self, PublishedError> {
        let invalid = |problem| PublishedError::Invalid { file: file.to_owned(), problem };
        let at = |offset: usize, problem: String| {
            let line = 1 + text.get(..offset).unwrap_or_default().matches('\n').count();
            invalid(format!("line {line}: {problem}"))
        };
        let PublishedFile { title, source, policy, configuration, notes, conditions } =
            toml::from_str(text).map_err(|error: toml::de::Error| {
                invalid(error.to_string().trim_end().to_owned())
            })?;
        if conditions.is_empty() {
            return Err(invalid("it has no [[condition]]".to_owned()));
        }
        let mut names = BTreeSet::new();
        for condition in &conditions {
            let (PublishedCondition { name, .. }, offset) =
                (condition.get_ref(), condition.span().start);
            if !names.insert(name) {
                return Err(at(offset, format!("the condition {name} is listed twice")));
            }
        }
        for (key, Fact(value)) in &configuration {
            let problem = configuration::check(key.get_ref(), value);
            problem.map_err(|problem| at(key.span().start, format!("configuration: {problem}")))?;
        }
        Ok(Self {
            title,
            source,
            policy,
            configuration: configuration
                .into_iter()
                .map(|(key, Fact(value))| (key.into_inner(), value))
                .collect(),
            notes,
            conditions: conditions.into_iter().map(Spanned::into_inner).collect(),
            is_paper: false,
        })
    }

    /// The published figures of the condition called `name`.
    pub fn of(&self, name: &str) -> Option<&PublishedCondition> {
        self.conditions.iter().find(|condition| condition.name == name)
    }

    /// A condition's own count, or that of the configuration.
    fn count(&self, own: Option<NonZeroU32>, name: &str) -> Option<u32> {
        let of_all = || self.configuration.get(name)?.parse().ok();
        own.map(NonZeroU32::get).or_else(of_all)
    }

    /// The repetitions of a condition, if they are stated.
    pub(crate) fn runs(&self, condition: &PublishedCondition) -> Option<u32> {
        self.count(condition.runs, configuration::RUNS)
    }

    /// The cases of a condition, if they are stated.
    pub(crate) fn cases(&self, condition: &PublishedCondition) -> Option<u32> {
        self.count(condition.cases, configuration::CASES)
    }
}

impl PublishedCondition {
    /// The success rate of the task group called `name`.
    pub fn group(&self, name: &str) -> Option<PublishedFigure> {
        self.groups.get(&group_key(name)).copied()
    }
}

/// The name of a task group in a file.
pub(crate) fn group_key(name: &str) -> String {
    name.replace(' ', "-")
}

/// A value of the configuration, as text.
#[derive(Debug)]
struct Fact(String);

impl<'de> Deserialize<'de> for Fact {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct FactVisitor;
        impl Visitor<'_> for FactVisitor {
            type Value = Fact;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a text or a number")
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Fact, E> {
                Ok(Fact(text.trim().to_owned()))
            }

            fn visit_i64<E: Error>(self, number: i64) -> Result<Fact, E> {
                Ok(Fact(number.to_string()))
            }

            fn visit_f64<E: Error>(self, number: f64) -> Result<Fact, E> {
                Ok(Fact(number.to_string()))
            }
        }
        deserializer.deserialize_any(FactVisitor)
    }
}

impl<'de> Deserialize<'de> for PublishedFigure {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct MeanAndDeviation {
            mean: f64,
            std: Option<f64>,
        }
        struct FigureVisitor;
        impl<'de> Visitor<'de> for FigureVisitor {
            type Value = PublishedFigure;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, or a table with `mean` and `std`")
            }

            fn visit_f64<E: Error>(self, mean: f64) -> Result<PublishedFigure, E> {
                Ok(PublishedFigure { mean, std: None })
            }

            fn visit_i64<E: Error>(self, mean: i64) -> Result<PublishedFigure, E> {
                self.visit_f64(mean as f64)
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<PublishedFigure, A::Error> {
                let MeanAndDeviation { mean, std } =
                    Deserialize::deserialize(MapAccessDeserializer::new(map))?;
                Ok(PublishedFigure { mean, std })
            }
        }
        deserializer.deserialize_any(FigureVisitor)
    }
}

fn condition_name<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let name = String::deserialize(deserializer)?;
    Condition::logged(&name).map_err(D::Error::custom)?;
    Ok(name)
}

/// The figure, if it lies from `low` to `high`.
fn within<E: Error>(
    figure: PublishedFigure,
    (low, high): (f64, f64),
) -> Result<PublishedFigure, E> {
    let PublishedFigure { mean, std } = figure;
    if !mean.is_finite() || !(low..=high).contains(&mean) {
        return Err(E::custom(format!("the figure {mean} is not from {low} to {high}")));
    }
    match std {
        Some(std) if !std.is_finite() || std < 0.0 => {
            Err(E::custom(format!("the standard deviation {std} is not 0 or more")))
        }
        _ => Ok(figure),
    }
}

const PERCENT: (f64, f64) = (0.0, 100.0);

fn percentage<'de, D: Deserializer<'de>>(d: D) -> Result<Option<PublishedFigure>, D::Error> {
    within(PublishedFigure::deserialize(d)?, PERCENT).map(Some)
}

fn percentages<'de, D: Deserializer<'de>>(
    d: D,
) -> Result<BTreeMap<String, PublishedFigure>, D::Error> {
    let figures = BTreeMap::<String, PublishedFigure>::deserialize(d)?;
    for figure in figures.values() {
        within::<D::Error>(*figure, PERCENT)?;
    }
    Ok(figures)
}

fn share<'de, D: Deserializer<'de>>(d: D) -> Result<Option<PublishedFigure>, D::Error> {
    within(PublishedFigure::deserialize(d)?, (0.0, 1.0)).map(Some)
}

fn points<'de, D: Deserializer<'de>>(d: D) -> Result<Option<PublishedFigure>, D::Error> {
    within(PublishedFigure::deserialize(d)?, (-200.0, 200.0)).map(Some)
}

fn positive<'de, D: Deserializer<'de>>(d: D) -> Result<Option<PublishedFigure>, D::Error> {
    within(PublishedFigure::deserialize(d)?, (0.0, 1e9)).map(Some)
}

#[cfg(test)]
mod tests;
