//! The prompts: templates in text files, and how they are filled in.

use case_book::{WorldDeclaration, fill};
use serde::{Deserialize, Serialize};

use super::narration::{Narration, NarrationPart};
use super::room::Room;
use crate::ModelRecipe;

/// Separates the system message from the user message in a template.
const USER: &str = "=== user ===\n";

/// Where demonstrations stand in a template. They have images, so that they are no value.
const DEMONSTRATIONS: &str = "{demonstrations}";

/// What a prompt tells of the world.
const WORLD: &str = include_str!("prompts/world.txt");

/// What a prompt says about images, if demonstrations have some.
const IMAGES: &str = include_str!("prompts/images.txt");

/// Minimum number of characters in a token. Coordinates and digits make short tokens.
const CHARS_PER_TOKEN: usize = 2;

/// In place of a summary before there is one.
const NO_SUMMARY: &str = "(There is none yet.)";

/// A prompt for a model. `V` is a view: its number in the book, an image, or the hash of one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DocumentPrompt<V> {
    /// The system message: the rules.
    pub system: String,
    /// The user message: the material, in reading order.
    pub user: Vec<PromptPart<V>>,
    /// Maximum number of tokens in the answer.
    pub max_tokens: u32,
}

/// A part of a user message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PromptPart<V> {
    /// Text.
    Text(String),
    /// A view.
    View(V),
}

impl<V> DocumentPrompt<V> {
    /// Number of characters in both messages.
    pub fn chars(&self) -> usize {
        let text = |part: &PromptPart<V>| match part {
            PromptPart::Text(text) => text.chars().count(),
            PromptPart::View(_) => 0,
        };
        self.system.chars().count() + self.user.iter().map(text).sum::<usize>()
    }

    /// The views, in reading order.
    pub fn views(&self) -> impl Iterator<Item = &V> {
        self.user.iter().filter_map(|part| match part {
            PromptPart::Text(_) => None,
            PromptPart::View(view) => Some(view),
        })
    }

    /// The prompt with another value in place of each view.
    ///
    /// # Errors
    /// The first error of `map`.
    pub fn try_map<W, E>(
        &self,
        mut map: impl FnMut(&V) -> Result<W, E>,
    ) -> Result<DocumentPrompt<W>, E> {
        let part = |part: &PromptPart<V>| {
            Ok(match part {
                PromptPart::Text(text) => PromptPart::Text(text.clone()),
                PromptPart::View(view) => PromptPart::View(map(view)?),
            })
        };
        Ok(DocumentPrompt {
            system: self.system.clone(),
            user: self.user.iter().map(part).collect::<Result<_, E>>()?,
            max_tokens: self.max_tokens,
        })
    }
}

/// A step in building a document.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PromptStage {
    /// The summary so far and further demonstrations become a new summary.
    Summary,
    /// Demonstrations become notes.
    Extract,
    /// Notes become fewer notes.
    Consolidate,
    /// Notes become a document.
    Refine,
}

impl PromptStage {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Summary, Self::Extract, Self::Consolidate, Self::Refine];

    /// Its name, also in file names.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Summary => "summary",
            Self::Extract => "extract",
            Self::Consolidate => "consolidate",
            Self::Refine => "refine",
        }
    }

    const fn file(self) -> &'static str {
        match self {
            Self::Summary => include_str!("prompts/summary.txt"),
            Self::Extract => include_str!("prompts/extract.txt"),
            Self::Consolidate => include_str!("prompts/consolidate.txt"),
            Self::Refine => include_str!("prompts/refine.txt"),
        }
    }
}

/// The prompts for documents of a world by a recipe.
#[derive(Debug, Clone, Copy)]
pub struct PromptTexts<'a> {
    /// What the world says of itself.
    pub world: &'a WorldDeclaration,
    /// How the model is asked.
    pub recipe: &'a ModelRecipe,
}

impl PromptTexts<'_> {
    /// The prompt for a new summary from the one so far, empty at first, and further demonstrations.
    pub fn summary(self, so_far: &str, demonstrations: &[Narration]) -> DocumentPrompt<u32> {
        let so_far = if so_far.is_empty() { NO_SUMMARY } else { so_far };
        self.prompt(PromptStage::Summary, &[("so_far", so_far)], demonstrations)
    }

    /// The prompt for notes from demonstrations.
    pub fn extract(self, demonstrations: &[Narration]) -> DocumentPrompt<u32> {
        self.prompt(PromptStage::Extract, &[], demonstrations)
    }

    /// The prompt for one set of notes from several.
    pub fn consolidate(self, notes: &[String]) -> DocumentPrompt<u32> {
        let numbered = (1..)
            .zip(notes)
            .map(|(number, notes): (u32, _)| format!("## Notes {number}\n{notes}\n"));
        let joined = numbered.collect::<Vec<_>>().join("\n");
        self.prompt(PromptStage::Consolidate, &[("notes", &joined)], &[])
    }

    /// The prompt for a document from notes.
    pub fn refine(self, notes: &str) -> DocumentPrompt<u32> {
        self.prompt(PromptStage::Refine, &[("notes", notes)], &[])
    }

    /// What is left of a prompt of `stage` beside its own words and `other` characters.
    pub fn room(self, stage: PromptStage, other: usize) -> Room {
        let used = self.own_chars(stage) + other;
        Room {
            chars: self.recipe.context_chars.saturating_sub(used),
            images: self.recipe.image_budget as usize,
        }
    }

    /// Characters of a prompt of `stage` without material.
    pub(super) fn own_chars(self, stage: PromptStage) -> usize {
        self.prompt(stage, &[("so_far", ""), ("notes", "")], &[]).chars()
    }

    fn prompt(
        self,
        stage: PromptStage,
        values: &[(&str, &str)],
        demonstrations: &[Narration],
    ) -> DocumentPrompt<u32> {
        let Self { world, recipe } = self;
        let actions: Vec<&str> =
            world.action_codes().map(|code| world.action_words(code)).collect();
        let of_world = [("rules", world.rules.as_str()), ("actions", &actions.join(", "))];
        let limit = (recipe.max_tokens as usize * CHARS_PER_TOKEN).to_string();
        let of_all_stages = [
            ("world", &*fill(WORLD.trim_end(), &of_world)),
            ("images", if recipe.views_each() > 0 { IMAGES.trim_end() } else { "" }),
            ("limit", &limit),
        ];
        let values = [&of_all_stages, values].concat();
        let filled = |template: &str| fill(template, &values);
        let (system, user) = stage.file().split_once(USER).unwrap_or(("", stage.file()));
        let (before, after) =
            user.trim_end().split_once(DEMONSTRATIONS).unwrap_or((user.trim_end(), ""));
        let mut writer = Writer { parts: Vec::new(), text: filled(before), images: 0 };
        for (index, narration) in demonstrations.iter().enumerate() {
            if index > 0 {
                writer.text.push('\n');
            }
            writer.narration(narration);
        }
        writer.text.push_str(&filled(after));
        DocumentPrompt {
            system: filled(system.trim_end()),
            user: writer.finish(),
            max_tokens: recipe.max_tokens,
        }
    }
}

/// Writes a user message.
struct Writer {
    parts: Vec<PromptPart<u32>>,
    /// Text after the last part.
    text: String,
    /// Images so far.
    images: u32,
}

impl Writer {
    fn narration(&mut self, narration: &Narration) {
        for part in &narration.parts {
            match part {
                NarrationPart::Text(text) => self.text.push_str(text),
                NarrationPart::View(view) => {
                    self.images += 1;
                    self.text.push_str(&format!("Image {}:\n", self.images));
                    self.parts.push(PromptPart::Text(std::mem::take(&mut self.text)));
                    self.parts.push(PromptPart::View(*view));
                    self.text.push('\n');
                }
            }
        }
    }

    fn finish(mut self) -> Vec<PromptPart<u32>> {
        self.parts.push(PromptPart::Text(self.text));
        self.parts
    }
}

#[cfg(test)]
mod tests {
    use domain::hex;
    use sha2::{Digest, Sha256};

    use super::*;
    use crate::PROMPT_VERSION;
    use crate::asking::narrations;
    use crate::asking::testing::{demonstration, recipe, world};

    /// When this fails, a prompt has changed: raise [`PROMPT_VERSION`] along with the hashes.
    #[test]
    fn the_version_belongs_to_these_texts() {
        let stages = PromptStage::ALL.map(|stage| (stage.name(), stage.file()));
        let files = stages.into_iter().chain([("world", WORLD), ("images", IMAGES)]);
        let hashes =
            files.map(|(name, text)| format!("{name} {}", &hex(&Sha256::digest(text))[..16]));
        let hashes: Vec<String> = hashes.collect();
        insta::assert_snapshot!(format!("{PROMPT_VERSION}: {}", hashes.join(", ")), @"2: summary e24171765477bf8c, extract 081518a964916ab8, consolidate 53e4a5c1ce67b49b, refine cd046736371ef78a, world 962f3a3524368e2a, images 5a1d6e658801ac2e");
    }

    /// What a prompt says of the world is what the world says of itself.
    #[test]
    fn no_prompt_is_about_the_warehouse() {
        for file in PromptStage::ALL.map(PromptStage::file).into_iter().chain([WORLD, IMAGES]) {
            let text = file.to_lowercase();
            for word in
                ["warehouse", "plate", "rack", "aisle", "column", "row", "heading", "item", "walk"]
            {
                let mut words = text.split(|c: char| !c.is_alphabetic());
                let is_it = |other: &str| other == word || other.strip_suffix('s') == Some(word);
                assert!(!words.any(is_it), "`{word}` in {file}");
            }
        }
    }

    fn all_prompts(views: u32) -> [DocumentPrompt<u32>; 4] {
        let (world, demonstration) = (world(), demonstration());
        let recipe = ModelRecipe { views, ..recipe() };
        let texts = PromptTexts { world: &world, recipe: &recipe };
        let narrated = narrations(&world, &[&demonstration, &demonstration], recipe.views_each());
        [
            texts.summary("SO FAR {limit}", &narrated),
            texts.extract(&narrated),
            texts.consolidate(&["NOTES {limit}".to_owned(), "MORE".to_owned()]),
            texts.refine("NOTES {limit}"),
        ]
    }

    fn shown(prompt: &DocumentPrompt<u32>) -> String {
        let parts = prompt.user.iter().map(|part| match part {
            PromptPart::Text(text) => text.clone(),
            PromptPart::View(view) => format!("[view {view}]"),
        });
        format!("{}\n=== user ===\n{}", prompt.system, parts.collect::<String>())
    }

    #[test]
    fn every_placeholder_is_filled() {
        for views in [0, 2] {
            for prompt in all_prompts(views) {
                let text = shown(&prompt).replace("{limit}", "");
                assert!(!text.contains(['{', '}']), "{text}");
                assert!(text.contains(&world().rules), "{text}");
                assert_eq!(prompt.max_tokens, recipe().max_tokens);
                assert_eq!(
                    text.contains("Image 3:"),
                    views > 0 && text.contains("## Demonstration 2")
                );
            }
        }
    }

    #[test]
    fn images_are_numbered_over_the_whole_prompt() {
        let [summary, ..] = all_prompts(2);
        insta::assert_snapshot!(shown(&summary), @r#"
        You keep the summary of demonstrations that an expert gave in the world described below. Later an agent gets your summary, and nothing else of the demonstrations, and has to solve tasks such as these in the same world, from any start. What you leave out is lost.

        What the agent is told of the world:
        <world>
        You are in a corridor of ten cells.
        </world>
        Its actions: go east, go west, turn round.

        You get the summary so far and further demonstrations. A demonstration is a task, the expert's states and actions in order, what the expert was told when an action left the state as it was, and where a sub-goal of the task was completed. A number after an action says how many times it was taken one after the other; the state is the one after them. You also get views from the expert's camera. Images are numbered in the order in which you are given them: "Image 3:" in the text stands where the third image belongs, and it shows what the expert saw in the state of the line above.

        Write the new summary, which replaces the old one:
        - Objects: each object that tasks name or that you recognise, and where it is reached, in the words of the states. The state in which a sub-goal is completed says where its object is.
        - Landmarks: what helps to know where one is and which way to go, and where it is: passages and how they meet, dead ends, blocked ways, things that can be seen from afar.
        - Routes: from where to which object, with the turning points in order. Of routes that hardly differ keep one.
        - Keep every object of the old summary and add the new ones. Join lines about the same thing. Where demonstrations contradict each other, keep what was seen more often.
        - Invent nothing. Write no line about what was not shown.
        - Write at most 2000 characters. If that is too little, leave out routes first, then landmarks, and objects last.

        Answer with the summary alone, in this form, with one line for each object, landmark and route:

        # Summary of the demonstrations
        ## Objects
        - <object>: <where it is reached>
        ## Landmarks
        - <landmark>: <where it is>
        ## Routes
        - <from where> to <object>: <the way>
        === user ===
        The summary so far:

        SO FAR {limit}

        Further demonstrations:

        ## Demonstration 1
        Task: "Go to the wall, then to cell 4."
        - start: You are in cell 2.
        Image 1:
        [view 2]
        - go east 3: You are in cell 5. Sub-goal 1 of 2 is completed.
        - go east 2: the state stays the same. A wall is in the way.
        - turn round: the state stays the same. You went.
        - go west: You are in cell 4. Sub-goal 2 of 2 is completed.
        Image 2:
        [view 4]

        ## Demonstration 2
        Task: "Go to the wall, then to cell 4."
        - start: You are in cell 2.
        Image 3:
        [view 2]
        - go east 3: You are in cell 5. Sub-goal 1 of 2 is completed.
        - go east 2: the state stays the same. A wall is in the way.
        - turn round: the state stays the same. You went.
        - go west: You are in cell 4. Sub-goal 2 of 2 is completed.
        Image 4:
        [view 4]

        Write the new summary.
        "#);
        assert_eq!(summary.views().count(), 4);
    }

    #[test]
    fn the_room_is_what_is_left() {
        let (world, recipe) = (world(), recipe());
        let texts = PromptTexts { world: &world, recipe: &recipe };
        let Room { chars, images } = texts.room(PromptStage::Refine, 10);
        assert_eq!(images, 50);
        let prompt = texts.refine(&"n".repeat(chars + 10));
        assert_eq!(prompt.chars(), recipe.context_chars);
    }
}
