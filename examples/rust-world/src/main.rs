//! A corridor of ten rooms in a row: a world of one's own in Rust.
//!
//! `memtransfer run --world-cmd ./target/release/rust-world --policy imitate --memory episodic` evaluates in it.

use std::collections::BTreeMap;
use std::process::ExitCode;

use peer::world::{
    CaseDeclaration, Environment, EpisodeBegin, Observed, Simulator, TaskFacts, TrajectoryName,
    WorldFailure, program,
};
use peer::{ActionCode, ActionDeclaration, FeedbackCode, State, StateField, WorldDeclaration};

const ROOMS: usize = 10;
const EAST: u8 = 0;
const WEST: u8 = 1;
const OPEN: u8 = 2;

/// The begin of each case: where its demonstration starts, where it is tested, where its goal is.
const CASES: [(usize, usize, usize); 4] = [(0, 3, 6), (1, 4, 8), (9, 7, 2), (8, 5, 1)];

/// The corridor with the agent, and a door beside the goal that is shut where the way is blocked.
#[derive(Default)]
struct Corridor {
    agent: usize,
    goal: usize,
    door: Option<usize>,
}

impl Corridor {
    fn observed(&self, feedback: FeedbackCode, conflict: bool) -> Observed {
        let numbers = [self.agent as f32];
        let door = self.door.map_or(0, |door| 1 + door);
        Observed {
            state: State::new(&numbers).expect("one number is a state"),
            feedback,
            sub_goals: u32::from(self.agent == self.goal),
            required: 1,
            has_failed: false,
            conflict,
            state_hash: Some((self.agent + 100 * self.goal + 10_000 * door) as u64),
        }
    }
}

/// The rooms of case number `index`, and where its door is: just before the goal.
fn rooms(index: usize) -> (usize, usize, usize, usize) {
    let (original, new, goal) = CASES[index];
    (original, new, goal, if new < goal { goal - 1 } else { goal + 1 })
}

fn number(id: &str) -> usize {
    id.bytes().last().map_or(0, |digit| usize::from(digit - b'1'))
}

impl Environment for Corridor {
    fn reset(&mut self, begin: &EpisodeBegin<'_>) -> Result<Observed, WorldFailure> {
        let (original, new, goal, door) = rooms(number(&begin.case.id));
        let agent = if begin.start == TrajectoryName::New { new } else { original };
        *self = Self { agent, goal, door: begin.is_blocked.then_some(door) };
        Ok(self.observed(FeedbackCode::START, false))
    }

    fn step(&mut self, ActionCode(action): ActionCode) -> Result<Observed, WorldFailure> {
        if action == OPEN {
            let next_to = self.door.filter(|door| door.abs_diff(self.agent) == 1);
            self.door = self.door.filter(|_| next_to.is_none());
            return Ok(self.observed(FeedbackCode(if next_to.is_some() { 1 } else { 2 }), false));
        }
        let next = match action {
            EAST => self.agent + 1,
            _ => self.agent.checked_sub(1).unwrap_or(ROOMS),
        };
        let is_shut = self.door == Some(next);
        let moves = next < ROOMS && !is_shut;
        if moves {
            self.agent = next;
        }
        Ok(self.observed(FeedbackCode(if moves { 1 } else { 2 }), is_shut))
    }

    fn render(&mut self, width: u32, height: u32, pixels: &mut [u8]) -> Result<(), WorldFailure> {
        // The agent sees the colour of its room, the goal's mark in the upper half, and a shut door at the side.
        let shade = (25 * self.agent) as u8;
        let door = self.door.map(|door| (door > self.agent, door.abs_diff(self.agent)));
        for (index, pixel) in pixels.as_chunks_mut::<4>().0.iter_mut().enumerate() {
            let (column, row) = (index as u32 % width, index as u32 / width);
            let is_mark = row < height / 2 && self.agent == self.goal;
            let is_door = door.is_some_and(|(east, distance)| {
                distance == 1 && if east { column > width * 3 / 4 } else { column < width / 4 }
            });
            *pixel = match (is_mark, is_door) {
                (true, _) => [255, 215, 0, 255],
                (_, true) => [120, 60, 20, 255],
                _ => [shade, 255 - shade, 90, 255],
            };
        }
        Ok(())
    }
}

/// The actions from one room to the goal; at a door, the expert opens it.
fn way(from: usize, goal: usize, door: Option<usize>) -> Vec<ActionCode> {
    let (step, rooms): (u8, Vec<usize>) =
        if from < goal { (EAST, (from + 1..=goal).collect()) } else { (WEST, (goal..from).rev().collect()) };
    let actions = rooms.into_iter().flat_map(|room| match door == Some(room) {
        true => vec![OPEN, step],
        false => vec![step],
    });
    actions.map(ActionCode).collect()
}

struct Corridors;

impl Simulator for Corridors {
    fn declaration(&self) -> WorldDeclaration {
        let action = |(letter, words): (char, &str)| ActionDeclaration { letter, words: words.to_owned() };
        let sentences = [
            "The episode has just begun.",
            "Done.",
            "Nothing happened.",
            "Your last answer was not understood: nothing happened.",
        ];
        WorldDeclaration {
            name: "corridor".to_owned(),
            version: "1".to_owned(),
            rules: "You are in a corridor of ten rooms in a row, and see the colour of yours. You walk to the room with the golden \
                    mark. A door may be shut: open it from the room beside it."
                .to_owned(),
            actions: [('e', "walk east"), ('w', "walk west"), ('o', "open the door")].map(action).to_vec(),
            state: vec![StateField { name: "room".to_owned(), words: Vec::new(), digits: 0 }],
            state_sentence: "You are in room {room}.".to_owned(),
            feedback: sentences.map(str::to_owned).to_vec(),
            is_deterministic: true,
        }
    }

    fn tasks(&self) -> Vec<TaskFacts> {
        let task = |(number, name): (u8, &str)| TaskFacts {
            number,
            name: name.to_owned(),
            group: "walking".to_owned(),
        };
        [(1, "eastwards"), (2, "westwards")].map(task).to_vec()
    }

    fn cases(&self) -> Result<Vec<CaseDeclaration>, WorldFailure> {
        let case = |index: usize| {
            let (original, new, goal, door) = rooms(index);
            CaseDeclaration {
                id: format!("corridor-{}", index + 1),
                task: if original < goal { 1 } else { 2 },
                instruction: "Walk to the room with the golden mark.".to_owned(),
                trajectories: BTreeMap::from([
                    (TrajectoryName::Original, way(original, goal, None)),
                    (TrajectoryName::New, way(new, goal, None)),
                    (TrajectoryName::Blocked, way(new, goal, Some(door))),
                ]),
                ..CaseDeclaration::default()
            }
        };
        Ok((0..CASES.len()).map(case).collect())
    }

    fn environment(&self) -> Result<Box<dyn Environment>, WorldFailure> {
        Ok(Box::<Corridor>::default())
    }
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match program::run(&Corridors, &arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("{failure}");
            ExitCode::FAILURE
        }
    }
}
