//! An estimate of what a run with a model would send: requests, images, tokens, money.
//!
//! The number of steps of an episode is not known in advance, so there are two figures: at least as many as the reference,
//! at most T_max. Where the run folder has finished episodes of a condition, their mean replaces both, and the tokens of
//! their prompts are used. Otherwise a prompt is estimated from the template's length, the characters per token of
//! [`domain::tokens`], and 256 tokens an image (the paper's figure).

use std::collections::BTreeMap;

use case_book::Demonstration;
use conditions::Condition;
use conditions::cost::ModelPrices;
use conditions::cost::Money;
use conditions::settings::{ModelSettings, RunSettings};
use documents::DocumentName;
use domain::representation::Trajectories;
use domain::tokens;
use orchestrator::books::Books;
use orchestrator::documents::needed;
use orchestrator::plan::PlannedEpisode;
use run_log::EpisodeRecord;
use run_log::usage::UsageTotals;

/// Characters of a prompt that are always there beside the rules of the world: how to answer, task, the current state and
/// feedback.
const ALWAYS: u64 = 969;
/// Characters of a past step.
const PAST_STEP: u64 = 98;
/// Characters around a retrieved view.
const RETRIEVED_VIEW: u64 = 91;
/// Characters around the instruction of a demonstration.
const INSTRUCTION: u64 = 32;
/// Characters of an action of a whole demonstration, and around one of its views.
const ACTION: u64 = 14;
const KEYFRAME: u64 = 30;

/// What the missing episodes of a condition would take.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RunEstimate {
    /// Requests, at least and at most.
    pub requests: [u64; 2],
    /// Maximum number of images in a request.
    pub images_each: u64,
    /// Tokens of a prompt; `None` when a document that it contains does not exist yet.
    pub prompt_each: Option<u64>,
    /// Maximum number of tokens in an answer.
    pub answer_each: u64,
    /// Whether steps are those of finished episodes.
    pub measured_steps: bool,
    /// Whether tokens are those of finished episodes.
    pub measured_tokens: bool,
}

impl RunEstimate {
    /// Tokens of prompts and answers, at least and at most.
    pub(crate) fn tokens(&self) -> Option<[u64; 2]> {
        let each = self.prompt_each? + self.answer_each;
        Some(self.requests.map(|requests| requests * each))
    }

    /// What they would cost, at least and at most, if the server's own cache served nothing.
    pub(crate) fn cost(&self, prices: &ModelPrices) -> Option<[Money; 2]> {
        let prompt_each = self.prompt_each?;
        Some(self.requests.map(|requests| {
            let usage = UsageTotals {
                prompt_tokens: requests * prompt_each,
                completion_tokens: requests * self.answer_each,
                ..UsageTotals::default()
            };
            usage.cost(prices)
        }))
    }
}

/// What an estimate is made from.
#[derive(Debug)]
pub(crate) struct Basis<'a> {
    /// The run's settings.
    pub settings: &'a RunSettings,
    /// How the model is asked.
    pub model: &'a ModelSettings,
    /// The cases.
    pub books: &'a Books,
    /// Bytes of the existing documents.
    pub documents: &'a BTreeMap<DocumentName, u64>,
    /// Episodes that the run folder has.
    pub done: &'a [EpisodeRecord],
}

impl Basis<'_> {
    /// What `missing`, all of `condition`, would take.
    pub(crate) fn estimate(
        &self,
        condition: &Condition,
        missing: &[&PlannedEpisode],
    ) -> RunEstimate {
        let done = || self.done.iter().filter(|record| record.condition() == *condition);
        let requests: u64 = done().filter_map(|record| record.requests).map(u64::from).sum();
        let prompt = done().map(|record| record.prompt_tokens).sum::<Option<u64>>();
        let measured = (requests > 0).then(|| {
            let mean = requests as f64 / done().count() as f64;
            [(mean * missing.len() as f64).round() as u64; 2]
        });
        let measured_each = prompt.filter(|_| requests > 0).map(|prompt| prompt / requests);
        RunEstimate {
            requests: measured.unwrap_or_else(|| self.bounds(missing)),
            images_each: self.images(condition),
            prompt_each: measured_each.or_else(|| self.prompt(condition, missing)),
            answer_each: u64::from(self.model.answer_tokens),
            measured_steps: measured.is_some(),
            measured_tokens: measured_each.is_some(),
        }
    }

    fn bounds(&self, missing: &[&PlannedEpisode]) -> [u64; 2] {
        let max_steps = self.settings.max_steps;
        let reference = |episode: &&PlannedEpisode| {
            let expert = episode.expert(&self.books.cases.book);
            u64::from(expert.map_or(max_steps, |expert| expert.length).min(max_steps))
        };
        [missing.iter().map(reference).sum(), missing.len() as u64 * u64::from(max_steps)]
    }

    fn images(&self, condition: &Condition) -> u64 {
        u64::from(self.settings.images(condition).min(self.model.image_budget))
    }

    /// Tokens of a prompt with a full window, on average over the cases.
    fn prompt(&self, condition: &Condition, missing: &[&PlannedEpisode]) -> Option<u64> {
        let rules = self.books.cases.book.world.declaration.rules.chars().count() as u64;
        let mut characters = ALWAYS + rules + PAST_STEP * u64::from(condition.variation.window);
        characters += match condition.memory.describe().map(|info| info.trajectories) {
            Some(Trajectories::Nothing) => 0,
            Some(Trajectories::Segment) => {
                let (mut count, mut instructions) = (0, 0);
                for of in missing.iter().flat_map(|of| self.demonstrated(of)) {
                    count += 1;
                    instructions += of.instruction.chars().count() as u64;
                }
                let instruction = INSTRUCTION + instructions / count.max(1);
                let views = RETRIEVED_VIEW * u64::from(1 + self.settings.horizon);
                u64::from(self.settings.hits) * (instruction + views)
            }
            // At most, as everything about an external memory: what it supplies is not known in advance.
            None => u64::from(self.settings.memory_text_budget()),
            Some(Trajectories::Whole) => {
                let all = missing.iter().flat_map(|of| self.demonstrated(of));
                let characters: u64 = all
                    .map(|of| {
                        let instruction = of.instruction.chars().count() as u64;
                        INSTRUCTION + instruction + ACTION * of.actions.len() as u64
                    })
                    .sum();
                let mean = characters / (missing.len() as u64).max(1);
                mean + KEYFRAME * u64::from(self.settings.keyframes)
            }
        };
        let mut documents = 0;
        for name in needed(self.settings, [condition]) {
            documents += self.documents.get(&name)?;
        }
        Some(tokens::of_text(characters, documents) + tokens::IMAGE * self.images(condition))
    }

    /// The demonstrations that an episode remembers.
    fn demonstrated(&self, episode: &PlannedEpisode) -> impl Iterator<Item = &Demonstration> {
        let book = &self.books.demonstrations.book;
        let named = book.of_case(episode.case_index as u32, episode.demonstrations());
        named.into_iter().flatten().map(|of| &book.demonstrations[of as usize])
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    #[test]
    fn lengths_are_those_of_the_template() {
        let template = prompt::Template::BUILT_IN_FILE;
        assert!(
            template.contains("\nversion = \"prompt/2\"\n"),
            "the template has changed: measure the constants above again"
        );
        let system = template.split("\"\"\"").nth(1).unwrap();
        let system = system.chars().count() as u64;
        assert!(
            (ALWAYS / 2..ALWAYS * 2).contains(&system),
            "{system} characters of the system message alone"
        );
    }
    use case_book::{BookFile, BookRequest};
    use orchestrator::plan::plan;
    use rigs::records::record;
    use settings::{Layer, resolve};
    use warehouse::case_book::write_books;

    fn settings() -> RunSettings {
        let flags = Layer::flags([("policy", "openai"), ("model", "m")]).unwrap();
        resolve([flags]).unwrap().settings
    }

    pub(crate) fn books() -> Books {
        let books = write_books(&BookRequest::default()).unwrap();
        Books {
            cases: BookFile::new(books.cases).unwrap(),
            demonstrations: BookFile::new(books.demonstrations).unwrap(),
            streams: None,
            elsewhere: None,
        }
    }

    #[test]
    fn bounds_come_from_references_and_figures_from_finished_episodes() {
        let (settings, books) = (settings(), books());
        let model = settings.model.as_ref().unwrap();
        let condition: Condition = "episodic/original/unchanged/original".parse().unwrap();
        let ids = books.cases.book.ids();
        let episodes: Vec<_> = plan(&[(condition, 1)], &[0, 1], &ids, 1).collect();
        let missing: Vec<&PlannedEpisode> = episodes.iter().collect();
        let documents = BTreeMap::new();
        let mut done = [record("t01-01", true)];
        done[0].prompt_tokens = Some(12_000);
        let basis =
            |done| Basis { settings: &settings, model, books: &books, documents: &documents, done };
        let found = basis(&[]).estimate(&condition, &missing);
        // A demonstration may turn to the rack after its last step that counts.
        let actions =
            |case: usize| books.demonstrations.book.demonstrations[4 * case].actions.len() as u64;
        let [least, most] = found.requests;
        assert!(least.abs_diff(actions(0) + actions(1)) <= 2, "{least}");
        assert_eq!(most, 400);
        // (2565 + 6 x 98 + 7 x 91 + 32 + an instruction of 28) / 4, rounded up, and 14 images of 256.
        assert_eq!((found.images_each, found.prompt_each), (14, Some(963 + 14 * 256)));
        assert_eq!(found.tokens().unwrap()[1], 400 * (963 + 3584 + 30));

        let found = basis(&done).estimate(&condition, &missing);
        assert_eq!((found.requests, found.prompt_each), ([20, 20], Some(1200)));
        assert!(found.measured_steps && found.measured_tokens);

        let summary: Condition = "summary/original/unchanged/original".parse().unwrap();
        let found = basis(&[]).estimate(&summary, &missing);
        assert_eq!(
            (found.prompt_each, found.tokens()),
            (None, None),
            "the length of the document is not known"
        );
        // A summary of 42,136 characters has 18,700 tokens.
        let documents = BTreeMap::from([(needed(&settings, [&summary])[0], 42_136)]);
        let basis =
            Basis { settings: &settings, model, books: &books, documents: &documents, done: &[] };
        let prompt_each = basis.estimate(&summary, &missing).prompt_each.unwrap();
        let others = (2565 + 6 * 98) / 4 + 7 * 256;
        assert!((18_000..19_000).contains(&(prompt_each - others)), "{prompt_each}");
    }
}
