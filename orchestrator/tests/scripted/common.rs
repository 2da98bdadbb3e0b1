//! What the tests have in common.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use case_book::{BookFile, BookRequest};
use domain::ExternalName;
use orchestrator::books::Books;
use orchestrator::lanes::{AnsweredRequest, FinishedEpisode, Rules};
use orchestrator::pipeline::{Facts, MemoryState, Observer, Participant, PipelineOptions};
use rigs::process::ScratchRun;
use rigs::scripted;
use shm_types::message::MAX_EXTERNAL_MEMORIES;
use supervise::{Launch, System};
use warehouse::CaseSet;
use warehouse::case_book::write_books;

/// The books of the shipped cases, on blocked routes too.
pub(crate) fn books() -> Books {
    let cases = CaseSet::shipped().cases.into_iter().map(|case| case.id).collect();
    let demonstrations = ["original", "4", "irrelevant", "confusable"];
    let demonstrations = demonstrations.map(|set| set.parse().unwrap()).into();
    let request = BookRequest { cases, demonstrations, blocked: true, ..BookRequest::default() };
    let books = write_books(&request).unwrap();
    Books {
        cases: BookFile::new(books.cases).unwrap(),
        demonstrations: BookFile::new(books.demonstrations).unwrap(),
        streams: None,
        elsewhere: None,
    }
}

pub(crate) const MAX_STEPS: u32 = 10;

pub(crate) const RULES: Rules = Rules {
    horizon: 6,
    hits: 1,
    keyframes: 40,
    memory_images: 40,
    memory_text_bytes: 65_536,
    max_steps: MAX_STEPS,
    expert: false,
    external_memories: [None; MAX_EXTERNAL_MEMORIES],
};

/// A run that starts `launches`, with so much time for an answer.
pub(crate) fn options(
    scratch: &ScratchRun,
    launches: Vec<Launch>,
    answer: Duration,
) -> PipelineOptions {
    PipelineOptions {
        launcher: Arc::new(System),
        launches,
        external_world: None,
        external_policy: false,
        logs: scratch.base().join("logs"),
        start_timeout: Duration::from_secs(60),
        answer_timeout: answer,
        decision_timeout: Some(answer),
        memories: Vec::new(),
        memory_timeout: answer,
        // Those that are started here take part in nothing, and are killed.
        shutdown_timeout: Duration::from_millis(500),
    }
}

/// What an observer saw of a run among scripted processes.
#[derive(Default)]
pub(crate) struct Seen {
    pub(crate) finished: Vec<usize>,
    pub(crate) problems: Vec<String>,
    pub(crate) generations: u32,
    pub(crate) steps: u64,
    /// Requests to a model that were answered.
    pub(crate) answered: u32,
    /// What became of external memories.
    pub(crate) states: Vec<(ExternalName, MemoryState)>,
}

impl Observer for Seen {
    fn starting(&mut self, generation: u32) {
        self.generations = generation;
    }
    fn memory_state(&mut self, name: ExternalName, state: &MemoryState) -> Result<()> {
        self.states.push((name, state.clone()));
        Ok(())
    }
    fn ready(&mut self, facts: &BTreeMap<Participant, Facts>) -> Result<()> {
        let memories = facts.keys().filter(|one| one.memory.is_some()).count();
        assert_eq!(facts.len(), 3 + memories);
        assert!(facts.values().all(|facts| facts["kind"] == scripted::KIND));
        Ok(())
    }
    fn answered(&mut self, _request: &AnsweredRequest) -> Result<Option<String>> {
        self.answered += 1;
        Ok(None)
    }
    fn finished(&mut self, finished: &FinishedEpisode, _attempt: u32) -> Result<()> {
        assert_eq!(finished.record.steps, MAX_STEPS);
        self.finished.push(finished.episode.case_index);
        Ok(())
    }
    fn progress(&mut self, steps: u64) {
        self.steps += steps;
    }
    fn problem(&mut self, what: &str) {
        self.problems.push(what.to_owned());
    }
}
