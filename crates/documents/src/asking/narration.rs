//! A demonstration in words and views, for a prompt.

use std::fmt::Write;

use case_book::{Demonstration, WorldDeclaration, keyframes};

use super::room::PartSize;

/// A demonstration in the words of its world, with the places of its views.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Narration {
    /// Text and views, in reading order.
    pub parts: Vec<NarrationPart>,
}

/// A part of a [`Narration`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NarrationPart {
    /// Whole lines.
    Text(String),
    /// The view with this number in the book.
    View(u32),
}

/// The characters around an image in a prompt, at most.
const AROUND_IMAGE: usize = "Image 50:\n\n".len();

/// Narrates `demonstrations` in the words of `world`, numbered from 1, each with at most `views` views: its keyframes.
pub fn narrations(
    world: &WorldDeclaration,
    demonstrations: &[&Demonstration],
    views: usize,
) -> Vec<Narration> {
    (1..).zip(demonstrations).map(|(number, of)| narrate(number, world, of, views)).collect()
}

/// Narrates demonstration `number`. Equal actions in a row become one line, unless something happens among them.
fn narrate(number: usize, world: &WorldDeclaration, of: &Demonstration, views: usize) -> Narration {
    let Demonstration { states, feedback, actions, .. } = of;
    let stages = of.stages();
    let is_turn = |step: usize| actions.get(step).is_some_and(|action| world.is_turn(*action));
    let shown = keyframes(&stages, views, is_turn);
    let is_shown = |step: usize| shown.binary_search(&step).is_ok();
    // What the expert was told after an action that left the state as it was.
    let effect = |step: usize| match states[step] == states[step - 1] {
        true => Some(world.feedback_sentence(feedback[step])),
        false => None,
    };
    let mut narration = Narration { parts: Vec::new() };
    let mut text = format!("## Demonstration {number}\nTask: \"{}\"\n", of.instruction);
    // Writing to a string cannot fail, here and below.
    let _ = writeln!(text, "- start: {}", world.sentence(&states[0]));
    let mut times = 0;
    for step in 0..states.len() {
        if step > 0 {
            let completes = stages[step] > stages[step - 1];
            let is_repeated = step + 1 < states.len()
                && actions[step] == actions[step - 1]
                && effect(step + 1) == effect(step);
            times += 1;
            if is_repeated && !completes && !is_shown(step) {
                continue;
            }
            let words = world.action_words(actions[step - 1]);
            let repeated = if times > 1 { format!(" {times}") } else { String::new() };
            times = 0;
            let result = match effect(step) {
                Some(told) => format!("the state stays the same. {told}"),
                None => world.sentence(&states[step]),
            };
            let _ = write!(text, "- {words}{repeated}: {result}");
            if completes {
                let _ = write!(
                    text,
                    " Sub-goal {} of {} is completed.",
                    stages[step],
                    of.sub_goals.len()
                );
            }
            text.push('\n');
        }
        if is_shown(step) {
            narration.parts.push(NarrationPart::Text(std::mem::take(&mut text)));
            narration.parts.push(NarrationPart::View(of.views[step]));
        }
    }
    if !text.is_empty() {
        narration.parts.push(NarrationPart::Text(text));
    }
    narration
}

impl Narration {
    /// How much of a prompt it takes.
    pub fn size(&self) -> PartSize {
        let sizes = self.parts.iter().map(|part| match part {
            NarrationPart::Text(text) => PartSize { chars: text.chars().count(), images: 0 },
            NarrationPart::View(_) => PartSize { chars: AROUND_IMAGE, images: 1 },
        });
        sizes.sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asking::testing::{demonstration, world};

    /// A demonstration as a prompt has it, with `[view N]` in place of images.
    fn text(views: usize) -> String {
        let narration = narrate(7, &world(), &demonstration(), views);
        let parts = narration.parts.into_iter().map(|part| match part {
            NarrationPart::Text(text) => text,
            NarrationPart::View(view) => format!("[view {view}]\n"),
        });
        parts.collect()
    }

    #[test]
    fn a_demonstration_in_words() {
        insta::assert_snapshot!(text(0), @r#"
        ## Demonstration 7
        Task: "Go to the wall, then to cell 4."
        - start: You are in cell 2.
        - go east 3: You are in cell 5. Sub-goal 1 of 2 is completed.
        - go east 2: the state stays the same. A wall is in the way.
        - turn round: the state stays the same. You went.
        - go west: You are in cell 4. Sub-goal 2 of 2 is completed.
        "#);
    }

    #[test]
    fn views_stand_below_the_state_that_they_show() {
        insta::assert_snapshot!(text(3), @r#"
        ## Demonstration 7
        Task: "Go to the wall, then to cell 4."
        - start: You are in cell 2.
        [view 2]
        - go east 3: You are in cell 5. Sub-goal 1 of 2 is completed.
        [view 5]
        - go east 2: the state stays the same. A wall is in the way.
        - turn round: the state stays the same. You went.
        - go west: You are in cell 4. Sub-goal 2 of 2 is completed.
        [view 4]
        "#);
        let all = demonstration().states.len();
        assert_eq!(text(99).matches("[view").count(), all);
    }

    #[test]
    fn the_size_counts_characters_and_images() {
        let narration = narrate(7, &world(), &demonstration(), 3);
        let chars = text(0).chars().count();
        let size = narration.size();
        assert_eq!(size.images, 3);
        assert!(size.chars >= chars, "{size:?} {chars}");
    }
}
