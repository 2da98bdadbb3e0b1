//! A world for tests with one fault, named by its first argument; `well-behaved` has none, and `random` says that it is not
//! deterministic.
//!
//! A corridor of ten rooms, in which one walks to a goal. Faults of a simulator are committed by its environment; those that the
//! SDK prevents, by a [`World`] around that of the SDK.
//!
//! Drills have it commit one of the [`STRAY_FAULTS`] once in a run: `MISBEHAVE_FAULT` names it, `MISBEHAVE_STEP` says at which
//! command of a process, and the file `MISBEHAVE_TOKEN` that it was committed.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::rc::Rc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, bail, ensure};
use bytemuck::Zeroable;
use case_book::{BookFile, CASE_BOOK_FILE, DEMONSTRATIONS_FILE, DemonstrationBook, TaskFacts};
use memtransfer_tests::STRAY_FAULTS;
use peer::world::{
    CaseDeclaration, Environment, EnvironmentView, EpisodeBegin, Moment, Observed, Refusal,
    SimulatedWorld, Simulator, TrajectoryName, World, WorldFailure, program, serve_generation,
    serve_world,
};
use peer::{ActionCode, ActionDeclaration, FeedbackCode, State, StateField, WorldDeclaration};
use serde_json::Value;
use shm_types::message::{
    EpisodeEnd, Observation, Role, StepCommand, StepKind, StepReport, ViewRequest,
    WorldEpisodeConfig,
};
use shm_types::process::die_with_parent;
use shm_types::{ATTACH_VARIABLE, Attach, Bus, Sender};

const ROOMS: usize = 10;
const EAST: u8 = 0;
const OPEN: u8 = 1;

/// The rooms in which each case begins, originally and when it is tested. Its goal is the last room.
const CASES: [(usize, usize); 3] = [(0, 3), (1, 4), (2, 5)];

/// The door where the way is blocked.
const DOOR: usize = ROOMS - 2;

/// Observations of a flood: more than any queue holds.
const FLOOD: usize = 10_000;

/// Numbers what must not be the same twice.
static COUNTER: AtomicU64 = AtomicU64::new(1);

fn main() -> ExitCode {
    match use_world() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error:#}");
            ExitCode::FAILURE
        }
    }
}

fn use_world() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (fault, rest) = arguments.split_first().context("usage: misbehaving-world FAULT VERB")?;
    let verb = rest.first().context("usage: misbehaving-world FAULT VERB")?;
    let version = match fault.as_str() {
        "another-book" => SystemTime::now().duration_since(UNIX_EPOCH)?.as_nanos(),
        _ => 1,
    };
    let mode = Rc::new(Mode { fault: fault.clone(), verb: verb.clone(), version });
    match (verb.as_str(), fault.as_str()) {
        ("book", "no-book") => bail!("I cannot write"),
        ("act", "acts-nothing") => Ok(()),
        ("book", _) => {
            run(&mode, rest)?;
            spoil(fault, Path::new(rest.last().context("--out")?))
        }
        ("serve", "no-handshake") => sleep_forever(),
        ("serve", _) => {
            let served = serve(&mode, Path::new(rest.last().context("--demonstrations")?));
            match fault.as_str() {
                "ignores-stop" | "outlives" | "ignores-the-wire-version" => sleep_forever(),
                _ => served,
            }
        }
        _ => run(&mode, rest),
    }
}

fn run(mode: &Rc<Mode>, arguments: &[String]) -> anyhow::Result<()> {
    program::run(&Corridors(Rc::clone(mode)), arguments).map_err(anyhow::Error::from_boxed)
}

fn sleep_forever() -> ! {
    loop {
        thread::sleep(Duration::from_secs(60));
    }
}

/// Spoils a case book.
fn spoil(fault: &str, folder: &Path) -> anyhow::Result<()> {
    let change = |name: &str, change: &dyn Fn(&mut Value)| {
        let path = folder.join(name);
        let mut book: Value = serde_json::from_str(&fs::read_to_string(&path)?)?;
        change(&mut book);
        anyhow::Ok(fs::write(path, book.to_string())?)
    };
    match fault {
        "no-new" => change(CASE_BOOK_FILE, &|book| {
            book["cases"][0]["references"].as_array_mut().map(|references| references.remove(1));
        }),
        "case-twice" => change(CASE_BOOK_FILE, &|book| {
            let first = book["cases"][0].clone();
            book["cases"].as_array_mut().into_iter().for_each(|cases| cases.push(first.clone()));
        }),
        "lacks-feedback" => change(DEMONSTRATIONS_FILE, &|book| {
            book["demonstrations"][0]["feedback"].as_array_mut().map(Vec::pop);
        }),
        _ => Ok(()),
    }
}

fn serve(mode: &Rc<Mode>, demonstrations: &Path) -> anyhow::Result<()> {
    let folder = PathBuf::from(std::env::var_os(ATTACH_VARIABLE).context(ATTACH_VARIABLE)?);
    let lock = folder.join("my.lock");
    if mode.has("leaves-a-lock") {
        fs::File::create_new(&lock).context("I run already")?;
    }
    let simulator = Corridors(Rc::clone(mode));
    let demonstrations = BookFile::<DemonstrationBook>::read(demonstrations)?.book;
    let world = |attach: &Attach, stray| {
        let inner = SimulatedWorld::new(&simulator, attach, demonstrations.clone())?;
        Ok::<_, WorldFailure>(FaultyWorld { mode, inner, lanes: BTreeMap::new(), stray })
    };
    if let Some(fault) = StrayFault::of_environment()? {
        return serve_once(&folder, fault, world);
    }
    let open = |world: &mut FaultyWorld<'_>, attach: &Attach| world.inner.rendering(attach);
    serve_world(&folder, false, |attach| world(attach, None), open)?;
    if mode.has("leaves-a-lock") {
        fs::remove_file(lock)?;
    }
    Ok(())
}

/// Serves in one generation, as the orchestrator starts a world for each.
fn serve_once<'s>(
    folder: &Path,
    fault: StrayFault,
    world: impl Fn(&Attach, Option<(StrayFault, Stray)>) -> Result<FaultyWorld<'s>, WorldFailure>,
) -> anyhow::Result<()> {
    let attach = Attach::read(folder)?;
    die_with_parent(attach.orchestrator_pid)?;
    let mut joined = attach.clone();
    if fault.name == "another-size" && fault.is_due() {
        fault.commit()?;
        joined.frame.height /= 2;
    }
    let bus = Bus::join(joined, Role::Sim)?;
    let stray = Stray { observations: bus.sender()?, reports: bus.sender()?, lanes: attach.lanes };
    let mut world = world(&attach, Some((fault, stray))).map_err(anyhow::Error::from_boxed)?;
    Ok(serve_generation(&bus, &mut world, false, |world| world.inner.rendering(bus.attach()))?)
}

/// A fault that is committed once in a run.
struct StrayFault {
    name: String,
    /// Commands before it.
    left: u32,
    token: PathBuf,
}

/// What an SDK would not let a world send.
struct Stray {
    observations: Sender<Observation>,
    reports: Sender<StepReport>,
    lanes: u32,
}

impl StrayFault {
    fn of_environment() -> anyhow::Result<Option<Self>> {
        let Ok(name) = std::env::var("MISBEHAVE_FAULT") else { return Ok(None) };
        ensure!(STRAY_FAULTS.contains(&name.as_str()), "there is no fault {name}");
        let left = std::env::var("MISBEHAVE_STEP")?.parse()?;
        let token = std::env::var_os("MISBEHAVE_TOKEN").context("MISBEHAVE_TOKEN")?.into();
        Ok(Some(Self { name, left, token }))
    }

    /// Whether it was not committed yet.
    fn is_due(&self) -> bool {
        !self.token.exists()
    }

    fn commit(&self) -> io::Result<()> {
        fs::write(&self.token, &self.name)
    }
}

impl Stray {
    /// Commits `fault` in place of the answer to `command`, which would be `moment`. Returns whether that is sent, too.
    fn send(
        &self,
        fault: &str,
        command: &StepCommand,
        moment: &Moment<EnvironmentView>,
    ) -> Result<bool, WorldFailure> {
        let &StepCommand { episode, lane, step, sent_ns, .. } = command;
        let mut report = StepReport {
            episode,
            lane,
            step,
            commanded_ns: sent_ns,
            woken_ns: sent_ns,
            required: 1,
            ..Zeroable::zeroed()
        };
        let mut observation = Observation {
            episode,
            lane,
            step,
            state: moment.state.padded(),
            feedback: moment.feedback.0,
            action: command.action,
            ..Zeroable::zeroed()
        };
        match fault {
            "exits" => std::process::exit(3),
            "hangs" => sleep_forever(),
            "floods" => {
                // Until the queue is full.
                (0..FLOOD).try_for_each(|_| self.observations.send(&observation))?;
                return Ok(true);
            }
            "another-lane" => (observation.lane, report.lane) = ((lane + 1) % self.lanes, lane),
            "no-such-lane" => (observation.lane, report.lane) = (self.lanes, self.lanes),
            "nan-state" => observation.state[0] = f32::NAN,
            "unknown-feedback" => observation.feedback = 200,
            "unknown-ending" => report.ended = 9,
            "two-ends" => {
                report.ended = EpisodeEnd::StepLimit as u8;
                observation.last = 1;
                self.reports.send(&report)?;
                self.observations.send(&observation)?;
            }
            _ => observation.frame = 12345,
        }
        self.reports.send(&report)?;
        self.observations.send(&observation)?;
        Ok(fault == "two-ends")
    }
}

/// The fault, and what the program is used for.
struct Mode {
    fault: String,
    verb: String,
    version: u128,
}

impl Mode {
    fn has(&self, fault: &str) -> bool {
        self.fault == fault
    }

    /// Whether the fault is `fault`, which is committed in runs alone.
    fn serves_with(&self, fault: &str) -> bool {
        self.verb == "serve" && self.has(fault)
    }

    fn is_random(&self) -> bool {
        self.verb == "serve" && (self.has("draws") || self.has("random"))
    }
}

/// The SDK's world, with faults that it would not have.
struct FaultyWorld<'s> {
    mode: &'s Mode,
    inner: SimulatedWorld<'s, Corridors>,
    /// By lane: the episode, its last step and what followed from that.
    lanes: BTreeMap<u32, (u64, u32, Moment<EnvironmentView>)>,
    /// What it does once.
    stray: Option<(StrayFault, Stray)>,
}

impl FaultyWorld<'_> {
    /// Whether `moment` is the answer to `command`: at one command another one is sent in its place.
    fn is_answered(
        &mut self,
        command: &StepCommand,
        moment: &Moment<EnvironmentView>,
    ) -> Result<bool, WorldFailure> {
        let Some((fault, stray)) = &mut self.stray else { return Ok(true) };
        fault.left = fault.left.saturating_sub(1);
        if fault.left > 0 || !fault.is_due() {
            return Ok(true);
        }
        fault.commit()?;
        stray.send(&fault.name, command, moment)
    }

    fn refused(&self, refusal: Refusal) -> Result<(), Refusal> {
        match refusal {
            Refusal::Message(_) if self.mode.has("silent") => Ok(()),
            Refusal::Message(problem) if self.mode.has("gives-up") => {
                Err(Refusal::Episode(problem))
            }
            refusal => Err(refusal),
        }
    }
}

impl World for FaultyWorld<'_> {
    type View = EnvironmentView;
    type Picture = EnvironmentView;

    fn begin(&mut self, config: &WorldEpisodeConfig) -> Result<Moment<EnvironmentView>, Refusal> {
        let max_steps = if self.mode.has("no-limit") { 1000 } else { config.max_steps };
        match self.inner.begin(&WorldEpisodeConfig { max_steps, ..*config }) {
            Ok(moment) => {
                self.lanes.insert(config.lane, (config.episode, 0, moment.clone()));
                Ok(moment)
            }
            Err(refusal) => {
                self.refused(refusal.clone())?;
                Err(refusal)
            }
        }
    }

    fn apply(&mut self, command: &StepCommand) -> Result<Option<Moment<EnvironmentView>>, Refusal> {
        let mut command = *command;
        let last = self.lanes.get(&command.lane).cloned();
        if let Some((episode, step, last)) = &last
            && *episode == command.episode
        {
            if last.ended != EpisodeEnd::GoesOn && self.mode.has("resets") {
                let goes_on = EpisodeEnd::GoesOn;
                return Ok(Some(Moment { ended: goes_on, facts: None, ..last.clone() }));
            }
            if self.mode.has("believes") {
                command.step = step + 1;
            }
        }
        let stays = command.kind == StepKind::Stay as u8;
        if stays && self.mode.has("walks-on") {
            (command.kind, command.action) = (StepKind::Act as u8, EAST);
        }
        match self.inner.apply(&command) {
            Ok(moment) => {
                let moment = moment.map(|moment| match stays {
                    true => Moment { action: None, feedback: FeedbackCode(3), ..moment },
                    false => moment,
                });
                let Some(moment) = moment else { return Ok(None) };
                let now = (command.episode, command.step, moment.clone());
                self.lanes.insert(command.lane, now);
                // What cannot be sent is a fault as well.
                let is_answered = self.is_answered(&command, &moment).unwrap_or(true);
                Ok(is_answered.then_some(moment))
            }
            Err(refusal) => self.refused(refusal).map(|()| None),
        }
    }

    fn remembered(&mut self, request: &ViewRequest) -> Result<EnvironmentView, String> {
        let step = if self.mode.has("other-views") { 0 } else { request.step };
        self.inner.remembered(&ViewRequest { step, ..*request })
    }

    fn picture(&self, view: EnvironmentView) -> EnvironmentView {
        self.inner.picture(view)
    }
}

struct Corridors(Rc<Mode>);

impl Simulator for Corridors {
    fn declaration(&self) -> WorldDeclaration {
        let action =
            |(letter, words): (char, &str)| ActionDeclaration { letter, words: words.to_owned() };
        let sentences = ["It begins.", "Done.", "Nothing happened.", "Not understood."];
        WorldDeclaration {
            name: "corridor".to_owned(),
            version: self.0.version.to_string(),
            rules: "You are in a corridor.".to_owned(),
            actions: [('e', "walk east"), ('o', "open the door")].map(action).to_vec(),
            state: vec![StateField { name: "room".to_owned(), words: Vec::new(), digits: 0 }],
            state_sentence: "You are in room {room}.".to_owned(),
            feedback: sentences.map(str::to_owned).to_vec(),
            is_deterministic: !self.0.has("random"),
        }
    }

    fn tasks(&self) -> Vec<TaskFacts> {
        vec![TaskFacts { number: 1, name: "eastwards".to_owned(), group: "walking".to_owned() }]
    }

    fn cases(&self) -> Result<Vec<CaseDeclaration>, WorldFailure> {
        let way = |from: usize| vec![ActionCode(EAST); ROOMS - 1 - from];
        let case = |(index, (original, new)): (usize, (usize, usize))| {
            let mut blocked = way(new);
            blocked.insert(DOOR - 1 - new, ActionCode(OPEN));
            CaseDeclaration {
                id: format!("corridor-{}", index + 1),
                task: 1,
                instruction: "Walk to the last room.".to_owned(),
                trajectories: BTreeMap::from([
                    (TrajectoryName::Original, way(original)),
                    (TrajectoryName::New, way(new)),
                    (TrajectoryName::Blocked, blocked),
                ]),
                ..CaseDeclaration::default()
            }
        };
        Ok(CASES.into_iter().enumerate().map(case).collect())
    }

    fn environment(&self) -> Result<Box<dyn Environment>, WorldFailure> {
        Ok(Box::new(Corridor { mode: Rc::clone(&self.0), agent: 0, is_shut: false, shade: 0 }))
    }
}

struct Corridor {
    mode: Rc<Mode>,
    agent: usize,
    is_shut: bool,
    /// Drawn at random by a world that draws.
    shade: u8,
}

impl Corridor {
    fn observed(&self, feedback: u8, conflict: bool) -> Observed {
        let Self { mode, agent, is_shut, .. } = self;
        let acts_otherwise = mode.verb == "act" && mode.has("acts-otherwise");
        let room = *agent as f32 + if acts_otherwise { 0.5 } else { 0.0 };
        let goal = if mode.serves_with("early") { ROOMS - 2 } else { ROOMS - 1 };
        let is_complete = *agent >= goal && !mode.serves_with("never-completes");
        let hash = (2 * agent + usize::from(*is_shut)) as u64;
        Observed {
            state: State::new(&[room]).unwrap_or_default(),
            feedback: FeedbackCode(feedback),
            sub_goals: u32::from(is_complete),
            required: 1,
            has_failed: false,
            conflict,
            state_hash: match mode.serves_with("other-hashes") {
                true => Some(COUNTER.fetch_add(1, Ordering::Relaxed)),
                false => (!mode.is_random()).then_some(hash),
            },
        }
    }
}

impl Environment for Corridor {
    fn reset(&mut self, begin: &EpisodeBegin<'_>) -> Result<Observed, WorldFailure> {
        let number = begin.case.id.bytes().last().map_or(0, |digit| usize::from(digit - b'1'));
        let (original, new) = CASES[number];
        self.agent = if begin.start == TrajectoryName::New { new } else { original };
        self.agent += usize::from(self.mode.serves_with("begins-elsewhere"));
        self.is_shut = begin.is_blocked && !self.mode.serves_with("never-blocks");
        if self.mode.is_random() {
            self.shade = COUNTER.fetch_add(1, Ordering::Relaxed) as u8;
        }
        Ok(self.observed(0, false))
    }

    fn step(&mut self, ActionCode(action): ActionCode) -> Result<Observed, WorldFailure> {
        if action == OPEN {
            let opens = self.is_shut && self.agent + 1 == DOOR;
            self.is_shut &= !opens;
            return Ok(self.observed(if opens { 1 } else { 2 }, false));
        }
        let conflict = self.is_shut && self.agent + 1 == DOOR;
        let moves = self.agent + 1 < ROOMS && !conflict;
        self.agent += usize::from(moves);
        Ok(self.observed(if moves { 1 } else { 2 }, conflict))
    }

    fn render(&mut self, _: u32, _: u32, pixels: &mut [u8]) -> Result<(), WorldFailure> {
        let alpha = if self.mode.has("transparent") { 254 } else { 255 };
        let shade = if self.mode.has("still") { 0 } else { 20 * self.agent as u8 };
        let colour = [shade, self.shade, 100 * u8::from(self.is_shut), alpha];
        pixels.as_chunks_mut::<4>().0.fill(colour);
        Ok(())
    }
}
