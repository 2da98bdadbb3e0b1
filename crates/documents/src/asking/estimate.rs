//! What building a document would take, before anything is asked.
//!
//! How long the model's answers are is not known, so there are two figures: every answer is empty, or has as many tokens as it
//! may. A token is taken as [`tokens::PROSE`] characters of the prompts' own words or [`tokens::DOCUMENT`] of narrations and answers,
//! an image as [`tokens::IMAGE`] tokens. Replies that are stored from an earlier attempt count as well.

use std::iter::Sum;
use std::ops::Add;

use domain::{DocumentKind, tokens};

use super::narration::narrations;
use super::prompt::{PromptStage, PromptTexts};
use super::room::PartSize;
use crate::{DocumentName, ModelRecipe, Sources};

/// What building documents would take, at least and at most.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BuildEstimate {
    /// Requests.
    pub requests: [u64; 2],
    /// Images in all prompts.
    pub images: u64,
    /// Tokens of all prompts.
    pub prompt_tokens: [u64; 2],
    /// Tokens of all answers.
    pub answer_tokens: [u64; 2],
}

impl BuildEstimate {
    /// What building the document `name` from `sources` by `recipe` would take. Nothing for a kind that is not built, and without
    /// demonstrations.
    pub fn of(name: DocumentName, sources: &Sources, recipe: &ModelRecipe) -> Self {
        let world = &sources.book().world;
        let listed = sources.demonstrations(name.demonstrations);
        let narrated = narrations(world, &listed, recipe.views_each());
        let sizes: Vec<PartSize> = narrated.iter().map(|one| one.size()).collect();
        let texts = PromptTexts { world, recipe };
        let [least, most] = [0, recipe.max_tokens].map(|answer_tokens| {
            let mut asked = Asked::new(texts, answer_tokens);
            match name.kind {
                DocumentKind::Summary => asked.summary(&sizes),
                DocumentKind::Semantic => asked.semantic(&sizes),
                DocumentKind::Trajectories | DocumentKind::Note => {}
            }
            asked
        });
        let answers = |asked: &Asked<'_>| asked.requests * u64::from(asked.answer_tokens);
        Self {
            requests: [least.requests, most.requests],
            images: least.images,
            prompt_tokens: [least.prompt_tokens, most.prompt_tokens],
            answer_tokens: [answers(&least), answers(&most)],
        }
    }

    /// Tokens of prompts and answers, at least and at most.
    pub fn tokens(&self) -> [u64; 2] {
        [0, 1].map(|bound| self.prompt_tokens[bound] + self.answer_tokens[bound])
    }
}

impl Add for BuildEstimate {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let both = |ours: [u64; 2], theirs: [u64; 2]| [ours[0] + theirs[0], ours[1] + theirs[1]];
        Self {
            requests: both(self.requests, other.requests),
            images: self.images + other.images,
            prompt_tokens: both(self.prompt_tokens, other.prompt_tokens),
            answer_tokens: both(self.answer_tokens, other.answer_tokens),
        }
    }
}

impl Sum for BuildEstimate {
    fn sum<I: Iterator<Item = Self>>(estimates: I) -> Self {
        estimates.fold(Self::default(), Self::add)
    }
}

/// What is asked if every answer has the same length.
struct Asked<'a> {
    texts: PromptTexts<'a>,
    /// Tokens of an answer.
    answer_tokens: u32,
    requests: u64,
    images: u64,
    prompt_tokens: u64,
}

impl<'a> Asked<'a> {
    fn new(texts: PromptTexts<'a>, answer_tokens: u32) -> Self {
        Self { texts, answer_tokens, requests: 0, images: 0, prompt_tokens: 0 }
    }

    /// An answer in a prompt.
    fn answer(&self) -> PartSize {
        let chars = f64::from(self.answer_tokens) * tokens::DOCUMENT;
        PartSize { chars: chars as usize, images: 0 }
    }

    fn summary(&mut self, mut demonstrations: &[PartSize]) {
        let mut so_far = PartSize::default();
        while !demonstrations.is_empty() {
            let room = self.texts.room(PromptStage::Summary, so_far.chars);
            // What does not fit fails when it is asked.
            let count = room.fitting(demonstrations.iter().copied()).max(1);
            let (next, rest) = demonstrations.split_at(count);
            self.ask(PromptStage::Summary, so_far + next.iter().copied().sum());
            (demonstrations, so_far) = (rest, self.answer());
        }
    }

    fn semantic(&mut self, demonstrations: &[PartSize]) {
        if demonstrations.is_empty() {
            return;
        }
        self.in_groups(PromptStage::Extract, demonstrations, 1);
        let mut notes = vec![self.answer(); self.requests as usize];
        loop {
            let groups = self.in_groups(PromptStage::Consolidate, &notes, 2);
            notes.truncate(groups);
            if groups <= 1 {
                break;
            }
        }
        self.ask(PromptStage::Refine, self.answer());
    }

    /// Asks about `parts` in groups that fit into a prompt, of at least `least` parts. Returns their number.
    fn in_groups(&mut self, stage: PromptStage, mut parts: &[PartSize], least: usize) -> usize {
        let room = self.texts.room(stage, 0);
        let mut groups = 0;
        while !parts.is_empty() {
            let count = room.fitting(parts.iter().copied()).max(least).min(parts.len());
            let (next, rest) = parts.split_at(count);
            self.ask(stage, next.iter().copied().sum());
            (parts, groups) = (rest, groups + 1);
        }
        groups
    }

    fn ask(&mut self, stage: PromptStage, material: PartSize) {
        let of_template = self.texts.own_chars(stage) as u64;
        self.requests += 1;
        self.images += material.images as u64;
        self.prompt_tokens += tokens::of_text(of_template, material.chars as u64);
        self.prompt_tokens += tokens::IMAGE * material.images as u64;
    }
}

#[cfg(test)]
mod tests {
    use domain::Appearance;

    use super::*;
    use crate::asking::testing::{book, recipe, world};

    fn estimate(name: &str, recipe: &ModelRecipe) -> BuildEstimate {
        of_many(10, name, recipe)
    }

    fn of_many(demonstrations: u32, name: &str, recipe: &ModelRecipe) -> BuildEstimate {
        let sources = Sources::new(book(demonstrations), 448, Appearance::STANDARD);
        BuildEstimate::of(name.parse().unwrap(), &sources, recipe)
    }

    #[test]
    fn a_large_prompt_takes_everything_at_once() {
        let summary = estimate("summary/original", &recipe());
        assert_eq!((summary.requests, summary.images), ([1, 1], 20));
        assert_eq!(summary.answer_tokens, [0, u64::from(recipe().max_tokens)]);
        let [least, most] = summary.prompt_tokens;
        assert!(least == most && least > 20 * tokens::IMAGE, "{summary:?}");
        let semantic = estimate("semantic/original", &recipe());
        assert_eq!((semantic.requests, semantic.images), ([3, 3], 20));
        assert!(semantic.prompt_tokens[0] < semantic.prompt_tokens[1]);
        let nothing = estimate("summary/elsewhere", &recipe());
        assert_eq!(nothing, BuildEstimate::default());
    }

    #[test]
    fn images_limit_what_is_in_a_prompt() {
        let few = ModelRecipe { image_budget: 4, ..recipe() };
        let summary = estimate("summary/original", &few);
        assert_eq!((summary.requests, summary.images), ([5, 5], 20));
        let none = ModelRecipe { views: 0, ..few };
        let summary = estimate("summary/original", &none);
        assert_eq!((summary.requests, summary.images), ([1, 1], 0));
    }

    #[test]
    fn long_answers_leave_less_room() {
        let recipe = ModelRecipe { views: 0, max_tokens: 700, ..recipe() };
        let texts = PromptTexts { world: &world(), recipe: &recipe };
        let of_template = texts.own_chars(PromptStage::Summary);
        // An answer has at most 1610 characters, and a demonstration more than 200.
        let small = ModelRecipe { context_chars: of_template + 2000, ..recipe };
        for name in ["summary/original", "semantic/original"] {
            let [least, most] = of_many(30, name, &small).requests;
            assert!(least < most, "{name}: {least} {most}");
        }
    }
}
