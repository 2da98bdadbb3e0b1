//! Conditions of episodes (memory, start, route, demonstrations, variations of the prompt, and mismatch), the names of episodes, and
//! the settings of a run as its manifest records them.
//!
//! Which conditions a run has is in its [`settings`]; where those come from is the crate `settings`'s.

pub mod cost;
pub mod key;
pub mod settings;
mod variation;

pub use domain::{Demonstrations, Mismatch, Route, Start, UnknownDemonstrations};
pub use variation::{
    Hint, MAX_WINDOW, SegmentContent, Variation, is_default, is_standard_window, standard_window,
};

use std::fmt;
use std::str::FromStr;

use domain::names::{UnknownName, named};
use domain::representation::{BuiltFrom, RepresentationInfo, Trajectories};
use domain::{Arm, MemoryKind, Representation};
use serde::{Deserialize, Serialize};

named! {
    /// The kind of policy.
    PolicyKind, "policy" {
        /// A scripted stand-in that looks at the pixels and at the recall it is given.
        Grounded = "grounded",
        /// A scripted stand-in for any world that does what the expert did.
        Imitate = "imitate",
        /// A model behind an OpenAI-compatible endpoint.
        Openai = "openai",
        /// A user's own program, on the wire.
        External = "external",
        /// Chooses every action at random, seeded.
        Random = "random",
        /// Replays the reference trajectory: privileged, the upper bound of the scale.
        Expert = "expert",
    }

    /// What frames show: the true view, or a control that proves that results come from pixels. What memory supplies is
    /// replaced by the last one only.
    Frames, "kind of frames" {
        /// The true view.
        Rendered = "rendered",
        /// Uniform grey.
        Blank = "blank",
        /// The view of another pose.
        Swapped = "swapped",
        /// Uniform grey, in the views that memory supplies as well; and memory supplies no texts.
        BlankAll = "blank-all",
    }
}

/// The representation that a word names.
///
/// # Errors
/// When it names none; the message names the nearest.
pub fn representation(word: &str) -> Result<Representation, UnknownName> {
    let unknown = |_| {
        UnknownName::new("memory", word, Representation::ALL.iter().map(|member| member.name()))
    };
    word.parse().map_err(unknown)
}

impl PolicyKind {
    /// Whether it runs in a process of its own, on observations and memory. The expert does not.
    pub const fn has_process(self) -> bool {
        match self {
            Self::Grounded | Self::Imitate | Self::Openai | Self::External | Self::Random => true,
            Self::Expert => false,
        }
    }

    /// Whether it reads the plates of the warehouse, so that its run has plates where nothing else is said.
    pub const fn needs_plates(self) -> bool {
        match self {
            Self::Grounded => true,
            Self::Imitate | Self::Openai | Self::External | Self::Random | Self::Expert => false,
        }
    }
}

/// One cell of a table of results. Written `memory/start/route/demonstrations`, followed by the deviations from the
/// standard [`Variation`], by the mismatch where there is one, and by the arm where it is not `frozen`:
/// `working/original/unchanged/none/h20`, `episodic/new/unchanged/original/light`,
/// `episodic/new/unchanged/original/oracle`.
///
/// Always in its normal form, see [`Condition::new`] and [`Condition::with_arm`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Condition {
    /// The memory.
    pub memory: MemoryKind,
    /// The start.
    pub start: Start,
    /// The route.
    pub route: Route,
    /// The demonstrations.
    pub demonstrations: Demonstrations,
    /// The changes to the prompt.
    #[serde(flatten)]
    pub variation: Variation,
    /// What the episode differs in from the demonstrations, beside start and route.
    #[serde(skip_serializing_if = "is_default", default)]
    pub mismatch: Mismatch,
    /// What the memory is built from, and whether it changes. Only streams have the arm `learning`.
    #[serde(skip_serializing_if = "is_default", default)]
    pub arm: Arm,
}

impl Condition {
    /// Whether all of `words`, which are separated by `,` or `/`, are words of its name, or its arm: `episodic,new,frozen`.
    pub fn has_words(&self, words: &str) -> bool {
        let name = self.to_string();
        // The arm `frozen` has no word in the name.
        let own: Vec<&str> = name.split('/').chain([self.arm.word()]).collect();
        words.split([',', '/']).all(|word| own.contains(&word.trim()))
    }

    /// Returns the condition, in the arm `frozen` and without a mismatch, in its normal form: settings without effect have their standard values, so that two
    /// conditions differ only if their episodes can. `None` if there is no such condition.
    ///
    /// - A memory that needs no demonstration has none; the others need at least one. Sets of [control
    ///   arms](Demonstrations::is_control) belong to no condition by themselves.
    /// - A blocked route is defined for the new start only (specification, section 4).
    /// - The content of a segment varies only for memories that retrieve one.
    /// - The hint applies where it is true and of use: at the original start, with the original demonstration alone,
    ///   for a memory that supplies trajectories, or may do so.
    pub fn new(
        memory: impl Into<MemoryKind>,
        start: Start,
        route: Route,
        demonstrations: Demonstrations,
        variation: Variation,
    ) -> Option<Self> {
        let memory = memory.into();
        let demonstrations =
            if memory.uses_demonstrations() { demonstrations } else { Demonstrations::NONE };
        let exists = (start, route) != (Start::Original, Route::Blocked)
            && !demonstrations.is_control()
            && (memory.uses_demonstrations() != (demonstrations == Demonstrations::NONE));
        let (mismatch, arm) = (Mismatch::None, Arm::Frozen);
        let mut condition = Self { memory, start, route, demonstrations, variation, mismatch, arm };
        let varies = |info: RepresentationInfo| info.trajectories == Trajectories::Segment;
        if !memory.describe().is_some_and(varies) {
            condition.variation.segment = SegmentContent::default();
        }
        if !condition.can_be_hinted() {
            condition.variation.hint = Hint::default();
        }
        exists.then_some(condition)
    }

    /// The condition in which it has working memory alone; `None` where there is none.
    pub fn without_memory(&self) -> Option<Self> {
        let Self { start, route, variation, mismatch, .. } = *self;
        let working = Representation::Working;
        let condition = Self::new(working, start, route, Demonstrations::NONE, variation);
        condition.map(|condition| condition.with_mismatch(mismatch))
    }

    /// The condition with this mismatch.
    pub fn with_mismatch(self, mismatch: Mismatch) -> Self {
        Self { mismatch, ..self }
    }

    /// The condition in `arm`, in its normal form.
    ///
    /// - A memory that needs no demonstration is always `frozen`: no arm changes it.
    /// - The arm `oracle` has the test reference in place of any set, and is written with `original`. From the original start the
    ///   reference is the original demonstration: that is the arm `frozen` with it.
    /// - The arm `wrong` has one wrong demonstration in place of one, and is written with `original`; two in place of more, and is
    ///   written with `4`. What is consolidated over all cases has one of each case.
    /// - A wrong demonstration does not start where the episode does: no hint says so.
    ///
    /// [`Self::control_set`] has what that means for the memory.
    pub fn with_arm(self, arm: Arm) -> Self {
        let frozen = Self { arm: Arm::Frozen, ..self };
        let demonstrations = match arm {
            _ if !self.memory.uses_demonstrations() => return frozen,
            Arm::Frozen | Arm::Learning => self.demonstrations,
            Arm::Oracle => Demonstrations::ORIGINAL,
            Arm::Wrong if self.is_of_all_cases() || self.demonstrations.count() == 1 => {
                Demonstrations::ORIGINAL
            }
            Arm::Wrong => Demonstrations::ALL,
        };
        let is_original = self.start == Start::Original && arm == Arm::Oracle;
        let arm = if is_original { Arm::Frozen } else { arm };
        let mut condition = Self { demonstrations, arm, ..self };
        if !condition.can_be_hinted() {
            condition.variation.hint = Hint::default();
        }
        condition
    }

    /// The demonstrations that the memory holds outside of streams in place of those of the condition, in a control arm.
    ///
    /// - `oracle`: the test reference of the condition's route alone.
    /// - `wrong`: irrelevant histories of the case; for what is consolidated over all cases, as no history of this warehouse is
    ///   wrong for all of them, the demonstrations of another warehouse.
    pub fn control_set(&self) -> Option<Demonstrations> {
        match (self.arm, self.route) {
            (Arm::Frozen | Arm::Learning, _) => None,
            (Arm::Oracle, Route::Unchanged) => Some(Demonstrations::NEW_REFERENCE),
            (Arm::Oracle, Route::Blocked) => Some(Demonstrations::BLOCKED_REFERENCE),
            (Arm::Wrong, _) if self.is_of_all_cases() => Some(Demonstrations::ELSEWHERE),
            (Arm::Wrong, _) if self.demonstrations.count() == 1 => Some(Demonstrations::WRONG_1),
            (Arm::Wrong, _) => Some(Demonstrations::WRONG_2),
        }
    }

    /// Whether what the memory supplies is consolidated over all cases.
    fn is_of_all_cases(&self) -> bool {
        self.memory.describe().is_some_and(|info| info.built_from == BuiltFrom::AllCases)
    }

    /// Its deviations from the standard, as they are written in its name: `/h20/light`.
    pub fn deviations(&self) -> String {
        let variation = self.variation.to_string();
        match self.mismatch {
            Mismatch::None => variation,
            mismatch => format!("{variation}/{mismatch}"),
        }
    }

    /// Whether the demonstration starts where the episode does, and is supplied to the policy.
    fn can_be_hinted(&self) -> bool {
        self.start == Start::Original
            && self.arm != Arm::Wrong
            && self.demonstrations == Demonstrations::ORIGINAL
            && self.memory.supplies_trajectories()
    }

    /// Whether the prompt states that the demonstration starts where the episode does.
    pub fn is_hinted(&self) -> bool {
        self.can_be_hinted() && self.variation.hint == Hint::On
    }
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { memory, start, route, demonstrations, arm, .. } = self;
        write!(f, "{memory}/{start}/{route}/{demonstrations}{}", self.deviations())?;
        if is_default(arm) { Ok(()) } else { write!(f, "/{}", arm.word()) }
    }
}

/// A text that is not a condition.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BadCondition {
    /// A part has an unknown name.
    #[error(transparent)]
    Name(#[from] UnknownName),
    /// The demonstrations are not valid.
    #[error(transparent)]
    Demonstrations(#[from] UnknownDemonstrations),
    /// A part is missing, or there is one too many.
    #[error(
        "`{0}` is not a condition: write memory/start/route/demonstrations, then any deviation from the \
         standard (/h20, /images, /no-hint), the mismatch (/light) and the arm (/learning, /oracle, /wrong)"
    )]
    Parts(String),
    /// Not in its normal form, or there is no such condition.
    #[error("there is no condition `{given}`{}", normal.map_or_else(
        String::new, |normal| format!("; its episodes are those of `{normal}`")
    ))]
    NotNormal {
        /// The text.
        given: String,
        /// The normal form of its condition, if there is one.
        normal: Option<Condition>,
    },
}

impl FromStr for Condition {
    type Err = BadCondition;

    /// Of a built-in memory: see [`Condition::logged`] for others.
    fn from_str(text: &str) -> Result<Self, BadCondition> {
        Self::read(text, |word| representation(word).map(MemoryKind::BuiltIn))
    }
}

impl Condition {
    /// Reads a condition from a log, where any well-formed name of a memory is one.
    ///
    /// # Errors
    /// When the text is not a condition.
    pub fn logged(text: &str) -> Result<Self, BadCondition> {
        Self::read(text, |word| word.parse().or_else(|_| representation(word).map(Into::into)))
    }

    fn read(
        text: &str,
        memory: impl Fn(&str) -> Result<MemoryKind, UnknownName>,
    ) -> Result<Self, BadCondition> {
        let bad = || BadCondition::Parts(text.to_owned());
        let mut parts = text.split('/');
        let mut next = || parts.next().ok_or_else(bad);
        let memory = memory(next()?)?;
        let (start, route) = (next()?.parse()?, next()?.parse()?);
        let demonstrations = next()?.parse()?;
        let (mut variation, mut mismatch, mut arm) = Default::default();
        for part in parts {
            if let Some(found) = Arm::ALL.iter().find(|arm| arm.word() == part) {
                arm = *found;
            } else if let Ok(found) = part.parse() {
                mismatch = found;
            } else if !Variation::read(&mut variation, part) {
                return Err(bad());
            }
        }
        let normal = Self::new(memory, start, route, demonstrations, variation);
        let normal = normal.map(|condition| condition.with_mismatch(mismatch).with_arm(arm));
        match normal {
            Some(condition) if condition.to_string() == text => Ok(condition),
            _ => Err(BadCondition::NotNormal { given: text.to_owned(), normal }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_condition_is_found_by_words_and_by_its_arm() {
        let frozen: Condition = "episodic/new/unchanged/original".parse().unwrap();
        let learning = frozen.with_arm(Arm::Learning);
        for (words, found) in [
            ("episodic,new", [true, true]),
            ("episodic,frozen", [true, false]),
            ("learning", [false, true]),
        ] {
            assert_eq!([frozen, learning].map(|one| one.has_words(words)), found, "{words}");
        }
    }

    #[test]
    fn a_condition_is_reduced_to_its_normal_form() {
        let all = Variation { window: 20, segment: SegmentContent::Images, hint: Hint::Off };
        let written = |memory, start, route, demonstrations: &str| {
            let demonstrations = demonstrations.parse().unwrap();
            let condition = Condition::new(memory, start, route, demonstrations, all);
            condition.map_or("none".to_owned(), |condition| {
                assert_eq!(condition.to_string().parse(), Ok(condition));
                let json = serde_json::to_string(&condition).unwrap();
                assert_eq!(serde_json::from_str::<Condition>(&json).unwrap(), condition);
                condition.to_string()
            })
        };
        use Representation::{Episodic, FullContext, Summary, Working};
        use Route::{Blocked, Unchanged};
        for (found, expected) in [
            (
                written(Working, Start::Original, Unchanged, "4"),
                "working/original/unchanged/none/h20",
            ),
            (
                written(Episodic, Start::Original, Unchanged, "original"),
                "episodic/original/unchanged/original/h20/images/no-hint",
            ),
            (
                written(Episodic, Start::Original, Unchanged, "nearby"),
                "episodic/original/unchanged/nearby/h20/images",
            ),
            (
                written(Episodic, Start::New, Blocked, "original"),
                "episodic/new/blocked/original/h20/images",
            ),
            (
                written(FullContext, Start::Original, Unchanged, "original"),
                "full-context/original/unchanged/original/h20/no-hint",
            ),
            (
                written(Summary, Start::Original, Unchanged, "original"),
                "summary/original/unchanged/original/h20",
            ),
            (written(Episodic, Start::Original, Blocked, "4"), "none"),
            (written(Episodic, Start::New, Unchanged, "none"), "none"),
        ] {
            assert_eq!(found, expected);
        }
        let standard = Condition::new(
            Episodic,
            Start::Original,
            Unchanged,
            Demonstrations::ORIGINAL,
            Variation::STANDARD,
        );
        let json = serde_json::to_value(standard.unwrap()).unwrap();
        assert_eq!(json.as_object().unwrap().len(), 4, "the standard is left out: {json}");
    }

    /// Conditions in control arms, with what their memories hold.
    #[test]
    fn arms_that_hold_the_same_are_one_condition() {
        let in_arm = |condition: &str, arm: Arm| {
            let condition: Condition = Condition::logged(condition).unwrap();
            let normal = condition.with_arm(arm);
            assert_eq!(Condition::logged(&normal.to_string()), Ok(normal), "it is its normal form");
            assert_eq!(normal.with_arm(normal.arm), normal);
            let held = normal.control_set().map_or("as named".to_owned(), |set| set.to_string());
            format!("{normal}: {held}")
        };
        for (condition, arm, expected) in [
            (
                "episodic/new/unchanged/4",
                Arm::Oracle,
                "episodic/new/unchanged/original/oracle: new-reference",
            ),
            (
                "episodic/new/unchanged/original",
                Arm::Oracle,
                "episodic/new/unchanged/original/oracle: new-reference",
            ),
            (
                "episodic/new/blocked/4",
                Arm::Oracle,
                "episodic/new/blocked/original/oracle: blocked-reference",
            ),
            (
                "summary/new/blocked/4",
                Arm::Oracle,
                "summary/new/blocked/original/oracle: blocked-reference",
            ),
            (
                "episodic/original/unchanged/distant",
                Arm::Oracle,
                "episodic/original/unchanged/original: as named",
            ),
            (
                "episodic/original/unchanged/original/no-hint",
                Arm::Oracle,
                "episodic/original/unchanged/original/no-hint: as named",
            ),
            (
                "mine/new/unchanged/bank-16",
                Arm::Oracle,
                "mine/new/unchanged/original/oracle: new-reference",
            ),
            ("working/new/unchanged/none", Arm::Oracle, "working/new/unchanged/none: as named"),
            ("working/new/unchanged/none", Arm::Wrong, "working/new/unchanged/none: as named"),
            ("episodic/new/unchanged/4", Arm::Wrong, "episodic/new/unchanged/4/wrong: wrong-2"),
            (
                "episodic/new/unchanged/confusable",
                Arm::Wrong,
                "episodic/new/unchanged/4/wrong: wrong-2",
            ),
            (
                "episodic/new/unchanged/bank-1",
                Arm::Wrong,
                "episodic/new/unchanged/original/wrong: wrong-1",
            ),
            (
                "episodic/original/unchanged/original/no-hint",
                Arm::Wrong,
                "episodic/original/unchanged/original/wrong: wrong-1",
            ),
            (
                "summary/new/unchanged/4",
                Arm::Wrong,
                "summary/new/unchanged/original/wrong: elsewhere",
            ),
            (
                "summary/new/unchanged/elsewhere",
                Arm::Wrong,
                "summary/new/unchanged/original/wrong: elsewhere",
            ),
            ("mine/new/blocked/4", Arm::Wrong, "mine/new/blocked/4/wrong: wrong-2"),
        ] {
            assert_eq!(in_arm(condition, arm), expected);
        }
        let error = "episodic/new/unchanged/4/oracle".parse::<Condition>().unwrap_err().to_string();
        insta::assert_snapshot!(error, @"there is no condition `episodic/new/unchanged/4/oracle`; its episodes are those of `episodic/new/unchanged/original/oracle`");
        let control = "episodic/new/unchanged/new-reference".parse::<Condition>();
        assert!(control.is_err(), "only an arm holds it");
        let wrong: Condition = "episodic/original/unchanged/original/wrong".parse().unwrap();
        assert!(!wrong.is_hinted() && wrong.with_arm(Arm::Oracle).is_hinted());
    }

    #[test]
    fn a_mismatch_is_a_part_of_the_name_before_the_arm() {
        let standard: Condition = "episodic/new/unchanged/original/h20".parse().unwrap();
        for &mismatch in Mismatch::ALL {
            let condition = standard.with_mismatch(mismatch);
            let text = condition.to_string();
            assert_eq!(text.parse(), Ok(condition));
            assert_eq!(text == standard.to_string(), mismatch == Mismatch::None, "{text}");
            let json = serde_json::to_string(&condition).unwrap();
            assert_eq!(json.contains("mismatch"), mismatch != Mismatch::None, "{json}");
            assert_eq!(serde_json::from_str::<Condition>(&json).unwrap(), condition);
        }
        let light = standard.with_mismatch(Mismatch::Light);
        assert_eq!(light.to_string(), "episodic/new/unchanged/original/h20/light");
        assert!(light.has_words("episodic,light") && !standard.has_words("light"));
        let oracle = light.with_arm(Arm::Oracle).to_string();
        assert_eq!(oracle, "episodic/new/unchanged/original/h20/light/oracle");
        let error = |text: &str| text.parse::<Condition>().unwrap_err().to_string();
        insta::assert_snapshot!(error("working/new/unchanged/none/none"), @"there is no condition `working/new/unchanged/none/none`; its episodes are those of `working/new/unchanged/none`");
    }

    #[test]
    fn an_external_memory_is_known_by_name_in_a_log_only() {
        let memory: MemoryKind = "top-3".parse().unwrap();
        let all = Variation { window: 6, segment: SegmentContent::Images, hint: Hint::Off };
        let demonstrations = Demonstrations::ORIGINAL;
        let condition =
            Condition::new(memory, Start::Original, Route::Unchanged, demonstrations, all).unwrap();
        let text = condition.to_string();
        assert_eq!(text, "top-3/original/unchanged/original/no-hint");
        assert_eq!(Condition::logged(&text), Ok(condition));
        let none = Demonstrations::NONE;
        assert_eq!(Condition::new(memory, Start::New, Route::Unchanged, none, all), None);
        insta::assert_snapshot!(text.parse::<Condition>().unwrap_err(), @"unknown memory `top-3` (known: working, full-context, summary, semantic, hybrid, episodic, adaptive)");
        assert!(Condition::logged("Top 3/new/unchanged/4").is_err());
    }

    #[test]
    fn errors_name_the_condition_that_was_probably_meant() {
        let error = |text: &str| text.parse::<Condition>().unwrap_err().to_string();
        insta::assert_snapshot!(error("episodic/new/unchanged"), @"`episodic/new/unchanged` is not a condition: write memory/start/route/demonstrations, then any deviation from the standard (/h20, /images, /no-hint), the mismatch (/light) and the arm (/learning, /oracle, /wrong)");
        insta::assert_snapshot!(error("working/new/unchanged/none/h200"), @"`working/new/unchanged/none/h200` is not a condition: write memory/start/route/demonstrations, then any deviation from the standard (/h20, /images, /no-hint), the mismatch (/light) and the arm (/learning, /oracle, /wrong)");
        insta::assert_snapshot!(error("working/new/unchanged/4/h6"), @"there is no condition `working/new/unchanged/4/h6`; its episodes are those of `working/new/unchanged/none`");
        insta::assert_snapshot!(error("episodic/original/blocked/4"), @"there is no condition `episodic/original/blocked/4`");
        insta::assert_snapshot!(error("episodic/newer/blocked/4"), @"unknown start `newer`: did you mean `new`? (known: original, new)");
    }
}
