//! A Python policy as the SDK sees one: requests go in as Python objects, answers come back as decisions.

use domain::Outcome;
use peer::{Answer, Answers, Batch, Decider, Decision, PinnedStep, RequestId, ServeError, Usage};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::classes::{Classes, error};
use crate::declaration::DeclaredWorld;
use crate::exchange;
use crate::raised::{in_words, is_interrupt, is_list, print};
use crate::step::Step;

/// Exceptions in a row, without an answer in between, after which the run is asked to stop.
const MAX_FAILURES_IN_A_ROW: u32 = 8;

pub(crate) struct PythonPolicy {
    policy: Py<PyAny>,
    name: String,
    facts: Vec<(String, String)>,
    failures: u32,
    /// The run was asked to stop because of them.
    halted: bool,
    /// The exception that Python raised, for the caller of `serve`.
    raised: Option<PyErr>,
}

/// A policy's answer to one request.
enum Reply<'py> {
    Decided(Decision, Option<Bound<'py, PyAny>>),
    Failed(String, Option<Bound<'py, PyAny>>),
}

impl PythonPolicy {
    pub(crate) fn new(policy: &Bound<'_, PyAny>, code: String) -> PyResult<Self> {
        let py = policy.py();
        let mut name: String = policy.getattr("name")?.extract()?;
        if name.is_empty() {
            name = policy.get_type().name()?.to_string();
        }
        let said = policy.call_method0("facts")?;
        let mut facts = vec![("sdk".to_owned(), "python".to_owned())];
        if !code.is_empty() {
            facts.push(("code".to_owned(), code));
        }
        let entries = PyDict::new(py);
        entries.update(said.cast()?)?;
        for (key, value) in entries {
            let (Ok(key), Ok(value)) = (key.extract::<String>(), value.extract()) else {
                let problem = format!("policy {name}: its facts must be text, but are {said:?}");
                return Err(error(py, "PolicyError", problem));
            };
            facts.push((key, value));
        }
        let policy = policy.clone().unbind();
        Ok(Self { policy, name, facts, failures: 0, halted: false, raised: None })
    }

    /// Takes the exception that Python raised while serving, if any.
    pub(crate) fn take_raised(&mut self) -> Option<PyErr> {
        self.raised.take()
    }

    /// Ends serving because of `raised`.
    fn raise(&mut self, raised: PyErr) -> ServeError {
        let error = match Python::attach(|py| is_interrupt(py, &raised)) {
            true => ServeError::Interrupted,
            false => ServeError::Policy(raised.to_string().into()),
        };
        self.raised = Some(raised);
        error
    }

    fn answer_batch(
        &mut self,
        py: Python<'_>,
        batch: &Batch<'_>,
        answers: &Answers,
    ) -> PyResult<()> {
        let classes = Classes::get(py)?;
        let mut requests = Vec::with_capacity(batch.len());
        let mut steps = Vec::with_capacity(batch.len());
        for (request, pinned) in batch.iter().zip(batch.steps()) {
            let step = Bound::new(py, Step::new(pinned, request.images()))?;
            requests.push(classes.served_request.bind(py).call1((&step,))?);
            steps.push(step);
        }
        let replies = self.ask(py, &requests, answers);
        steps.iter().for_each(|step| step.get().release());
        for ((request, pinned), reply) in batch.iter().zip(batch.steps()).zip(replies?) {
            let id = request.id();
            let world = DeclaredWorld::of(py, request.world)?;
            if let Some(foreign) = world.foreign_action(&reply)? {
                let Self { name, .. } = self;
                answers.stop_run(format!("policy {name} {foreign}"));
                return Ok(());
            }
            match self.reply(py, &world, &reply, request.images())? {
                Reply::Decided(decision, exchange) => {
                    record(answers, id, pinned, exchange)?;
                    answers.decide(id, decision);
                }
                Reply::Failed(why, exchange) => {
                    record(answers, id, pinned, exchange)?;
                    answers.fail(id, why);
                }
            }
        }
        Ok(())
    }

    /// The policy's answers to `requests`. If it raises, each request is put to it alone, so that a request that it
    /// cannot answer costs only its own episode.
    fn ask<'py>(
        &mut self,
        py: Python<'py>,
        requests: &[Bound<'py, PyAny>],
        answers: &Answers,
    ) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let raised = match self.act(py, requests)? {
            Ok(replies) => return Ok(replies),
            Err(raised) => raised,
        };
        if requests.len() == 1 {
            return Ok(vec![self.failed(py, raised, answers)?]);
        }
        let mut replies = Vec::with_capacity(requests.len());
        for request in requests {
            replies.push(match self.act(py, std::slice::from_ref(request))? {
                Ok(reply) => reply.into_iter().next().unwrap_or_else(|| py.None().into_bound(py)),
                Err(raised) => self.failed(py, raised, answers)?,
            });
        }
        Ok(replies)
    }

    /// Calls `act`. The outer error ends serving; the inner one is an exception of the policy.
    fn act<'py>(
        &mut self,
        py: Python<'py>,
        requests: &[Bound<'py, PyAny>],
    ) -> PyResult<Result<Vec<Bound<'py, PyAny>>, PyErr>> {
        let batch = PyList::new(py, requests)?;
        let replies = match self.policy.bind(py).call_method1(intern!(py, "act"), (batch,)) {
            Ok(replies) => replies,
            Err(raised) if is_interrupt(py, &raised) => return Err(raised),
            Err(raised) => return Ok(Err(raised)),
        };
        let broken = |problem: String| {
            Err(error(py, "PolicyError", format!("policy {} {problem}", self.name)))
        };
        if !is_list(&replies) {
            return broken(format!(
                "returned {} from act: it must return a list with one answer for each request",
                replies.repr()?
            ));
        }
        let replies: Vec<_> = match replies.try_iter().and_then(Iterator::collect) {
            Ok(replies) => replies,
            Err(raised) if is_interrupt(py, &raised) => return Err(raised),
            Err(raised) => return Ok(Err(raised)),
        };
        if replies.len() != requests.len() {
            return broken(format!(
                "answered {} of {} requests: it must answer each once",
                replies.len(),
                requests.len()
            ));
        }
        self.failures = 0;
        Ok(Ok(replies))
    }

    /// The answer to a request on which the policy raised an exception. Asks the run to stop if it always does.
    fn failed<'py>(
        &mut self,
        py: Python<'py>,
        raised: PyErr,
        answers: &Answers,
    ) -> PyResult<Bound<'py, PyAny>> {
        print(py, &raised);
        let why = format!("policy {} raised {}", self.name, in_words(py, &raised));
        self.failures += 1;
        if self.failures >= MAX_FAILURES_IN_A_ROW && !self.halted {
            self.halted = true;
            answers.stop_run(format!(
                "{why}; this was exception {} in a row without an answer in between, and the policy's log has \
                 the tracebacks",
                self.failures
            ));
        }
        Classes::get(py)?.failed.bind(py).call1((why,))
    }

    fn reply<'py>(
        &self,
        py: Python<'py>,
        world: &DeclaredWorld,
        answer: &Bound<'py, PyAny>,
        images: u32,
    ) -> PyResult<Reply<'py>> {
        let classes = Classes::get(py)?;
        let short = |answer| Ok(Reply::Decided(Decision { answer, images, usage: None }, None));
        if let Some(action) = world.read_action(answer)? {
            return short(Answer::Act(action));
        }
        if answer.is_none() {
            return short(Answer::Unreadable);
        }
        if let Some(code) = classes.outcome.code(answer)?
            && let Some(answer) = without_action(code)
        {
            return short(answer);
        }
        if answer.get_type().is(&classes.decision) {
            let decision = decision(classes, world, answer, images).map_err(|problem| {
                let problem = format!("{answer:?} does not fit into a message: {problem}");
                error(py, "PolicyError", problem)
            })?;
            return Ok(Reply::Decided(decision, some(answer.getattr("exchange")?)));
        }
        if answer.get_type().is(&classes.failed) {
            let why = answer.getattr("why")?.str()?.to_string();
            return Ok(Reply::Failed(why, some(answer.getattr("exchange")?)));
        }
        let problem = format!(
            "policy {} answered {} ({}): an answer is {}, or UNREADABLE, EMPTY, REFUSED, CUT_OFF, None, a Decision \
             or Failed",
            self.name,
            answer.repr()?,
            answer.get_type().name()?,
            world.action_forms()
        );
        Err(error(py, "PolicyError", problem))
    }
}

impl Decider for PythonPolicy {
    fn name(&self) -> &str {
        &self.name
    }

    fn facts(&self) -> Vec<(&str, String)> {
        self.facts.iter().map(|(name, value)| (name.as_str(), value.clone())).collect()
    }

    fn take(&mut self, batch: &Batch<'_>, answers: &Answers) -> Result<(), ServeError> {
        if let Some(raised) = self.take_raised() {
            return Err(self.raise(raised));
        }
        Python::attach(|py| self.answer_batch(py, batch, answers))
            .map_err(|raised| self.raise(raised))
    }

    fn reset(&mut self, lane: u32) {
        let reset = Python::attach(|py| {
            self.policy.bind(py).call_method1(intern!(py, "reset"), (lane,)).map(drop)
        });
        if let Err(raised) = reset {
            self.raised = Some(raised);
        }
    }

    fn idle(&mut self) -> Result<(), ServeError> {
        match self.take_raised() {
            Some(raised) => Err(self.raise(raised)),
            None => Python::attach(|py| py.check_signals()).map_err(|raised| self.raise(raised)),
        }
    }

    fn release_frames(&mut self) {
        // Arrays in reference cycles are freed no earlier.
        let _ = Python::attach(|py| py.import("gc")?.call_method0("collect").map(drop));
    }
}

/// Adds the exchange with a model to the prompt log, if there is one.
fn record(
    answers: &Answers,
    id: RequestId,
    step: &PinnedStep,
    exchange: Option<Bound<'_, PyAny>>,
) -> PyResult<()> {
    if let Some(exchange) = exchange
        && answers.logs_prompts()
    {
        let exchange = exchange::read(&exchange, step)?;
        answers.record(id, || exchange);
    }
    Ok(())
}

fn some(value: Bound<'_, PyAny>) -> Option<Bound<'_, PyAny>> {
    (!value.is_none()).then_some(value)
}

/// The answer with an outcome's `code`, which holds no action.
fn without_action(code: u8) -> Option<Answer> {
    match Outcome::try_from(code).ok()? {
        Outcome::Acted => None,
        Outcome::Unreadable => Some(Answer::Unreadable),
        Outcome::Empty => Some(Answer::Empty),
        Outcome::Refused => Some(Answer::Refused),
        Outcome::CutOff => Some(Answer::CutOff),
    }
}

/// A `memtransfer.Decision` about a request with this many images.
fn decision(
    classes: &Classes,
    world: &DeclaredWorld,
    value: &Bound<'_, PyAny>,
    images: u32,
) -> PyResult<Decision> {
    let outcome = classes.outcome.code(&value.getattr("outcome")?)?.and_then(without_action);
    let action = world.action_in(value)?.map(Answer::Act);
    Ok(Decision {
        answer: action.or(outcome).unwrap_or(Answer::Unreadable),
        images: value.getattr("images")?.extract::<Option<u32>>()?.unwrap_or(images),
        usage: some(value.getattr("usage")?).map(|usage| read_usage(&usage)).transpose()?,
    })
}

fn read_usage(value: &Bound<'_, PyAny>) -> PyResult<Usage> {
    let count = |name: &str| value.getattr(name)?.extract();
    Ok(Usage {
        prompt_tokens: count("prompt_tokens")?,
        completion_tokens: count("completion_tokens")?,
        cached_tokens: count("cached_tokens")?,
        image_tokens: count("image_tokens")?,
        memory_tokens: count("memory_tokens")?,
        reusable_tokens: count("reusable_tokens")?,
        attempts: value.getattr("attempts")?.extract()?,
        replayed: value.getattr("replayed")?.is_truthy()?,
        prompted_ns: value.getattr("prompted_ns")?.extract()?,
        sent_ns: value.getattr("sent_ns")?.extract()?,
        finish_reason: value.getattr("finish_reason")?.extract()?,
        reasoned: value.getattr("reasoned")?.extract()?,
        model: value.getattr("model")?.extract()?,
    })
}
