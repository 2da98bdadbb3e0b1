//! The world under test.

mod books;
pub(crate) mod checks;

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

use bytemuck::Zeroable;
use case_book::{
    BookFile, CaseFacts, DEMONSTRATIONS_FILE, DemonstrationBook, Reference, SharedFacts,
    WORLD_FILE, WorldDeclaration,
};
use domain::{ActionCode, Route, Start};
use serde_json::{Map, Value};
use shm_types::message::{
    EpisodeEnd, FrameId, NO_ACTION, NO_FRAME, Observation, RequestId, Role, StepCommand, StepKind,
    StepReport, ViewRequest, ViewRequestKind, WorldEpisodeConfig, action_code,
};
use shm_types::process::monotonic_ns;
use shm_types::{Attach, BusError, FrameStore};
use supervise::{Children, Launch};

use crate::neighbours::WorldNeighbours;
use crate::subject::{CheckResult, Subject, Terms, TestedRole, next, wrong};

/// Past steps that a lane keeps the views of: few, so that all lanes can be in episodes at once.
const WINDOW: u32 = 2;

/// Frames that may be resident: the views of all lanes, and some for memory.
const FRAMES: u32 = 320;

/// The seed of all episodes.
const SEED: u64 = 7;

/// A step of a demonstration: the index of the demonstration, and the step.
type DemonstrationStep = (u32, u32);

/// The role of a world.
#[derive(Debug, Default)]
pub(crate) struct WorldRole {
    declaration: WorldDeclaration,
    /// The actions of commands that were sent.
    actions: BTreeMap<RequestId, Option<ActionCode>>,
    /// Step reports whose observations have not arrived.
    reports: BTreeMap<RequestId, StepReport>,
    /// By lane and episode: the facts that came last.
    facts: BTreeMap<(u32, u64), Vec<u8>>,
    /// What was supplied to memory.
    views: BTreeMap<DemonstrationStep, (FrameId, Picture)>,
}

/// What a frame shows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Picture {
    /// The first bytes of the BLAKE3 hash of its pixels; `None` if it could not be read.
    hash: Option<[u8; 16]>,
    /// What is wrong with it.
    problem: Option<String>,
}

/// The answer to a config or a command.
#[derive(Debug, Clone)]
pub(crate) struct Seen {
    observation: Observation,
    report: Option<StepReport>,
    /// The facts of the episode, if it has ended.
    facts: Option<Vec<u8>>,
    /// `None` without a frame.
    picture: Option<Picture>,
}

/// How an episode begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Begin {
    case: u32,
    start: Start,
    is_blocked: bool,
}

/// A world in one generation.
pub(crate) type TestedWorld<'a> = Subject<'a, WorldRole>;

/// The folder of the case book in the folder of a run.
fn books_folder(root: &Path) -> PathBuf {
    root.join("books")
}

impl TestedRole for WorldRole {
    const ROLE: Role = Role::Sim;
    const A_PROCESS: &'static str = "a world";
    const NAME_FACT: &'static str = "world";
    const ANSWER: &'static str = "observation";
    const AN_ANSWER: &'static str = "an observation";
    const ANSWERED: &'static str = "executed";
    const WAITS_FOR_RUN: bool = false;

    type Neighbours = WorldNeighbours;
    type Answer = Seen;

    fn settings(attach: Attach) -> Attach {
        let participants = vec![Role::Sim];
        Attach { participants, window: WINDOW, frame_capacity: FRAMES, ..attach }
    }

    /// The name that its case book declares: the handshake need not say it.
    fn name<'n>(&'n self, _: &'n BTreeMap<String, String>) -> Option<&'n str> {
        Some(&self.declaration.name)
    }

    fn launch(command: &str, root: &Path) -> anyhow::Result<Launch> {
        let mut launch = Launch::command(Self::ROLE, command)?;
        launch.args.push("serve".into());
        let demonstrations = books_folder(root).join(DEMONSTRATIONS_FILE);
        Ok(launch.with_flags([("--demonstrations", Some(demonstrations.display().to_string()))]))
    }

    /// As in a run: what the case book says. A run that is refused has none.
    fn write_world(root: &Path) -> io::Result<()> {
        match read_demonstrations(root) {
            Some(book) => std::fs::write(root.join(WORLD_FILE), BookFile::new(book.world)?.text),
            None => Ok(()),
        }
    }

    fn introduce(&mut self, folder: &Path, _: &mut Children, _: &Terms<'_>) -> CheckResult<()> {
        self.declaration = read_demonstrations(folder).map(|book| book.world).unwrap_or_default();
        Ok(())
    }

    fn join(attach: &Attach) -> Result<WorldNeighbours, BusError> {
        WorldNeighbours::join(attach)
    }

    fn receive(&mut self, neighbours: &mut WorldNeighbours) -> CheckResult<Vec<(RequestId, Seen)>> {
        // Facts are published before the report that names them, and that is sent before its observation.
        let observations = neighbours.observations.drain()?;
        for report in neighbours.reports.drain()? {
            let StepReport { lane, episode, step, .. } = report;
            self.reports.insert(RequestId { lane, episode, step }, report);
        }
        for note in neighbours.facts.drain()? {
            let bytes = note.bytes.or_else(wrong)?;
            self.facts.insert((note.header.lane, note.header.episode), bytes);
        }
        for view in neighbours.views.drain()? {
            let picture = read_picture(&mut neighbours.frames, view.frame);
            self.views.insert((view.demonstration, view.step), (view.frame, picture));
        }
        let seen = observations.into_iter().map(|observation| {
            let Observation { lane, episode, step, frame, last, .. } = observation;
            let id = RequestId { lane, episode, step };
            let picture = (frame != NO_FRAME).then(|| read_picture(&mut neighbours.frames, frame));
            let facts = (last != 0).then(|| self.facts.remove(&(lane, episode))).flatten();
            (id, Seen { observation, report: self.reports.remove(&id), facts, picture })
        });
        let seen = seen.collect();
        match neighbours.frames.apply_evictions() {
            Ok(_) => Ok(seen),
            Err(error) => wrong(error),
        }
    }

    fn check(&self, id: RequestId, seen: &Seen) -> Result<(), String> {
        let Observation { state, feedback, action, frame, last, .. } = seen.observation;
        self.declaration.read_state(&state).map_err(|foreign| foreign.to_string())?;
        self.declaration.read_feedback(feedback).map_err(|unknown| unknown.to_string())?;
        let commanded = action_code(self.actions.get(&id).copied().flatten());
        if action != commanded {
            return Err(format!("its action is {action}, and the command's {commanded}"));
        }
        let report = seen.report.ok_or("no step report came before it")?;
        let StepReport { sub_goals, required, ended, .. } = report;
        let ended = EpisodeEnd::try_from(ended).map_err(|unknown| unknown.to_string())?;
        if required == 0 || sub_goals > required {
            return Err(format!("{sub_goals} of {required} sub-goals cannot be complete"));
        }
        if (ended == EpisodeEnd::Complete) != (sub_goals == required) {
            let word = ended.word();
            return Err(format!("`ended` is `{word}` with {sub_goals} of {required} sub-goals"));
        }
        let is_over = ended != EpisodeEnd::GoesOn;
        if (last != 0) != is_over {
            return Err(format!("its `last` is {last}, and `ended` is `{}`", ended.word()));
        }
        if (frame == NO_FRAME) != is_over {
            return Err(format!("its frame is {frame}, and its `last` {last}"));
        }
        if report.frame != frame {
            return Err(format!("its frame is {frame}, and the step report's {}", report.frame));
        }
        if is_over {
            let facts = seen.facts.as_ref().ok_or("no facts of the episode came before it")?;
            let facts: Map<String, Value> = serde_json::from_slice(facts)
                .map_err(|error| format!("the facts of the episode are no object: {error}"))?;
            SharedFacts::of(&facts)
                .map_err(|error| format!("the facts of the episode: {error}"))?;
        }
        Ok(())
    }

    /// A world sends no observation for what it cannot execute.
    fn refusal(_: &Seen) -> Option<String> {
        None
    }
}

fn read_demonstrations(root: &Path) -> Option<DemonstrationBook> {
    let file = books_folder(root).join(DEMONSTRATIONS_FILE);
    Some(BookFile::read(&file).ok()?.book)
}

/// Reads the pixels of a frame, which is not kept.
fn read_picture(frames: &mut FrameStore, id: FrameId) -> Picture {
    let frame = match frames.get(id) {
        Ok(Some(frame)) => frame,
        Ok(None) => {
            let problem = Some(format!("frame {id} was not published before it was named"));
            return Picture { hash: None, problem };
        }
        Err(error) => return Picture { hash: None, problem: Some(error.to_string()) },
    };
    let mut hash = [0; 16];
    hash.copy_from_slice(&blake3::hash(frame.pixels()).as_bytes()[..16]);
    let opaque = frame.pixels().as_chunks::<4>().0.iter().all(|pixel| pixel[3] == 255);
    let problem = if hash != frame.content_hash() {
        Some("its content hash is not that of its pixels")
    } else if !opaque {
        Some("it has pixels whose alpha is not 255")
    } else {
        None
    };
    let problem = problem.map(|problem| format!("frame {id}: {problem}"));
    Picture { hash: Some(hash), problem }
}

impl Seen {
    fn ended(&self) -> u8 {
        self.report.map_or(EpisodeEnd::GoesOn as u8, |report| report.ended)
    }

    fn is_last(&self) -> bool {
        self.observation.last != 0
    }

    fn state_hash(&self) -> u64 {
        self.report.map_or(0, |report| report.state_hash)
    }

    fn pixels(&self) -> Option<[u8; 16]> {
        self.picture.as_ref().and_then(|picture| picture.hash)
    }

    /// State, feedback and pixels: what an agent perceives.
    fn perceived(&self) -> ([u32; domain::MAX_STATE], u8, Option<[u8; 16]>) {
        let Observation { state, feedback, .. } = self.observation;
        (state.map(f32::to_bits), feedback, self.pixels())
    }
}

impl Begin {
    fn of(case: usize, reference: &Reference) -> Self {
        let is_blocked = reference.route == Route::Blocked;
        Self { case: case as u32, start: reference.start, is_blocked }
    }

    /// In a sentence.
    fn words(self, facts: &CaseFacts) -> String {
        let Self { start, is_blocked, .. } = self;
        let start = match start {
            Start::Original => "original",
            Start::New => "new",
        };
        let variant = if is_blocked { " of the blocked variant" } else { "" };
        format!("case {} at its {start} start{variant}", facts.id)
    }
}

impl TestedWorld<'_> {
    /// The config of an episode in `lane`, whose earlier one is over. It is not sent.
    fn config(&mut self, lane: u32, begin: Begin, max_steps: u32) -> WorldEpisodeConfig {
        let Begin { case, start, is_blocked } = begin;
        let RequestId { episode, .. } = self.next_episode(lane);
        WorldEpisodeConfig {
            lane,
            episode,
            seed: SEED,
            case,
            variant: if is_blocked { 1 + case } else { 0 },
            start: (start == Start::New).into(),
            max_steps,
            sent_ns: monotonic_ns(),
            ..Zeroable::zeroed()
        }
    }

    /// Begins an episode, in place of that of the lane. Does not notify.
    fn begin(&mut self, lane: u32, begin: Begin, max_steps: u32) -> CheckResult<RequestId> {
        let config = self.config(lane, begin, max_steps);
        let id = RequestId { lane, episode: config.episode, step: 0 };
        self.expect(id);
        self.neighbours.send(&config)?;
        Ok(id)
    }

    /// Begins an episode, and waits for its begin.
    fn begin_and_wait(
        &mut self,
        lane: u32,
        begin: Begin,
        max_steps: u32,
    ) -> CheckResult<(RequestId, Seen)> {
        let id = self.begin(lane, begin, max_steps)?;
        self.wait()?;
        Ok((id, self.answer(id)?))
    }

    /// Takes the step `id`, and waits for what follows.
    fn step(&mut self, id: RequestId, action: Option<ActionCode>) -> CheckResult<Seen> {
        self.role.actions.insert(id, action);
        self.expect(id);
        self.neighbours.send(&command(id, action))?;
        self.wait()?;
        self.answer(id)
    }

    /// Begins an episode and acts until it ends, or there are no more actions. Returns its last step and what was seen.
    fn episode(
        &mut self,
        lane: u32,
        begin: Begin,
        actions: &[ActionCode],
        max_steps: u32,
    ) -> CheckResult<(RequestId, Vec<Seen>)> {
        let (mut id, first) = self.begin_and_wait(lane, begin, max_steps)?;
        let mut seen = vec![first];
        for action in actions {
            if seen.last().is_some_and(Seen::is_last) {
                break;
            }
            id = next(id);
            seen.push(self.step(id, Some(*action))?);
        }
        Ok((id, seen))
    }

    /// Asks for the view of a step of a demonstration as memory does, and releases it.
    fn remembered(&mut self, (demonstration, step): DemonstrationStep) -> CheckResult<Picture> {
        let request = ViewRequest { demonstration, step, ..Zeroable::zeroed() };
        self.neighbours.send(&ViewRequest { kind: ViewRequestKind::Pin as u8, ..request })?;
        self.notify()?;
        self.listen_until(
            self.terms.answer_timeout,
            |subject| subject.role.views.contains_key(&(demonstration, step)),
            |_| format!("no view of step {step} of demonstration {demonstration}"),
        )?;
        let Some((frame, picture)) = self.role.views.remove(&(demonstration, step)) else {
            return wrong("no view");
        };
        let kind = ViewRequestKind::Release as u8;
        self.neighbours.send(&ViewRequest { frame, kind, ..Zeroable::zeroed() })?;
        self.notify()?;
        Ok(picture)
    }
}

/// The command of a step.
fn command(id: RequestId, action: Option<ActionCode>) -> StepCommand {
    let RequestId { lane, episode, step } = id;
    let (kind, action) = match action {
        Some(ActionCode(action)) => (StepKind::Act, action),
        None => (StepKind::Stay, NO_ACTION),
    };
    let sent_ns = monotonic_ns();
    StepCommand { lane, episode, step, kind: kind as u8, action, sent_ns, ..Zeroable::zeroed() }
}
