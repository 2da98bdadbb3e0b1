//! The figures that the paper prints, from `assets/published.toml`.

use std::collections::BTreeMap;

use serde::Deserialize;

const PUBLISHED: &str = include_str!("../../../assets/published.toml");

/// The figures that the paper prints.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// The policy that the figures are of.
    pub policy: String,
    /// An entry for each condition with a figure.
    #[serde(rename = "condition")]
    pub conditions: Vec<PublishedCondition>,
}

/// The figures of one condition. Units as in [`ConditionScore`](scores::ConditionScore), tokens in millions.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[expect(missing_docs, reason = "the figures are those of ConditionScore and are named like them")]
pub struct PublishedCondition {
    /// The condition as it is written.
    pub name: String,
    /// The place in the paper.
    pub source: String,
    pub sr: Option<PublishedSpread>,
    pub spl: Option<f64>,
    pub img: Option<f64>,
    pub mtok: Option<f64>,
    pub follow: Option<PublishedSpread>,
    pub recovery: Option<PublishedSpread>,
    pub change: Option<f64>,
    pub retention: Option<f64>,
    pub from_others: Option<PublishedSpread>,
    /// Success rates by task group: basic, multi-object, return-loops, revisit.
    #[serde(default)]
    pub groups: BTreeMap<String, f64>,
}

/// Mean and, where it is printed, standard deviation over runs.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedSpread {
    /// The mean.
    pub mean: f64,
    /// The standard deviation.
    pub std: Option<f64>,
}

impl Published {
    /// Returns the built-in figures.
    ///
    /// # Errors
    /// When the built-in file is invalid; a test checks that it is not.
    pub fn load() -> Result<Self, toml::de::Error> {
        toml::from_str(PUBLISHED)
    }

    /// The published figures of the condition called `name`.
    pub fn of(&self, name: &str) -> Option<&PublishedCondition> {
        self.conditions.iter().find(|condition| condition.name == name)
    }
}

impl PublishedCondition {
    /// The success rate of the task group called `name`.
    pub fn group(&self, name: &str) -> Option<f64> {
        self.groups.get(&name.replace(' ', "-")).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_of_the_paper_is_listed_once() {
        let published = Published::load().unwrap();
        let mut names: Vec<&str> = published.conditions.iter().map(|c| c.name.as_str()).collect();
        let count = |figure: fn(&PublishedCondition) -> bool| {
            published.conditions.iter().filter(|condition| figure(condition)).count()
        };
        // tab:main has 6 + 6 + 4 + 5 rates (working once for one and four), tab:transfer 15 more, Design Choices 3.
        assert_eq!(count(|c| c.sr.is_some()), 6 + 6 + 4 + 5 + 15 + 3);
        assert_eq!(count(|c| c.spl.is_some()), 6 + 6 + 4 + 5 + 15);
        // Mtok: working, five with one demonstration, four with four.
        assert_eq!(count(|c| c.mtok.is_some()), 10);
        // tab:rq2 has five rows; tab:tasks five rows, unchanged and blocked.
        for figure in [
            |c: &PublishedCondition| c.follow.is_some(),
            |c: &PublishedCondition| c.recovery.is_some(),
            |c: &PublishedCondition| c.change.is_some(),
            |c: &PublishedCondition| c.retention.is_some(),
        ] {
            assert_eq!(count(figure), 5);
        }
        assert_eq!(count(|c| c.groups.len() == 4), 10);
        assert_eq!(count(|c| !c.groups.is_empty()), 10);
        assert_eq!(count(|c| c.from_others.is_some()), 2);
        names.sort();
        names.dedup();
        assert_eq!(names.len(), published.conditions.len());
    }

    #[test]
    fn derived_figures_follow_from_the_printed_rates() {
        let published = Published::load().unwrap();
        let rate = |name: &str| published.of(name).unwrap().sr.unwrap().mean;
        let baseline = rate("working/new/blocked/none") - rate("working/new/unchanged/none");
        for blocked in published.conditions.iter().filter(|c| c.change.is_some()) {
            let (after, before) =
                (rate(&blocked.name), rate(&blocked.name.replace("blocked", "unchanged")));
            // The paper rounds both.
            assert!((blocked.change.unwrap() - (after - before - baseline)).abs() < 0.11);
            assert!((blocked.retention.unwrap() - after / before).abs() < 0.0051);
        }
    }
}
