//! Groups of conditions: each is the product of the lists of one part of a suite.

use std::collections::BTreeSet;

use domain::{Arm, ExternalName, MemoryKind, Mismatch, Representation};
use serde::{Deserialize, Serialize};

use crate::{Condition, Demonstrations, Hint, Route, SegmentContent, Start, Variation};

/// A part of a run: every combination of the values it lists. `memtransfer run --help` describes each field under
/// the same name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[expect(missing_docs, reason = "each field is documented once, as a flag of `memtransfer run`")]
pub struct Group {
    /// Its name in the suite file; `None` for the only group of a suite without named groups.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    pub memory: Vec<MemoryKind>,
    pub starts: Vec<Start>,
    pub routes: Vec<Route>,
    pub demos: Vec<Demonstrations>,
    pub window: Vec<u32>,
    pub segment: Vec<SegmentContent>,
    pub hint: Vec<Hint>,
    #[serde(default = "no_mismatch", skip_serializing_if = "is_no_mismatch")]
    pub mismatch: Vec<Mismatch>,
    #[serde(default = "frozen", skip_serializing_if = "is_frozen")]
    pub arms: Vec<Arm>,
    pub runs: u32,
}

impl Group {
    /// The number of combinations of its lists.
    pub(super) fn product(&self) -> usize {
        [
            self.memory.len(),
            self.starts.len(),
            self.routes.len(),
            self.demos.len(),
            self.window.len(),
            self.segment.len(),
            self.hint.len(),
            self.mismatch.len(),
            self.arms.len(),
        ]
        .into_iter()
        .fold(1, usize::saturating_mul)
    }

    /// The conditions of the group, each once, in the order of the lists. `learning`: the external memories that learn.
    fn conditions(&self, learning: &BTreeSet<ExternalName>) -> Vec<Condition> {
        let has_arm = |memory, arm| arm != Arm::Learning || learns(memory, learning);
        let mut conditions: Vec<Condition> = Vec::new();
        for &memory in &self.memory {
            for &start in &self.starts {
                for &route in &self.routes {
                    for &demonstrations in &self.demos {
                        for variation in self.variations() {
                            let condition =
                                Condition::new(memory, start, route, demonstrations, variation);
                            let Some(condition) = condition else { continue };
                            for (&mismatch, &arm) in self.mismatches_and_arms() {
                                let condition = condition.with_mismatch(mismatch).with_arm(arm);
                                if has_arm(memory, arm) && !conditions.contains(&condition) {
                                    conditions.push(condition);
                                }
                            }
                        }
                    }
                }
            }
        }
        conditions
    }

    fn mismatches_and_arms(&self) -> impl Iterator<Item = (&Mismatch, &Arm)> {
        self.mismatch.iter().flat_map(|mismatch| self.arms.iter().map(move |arm| (mismatch, arm)))
    }

    fn variations(&self) -> Vec<Variation> {
        let mut variations = Vec::new();
        for &window in &self.window {
            for &segment in &self.segment {
                let hints = self.hint.iter();
                variations.extend(hints.map(|&hint| Variation { window, segment, hint }));
            }
        }
        variations
    }
}

fn no_mismatch() -> Vec<Mismatch> {
    vec![Mismatch::None]
}

fn is_no_mismatch(mismatch: &[Mismatch]) -> bool {
    *mismatch == [Mismatch::None]
}

fn frozen() -> Vec<Arm> {
    vec![Arm::Frozen]
}

fn is_frozen(arms: &[Arm]) -> bool {
    *arms == [Arm::Frozen]
}

/// Whether `memory` can learn: of the built-in ones only `adaptive` does, of the others those of `learning`.
fn learns(memory: MemoryKind, learning: &BTreeSet<ExternalName>) -> bool {
    match memory {
        MemoryKind::BuiltIn(one) => one == Representation::Adaptive,
        MemoryKind::External(name) => learning.contains(&name),
    }
}

/// The conditions of all groups, each once, with its repetitions: the largest number of the groups that have it.
pub(super) fn union(groups: &[Group], learning: &BTreeSet<ExternalName>) -> Vec<(Condition, u32)> {
    let mut union: Vec<(Condition, u32)> = Vec::new();
    for group in groups {
        for condition in group.conditions(learning) {
            match union.iter_mut().find(|(there, _)| *there == condition) {
                Some((_, runs)) => *runs = group.runs.max(*runs),
                None => union.push((condition, group.runs)),
            }
        }
    }
    union
}

#[cfg(test)]
mod tests {

    use super::*;
    use crate::settings::RunSettings;

    #[test]
    fn settings_that_cannot_be_counted_are_refused() {
        let check = |change: &dyn Fn(&mut RunSettings)| {
            let mut settings = settings();
            settings.groups = vec![group()];
            change(&mut settings);
            settings.check_size().err().unwrap_or_default()
        };
        assert_eq!(check(&|_| {}), "");
        let wide = |settings: &mut RunSettings| {
            settings.groups[0].window = (0..2000).collect();
            settings.groups[0].demos = vec![Demonstrations::ORIGINAL; 2000];
        };
        assert!(check(&wide).ends_with("conditions, and at most 10000 are possible"));
        let said = check(&|settings| settings.groups[0].runs = u32::MAX);
        assert_eq!(said, "runs is 4294967295, and at most 1000000 is possible");
        let said = check(&|settings| settings.hits = 20_000);
        assert_eq!(said, "hits is 20000, and at most 10000 is possible");
    }

    fn settings() -> RunSettings {
        let settings = serde_json::json!({
            "suite": "quick", "policy": "grounded", "group": [], "cases": ["all"], "seed": 1,
            "max-steps": 200, "horizon": 6, "keyframes": 40, "documents": "extractive",
            "frame-size": 448, "frames": "rendered", "encoder": "dinov2-s14",
            "out": "runs/quick-grounded", "lanes": 16, "spin-us": 0, "step-timeout": 120,
            "start-timeout": 300,
        });
        serde_json::from_value(settings).unwrap()
    }

    fn group() -> Group {
        Group {
            name: None,
            memory: vec![Representation::Working.into(), Representation::Episodic.into()],
            starts: Start::ALL.to_vec(),
            routes: Route::ALL.to_vec(),
            demos: vec![Demonstrations::ORIGINAL, Demonstrations::ALL],
            window: vec![6],
            segment: vec![SegmentContent::Actions],
            hint: vec![Hint::On],
            mismatch: no_mismatch(),
            arms: frozen(),
            runs: 3,
        }
    }

    fn shown(conditions: &[(Condition, u32)]) -> Vec<String> {
        conditions.iter().map(|(condition, runs)| format!("{condition} x{runs}")).collect()
    }

    #[test]
    fn a_group_leaves_out_impossible_and_equivalent_conditions() {
        assert_eq!(
            shown(&union(&[group()], &BTreeSet::new())),
            [
                "working/original/unchanged/none x3",
                "working/new/unchanged/none x3",
                "working/new/blocked/none x3",
                "episodic/original/unchanged/original x3",
                "episodic/original/unchanged/4 x3",
                "episodic/new/unchanged/original x3",
                "episodic/new/unchanged/4 x3",
                "episodic/new/blocked/original x3",
                "episodic/new/blocked/4 x3",
            ]
        );
        let varied = Group {
            starts: vec![Start::Original],
            window: vec![6, 20],
            segment: SegmentContent::ALL.to_vec(),
            hint: Hint::ALL.to_vec(),
            ..group()
        };
        assert_eq!(
            shown(&union(&[varied], &BTreeSet::new())),
            [
                "working/original/unchanged/none x3",
                "working/original/unchanged/none/h20 x3",
                "episodic/original/unchanged/original x3",
                "episodic/original/unchanged/original/no-hint x3",
                "episodic/original/unchanged/original/images x3",
                "episodic/original/unchanged/original/images/no-hint x3",
                "episodic/original/unchanged/original/h20 x3",
                "episodic/original/unchanged/original/h20/no-hint x3",
                "episodic/original/unchanged/original/h20/images x3",
                "episodic/original/unchanged/original/h20/images/no-hint x3",
                "episodic/original/unchanged/4 x3",
                "episodic/original/unchanged/4/images x3",
                "episodic/original/unchanged/4/h20 x3",
                "episodic/original/unchanged/4/h20/images x3",
            ]
        );
    }

    #[test]
    fn working_memory_has_one_arm_and_only_memories_that_learn_have_learning() {
        let group = Group {
            memory: ["working", "episodic", "mine", "fixed"]
                .map(|name| name.parse().unwrap())
                .to_vec(),
            starts: vec![Start::New],
            routes: vec![Route::Unchanged],
            demos: vec![Demonstrations::ORIGINAL],
            arms: Arm::ALL.to_vec(),
            ..group()
        };
        assert_eq!(
            shown(&union(&[group], &["mine".parse().unwrap()].into())),
            [
                "working/new/unchanged/none x3",
                "episodic/new/unchanged/original x3",
                "episodic/new/unchanged/original/oracle x3",
                "episodic/new/unchanged/original/wrong x3",
                "mine/new/unchanged/original x3",
                "mine/new/unchanged/original/learning x3",
                "mine/new/unchanged/original/oracle x3",
                "mine/new/unchanged/original/wrong x3",
                "fixed/new/unchanged/original x3",
                "fixed/new/unchanged/original/oracle x3",
                "fixed/new/unchanged/original/wrong x3",
            ]
        );
    }

    #[test]
    fn each_mismatch_is_a_condition_of_its_own() {
        let group = Group {
            memory: vec![Representation::Working.into()],
            starts: vec![Start::New],
            routes: vec![Route::Unchanged],
            mismatch: vec![Mismatch::None, Mismatch::Light, Mismatch::CameraHeight],
            ..group()
        };
        assert_eq!(
            shown(&union(&[group], &BTreeSet::new())),
            [
                "working/new/unchanged/none x3",
                "working/new/unchanged/none/light x3",
                "working/new/unchanged/none/camera-height x3",
            ]
        );
    }

    #[test]
    fn a_condition_of_two_groups_has_the_larger_number_of_runs() {
        let small = Group {
            memory: vec![Representation::Working.into()],
            starts: vec![Start::New],
            routes: vec![Route::Unchanged],
            runs: 5,
            ..group()
        };
        let few = Group { runs: 1, ..small.clone() };
        let fewer = Group { memory: vec![Representation::Summary.into()], ..few.clone() };
        assert_eq!(
            shown(&union(&[few, small, fewer], &BTreeSet::new())),
            [
                "working/new/unchanged/none x5",
                "summary/new/unchanged/original x1",
                "summary/new/unchanged/4 x1",
            ]
        );
    }
}
