//! Poses, actions and feedback.
//!
//! The floor is a grid of 1 m cells: `x` grows east, `y` grows north. This module does not know what the cells contain.

use serde::{Deserialize, Serialize};

use crate::{ActionCode, FeedbackCode, State, coded_enum, serde_as_text};

/// A value in a message or file that is not valid.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{value} is not {expected}")]
pub struct UnknownCode {
    /// The value, as text.
    pub value: String,
    /// The accepted values.
    pub expected: &'static str,
}

impl UnknownCode {
    /// An error for `value`, where only `expected` is accepted.
    pub fn new(value: impl ToString, expected: &'static str) -> Self {
        Self { value: value.to_string(), expected }
    }
}

/// A 1 m square of the floor: column `x` counts from the west wall, row `y` from the south wall.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(from = "[u8; 2]", into = "[u8; 2]")]
pub struct Cell {
    /// Column, growing east.
    pub x: u8,
    /// Row, growing north.
    pub y: u8,
}

impl Cell {
    /// The cell in column `x` and row `y`.
    pub const fn new(x: u8, y: u8) -> Self {
        Self { x, y }
    }

    /// The neighbour one cell towards `heading`; `None` past the grid's west or south edge (or past 255).
    pub fn step(self, heading: Heading) -> Option<Self> {
        let (dx, dy) = heading.vector();
        Some(Self { x: self.x.checked_add_signed(dx)?, y: self.y.checked_add_signed(dy)? })
    }

    /// Manhattan distance in cells.
    pub fn distance(self, other: Self) -> u32 {
        u32::from(self.x.abs_diff(other.x)) + u32::from(self.y.abs_diff(other.y))
    }

    /// The cell's centre in metres, (east, north).
    pub fn centre(self) -> (f32, f32) {
        (f32::from(self.x) + 0.5, f32::from(self.y) + 0.5)
    }
}

impl From<[u8; 2]> for Cell {
    fn from([x, y]: [u8; 2]) -> Self {
        Self { x, y }
    }
}

impl From<Cell> for [u8; 2] {
    fn from(cell: Cell) -> Self {
        [cell.x, cell.y]
    }
}

impl std::fmt::Display for Cell {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "({}, {})", self.x, self.y)
    }
}

coded_enum! {
    /// The direction in which an agent faces.
    Heading, "a heading (0 N, 1 E, 2 S, 3 W)";
    #[derive(Serialize, Deserialize)] {
        /// North: `y` grows.
        N = 0,
        /// East: `x` grows.
        E = 1,
        /// South: `y` falls.
        S = 2,
        /// West: `x` falls.
        W = 3,
    }
}

impl Heading {
    /// The unit step (east, north) of this heading.
    pub const fn vector(self) -> (i8, i8) {
        match self {
            Self::N => (0, 1),
            Self::E => (1, 0),
            Self::S => (0, -1),
            Self::W => (-1, 0),
        }
    }

    /// The heading after `quarters` right turns (negative: left turns).
    pub const fn turned(self, quarters: i8) -> Self {
        Self::ALL[(self as i8 + quarters).rem_euclid(4) as usize]
    }

    /// A quarter turn clockwise.
    pub const fn right(self) -> Self {
        self.turned(1)
    }

    /// A quarter turn anticlockwise.
    pub const fn left(self) -> Self {
        self.turned(-1)
    }

    /// The opposite heading.
    pub const fn opposite(self) -> Self {
        self.turned(2)
    }

    /// Right turns from here to `other`: 0 to 3.
    pub fn quarters_to(self, other: Self) -> i8 {
        (other as i8 - self as i8).rem_euclid(4)
    }

    /// The full English word, in lower case.
    pub const fn word(self) -> &'static str {
        match self {
            Self::N => "north",
            Self::E => "east",
            Self::S => "south",
            Self::W => "west",
        }
    }

    /// The letter used in files: `N`, `E`, `S` or `W`.
    pub const fn letter(self) -> char {
        match self {
            Self::N => 'N',
            Self::E => 'E',
            Self::S => 'S',
            Self::W => 'W',
        }
    }
}

impl std::fmt::Display for Heading {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.letter())
    }
}

impl std::str::FromStr for Heading {
    type Err = UnknownCode;

    fn from_str(text: &str) -> Result<Self, UnknownCode> {
        let heading = Self::ALL.into_iter().find(|h| {
            text.eq_ignore_ascii_case(h.word())
                || text.eq_ignore_ascii_case(h.letter().encode_utf8(&mut [0; 4]))
        });
        heading.ok_or_else(|| UnknownCode::new(text, "a heading (N, E, S or W)"))
    }
}

/// A cell and a heading. Written `x,y,H`, for example `3,12,N`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Pose {
    /// The cell.
    pub cell: Cell,
    /// The heading.
    pub heading: Heading,
}

impl Pose {
    /// The pose in column `x` and row `y`, facing `heading`.
    pub const fn new(x: u8, y: u8, heading: Heading) -> Self {
        Self { cell: Cell::new(x, y), heading }
    }

    /// The cell `ahead` cells ahead and `right` cells to the right; `None` off the grid.
    pub fn cell_at(self, ahead: i8, right: i8) -> Option<Cell> {
        let (along, across) = (self.heading.vector(), self.heading.right().vector());
        let moved = |from: u8, along: i8, across: i8| {
            let offset = i16::from(along) * i16::from(ahead) + i16::from(across) * i16::from(right);
            u8::try_from(i16::from(from) + offset).ok()
        };
        Some(Cell::new(
            moved(self.cell.x, along.0, across.0)?,
            moved(self.cell.y, along.1, across.1)?,
        ))
    }

    /// The offset of a cell: cells ahead, and cells to the right.
    pub fn offset_of(self, cell: Cell) -> (i16, i16) {
        let (along, across) = (self.heading.vector(), self.heading.right().vector());
        let (dx, dy) = (
            i16::from(cell.x) - i16::from(self.cell.x),
            i16::from(cell.y) - i16::from(self.cell.y),
        );
        let in_direction = |(x, y): (i8, i8)| dx * i16::from(x) + dy * i16::from(y);
        (in_direction(along), in_direction(across))
    }
}

impl std::fmt::Display for Pose {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{},{},{}", self.cell.x, self.cell.y, self.heading)
    }
}

impl std::str::FromStr for Pose {
    type Err = UnknownCode;

    fn from_str(text: &str) -> Result<Self, UnknownCode> {
        let unknown = || UnknownCode::new(text, "a pose (column,row,heading; for example 3,12,N)");
        let mut parts = text.split(',').map(str::trim);
        let (Some(x), Some(y), Some(heading), None) =
            (parts.next(), parts.next(), parts.next(), parts.next())
        else {
            return Err(unknown());
        };
        Ok(Self {
            cell: Cell {
                x: x.parse().map_err(|_| unknown())?,
                y: y.parse().map_err(|_| unknown())?,
            },
            heading: heading.parse().map_err(|_| unknown())?,
        })
    }
}

serde_as_text!(Pose);

/// Column, row and the heading's code.
impl From<Pose> for State {
    fn from(Pose { cell, heading }: Pose) -> Self {
        let numbers = [cell.x, cell.y, heading as u8].map(f32::from);
        Self::new(&numbers).expect("three small numbers are a state")
    }
}

impl TryFrom<State> for Pose {
    type Error = UnknownCode;

    fn try_from(state: State) -> Result<Self, UnknownCode> {
        let unknown = || UnknownCode::new(state, "a pose (column, row, heading)");
        let &[x, y, heading] = state.numbers() else { return Err(unknown()) };
        let whole = |number: f32| {
            let is_whole = number.fract() == 0.0 && (0.0..=255.0).contains(&number);
            is_whole.then_some(number as u8).ok_or_else(unknown)
        };
        Ok(Self::new(whole(x)?, whole(y)?, Heading::try_from(whole(heading)?)?))
    }
}

coded_enum! {
    /// What an agent can do in one step: seven actions (specification, section 2).
    Action, "an action (0 to 6)"; {
        /// One cell along the heading.
        Forward = 0,
        /// One cell against the heading, still facing it.
        Backward = 1,
        /// One cell to the left, heading kept.
        Left = 2,
        /// One cell to the right, heading kept.
        Right = 3,
        /// A quarter turn anticlockwise in place.
        TurnLeft = 4,
        /// A quarter turn clockwise in place.
        TurnRight = 5,
        /// A half turn in place.
        TurnAround = 6,
    }
}

impl Action {
    /// The words for it in prompts and answers.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Forward => "move forward",
            Self::Backward => "move backward",
            Self::Left => "move left",
            Self::Right => "move right",
            Self::TurnLeft => "turn left",
            Self::TurnRight => "turn right",
            Self::TurnAround => "turn around",
        }
    }

    /// The letter used in files: moves `f b l r`, turns `L R U`.
    pub const fn letter(self) -> char {
        match self {
            Self::Forward => 'f',
            Self::Backward => 'b',
            Self::Left => 'l',
            Self::Right => 'r',
            Self::TurnLeft => 'L',
            Self::TurnRight => 'R',
            Self::TurnAround => 'U',
        }
    }

    /// The action with this letter.
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL.into_iter().find(|action| action.letter() == letter)
    }

    /// For a move: right turns from the heading to its direction. `None` for a turn.
    pub const fn move_direction(self) -> Option<i8> {
        match self {
            Self::Forward => Some(0),
            Self::Right => Some(1),
            Self::Backward => Some(2),
            Self::Left => Some(3),
            Self::TurnLeft | Self::TurnRight | Self::TurnAround => None,
        }
    }

    /// For a turn: its right turns. `None` for a move.
    pub const fn turn_quarters(self) -> Option<i8> {
        match self {
            Self::TurnRight => Some(1),
            Self::TurnAround => Some(2),
            Self::TurnLeft => Some(3),
            Self::Forward | Self::Backward | Self::Left | Self::Right => None,
        }
    }
}

coded_enum! {
    /// The response of the world to an action. It never says that a target was reached.
    Feedback, "a feedback (0 to 4)"; {
        /// There was no action yet.
        Start = 0,
        /// The move succeeded.
        Moved = 1,
        /// The turn succeeded (turns always do).
        Turned = 2,
        /// An obstacle blocked the move: the agent did not move, and the step counts.
        Blocked = 3,
        /// The policy's answer could not be read: the agent did not move, and the step counts.
        NotUnderstood = 4,
    }
}

impl From<Action> for ActionCode {
    fn from(action: Action) -> Self {
        Self(action as u8)
    }
}

impl TryFrom<ActionCode> for Action {
    type Error = UnknownCode;

    fn try_from(ActionCode(code): ActionCode) -> Result<Self, UnknownCode> {
        Self::try_from(code)
    }
}

impl From<Feedback> for FeedbackCode {
    fn from(feedback: Feedback) -> Self {
        Self(feedback as u8)
    }
}

impl TryFrom<FeedbackCode> for Feedback {
    type Error = UnknownCode;

    fn try_from(FeedbackCode(code): FeedbackCode) -> Result<Self, UnknownCode> {
        Self::try_from(code)
    }
}

impl Feedback {
    /// The sentence for it in prompts.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Start => "The episode has just begun.",
            Self::Moved => "You moved.",
            Self::Turned => "You turned.",
            Self::Blocked => "Something blocks the way: you did not move.",
            Self::NotUnderstood => "Your last answer was not understood: you did not move.",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_and_offsets_are_each_other_s_inverse() {
        for heading in Heading::ALL {
            let pose = Pose::new(20, 30, heading);
            for (ahead, right) in [(0, 0), (3, 1), (-2, 4), (5, -6)] {
                let cell = pose.cell_at(ahead, right).unwrap();
                assert_eq!(pose.offset_of(cell), (i16::from(ahead), i16::from(right)));
            }
        }
        assert_eq!(Pose::new(5, 5, Heading::W).cell_at(3, 1), Some(Cell::new(2, 6)));
        assert_eq!(Pose::new(5, 5, Heading::W).cell_at(6, 0), None);
    }

    #[test]
    fn a_pose_is_a_state_of_three_numbers() {
        for heading in Heading::ALL {
            let pose = Pose::new(3, 255, heading);
            assert_eq!(State::from(pose).numbers(), [3.0, 255.0, f32::from(heading as u8)]);
            assert_eq!(Pose::try_from(State::from(pose)), Ok(pose));
        }
        for numbers in [&[3.0, 12.0][..], &[3.0, 12.0, 4.0], &[3.5, 12.0, 0.0], &[-1.0, 0.0, 0.0]] {
            assert!(Pose::try_from(State::new(numbers).unwrap()).is_err(), "{numbers:?}");
        }
    }

    #[test]
    fn headings_turn_clockwise_and_step_by_their_vector() {
        assert_eq!(Heading::N.right(), Heading::E);
        assert_eq!(Heading::N.left(), Heading::W);
        assert_eq!(Heading::E.opposite(), Heading::W);
        assert_eq!(Cell::new(3, 4).step(Heading::S), Some(Cell::new(3, 3)));
        assert_eq!(Cell::new(0, 4).step(Heading::W), None);
    }

    #[test]
    fn codes_and_letters_are_positions_in_all() {
        for (code, action) in Action::ALL.into_iter().enumerate() {
            assert_eq!(action as usize, code);
            assert_eq!(Action::try_from(code as u8), Ok(action));
            assert_eq!(Action::from_letter(action.letter()), Some(action));
            assert_ne!(action.move_direction().is_some(), action.turn_quarters().is_some());
        }
        assert!(Action::try_from(7).is_err());
        assert!(Heading::try_from(4).is_err());
        assert!(Feedback::try_from(5).is_err());
    }

    #[test]
    fn poses_are_written_as_column_row_heading() {
        let pose = Pose::new(3, 12, Heading::N);
        assert_eq!(pose.to_string(), "3,12,N");
        assert_eq!(" 3, 12, north".parse(), Ok(pose));
        for bad in ["", "3,12", "3,12,Q", "300,1,N", "1,2,N,4"] {
            let error = bad.parse::<Pose>().unwrap_err();
            assert!(error.to_string().contains("a pose (column,row,heading"), "{error}");
        }
    }
}
