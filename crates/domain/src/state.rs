//! The values of any world: states, actions and feedback. What they mean is in the world's declaration.

use serde::{Deserialize, Serialize};

/// Most numbers of a state.
pub const MAX_STATE: usize = 16;

/// Most actions of a world.
pub const MAX_ACTIONS: usize = 64;

/// The state of an agent: numbers whose meaning the world declares, in the order of its declaration. None is NaN or infinite.
#[derive(Clone, Copy, Default, Serialize, Deserialize)]
#[serde(try_from = "Vec<f32>", into = "Vec<f32>")]
pub struct State {
    numbers: [f32; MAX_STATE],
    length: u8,
}

/// Numbers that are no state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum InvalidState {
    /// There are too many.
    #[error("a state has at most {MAX_STATE} numbers, and this one has {0}")]
    TooLong(usize),
    /// One is not finite.
    #[error("number {0} of a state is not finite")]
    NotFinite(usize),
}

impl State {
    /// The state of these numbers.
    ///
    /// # Errors
    /// When there are more than [`MAX_STATE`], or one is NaN or infinite.
    pub fn new(numbers: &[f32]) -> Result<Self, InvalidState> {
        let mut of = Self { numbers: [0.0; MAX_STATE], length: 0 };
        let places = of.numbers.get_mut(..numbers.len());
        let places = places.ok_or(InvalidState::TooLong(numbers.len()))?;
        for (at, (place, number)) in places.iter_mut().zip(numbers).enumerate() {
            if !number.is_finite() {
                return Err(InvalidState::NotFinite(at));
            }
            // 0 in place of -0: states with equal numbers are equal.
            *place = number + 0.0;
        }
        of.length = numbers.len() as u8;
        Ok(of)
    }

    /// The numbers.
    pub fn numbers(&self) -> &[f32] {
        &self.numbers[..usize::from(self.length)]
    }

    /// The numbers, and zeros after them.
    pub const fn padded(&self) -> [f32; MAX_STATE] {
        self.numbers
    }

    fn bits(&self) -> impl Iterator<Item = u32> + '_ {
        self.numbers().iter().map(|number| number.to_bits())
    }
}

impl PartialEq for State {
    fn eq(&self, other: &Self) -> bool {
        self.numbers() == other.numbers()
    }
}

impl Eq for State {}

impl std::hash::Hash for State {
    fn hash<H: std::hash::Hasher>(&self, hasher: &mut H) {
        self.bits().for_each(|bits| hasher.write_u32(bits));
        hasher.write_u8(self.length);
    }
}

impl PartialOrd for State {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for State {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        let pairs = self.numbers().iter().zip(other.numbers());
        let order = pairs.map(|(one, other)| one.total_cmp(other)).find(|order| order.is_ne());
        order.unwrap_or_else(|| self.length.cmp(&other.length))
    }
}

impl std::fmt::Debug for State {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "State{:?}", self.numbers())
    }
}

/// The numbers with commas between them: `3,12,0`.
impl std::fmt::Display for State {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (at, number) in self.numbers().iter().enumerate() {
            write!(f, "{}{number}", if at == 0 { "" } else { "," })?;
        }
        Ok(())
    }
}

/// As [`Display`](std::fmt::Display) writes it.
impl std::str::FromStr for State {
    type Err = crate::UnknownCode;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let numbers: Option<Vec<f32>> = text.split(',').map(|number| number.parse().ok()).collect();
        let state = numbers.and_then(|numbers| Self::new(&numbers).ok());
        state.ok_or_else(|| {
            crate::UnknownCode::new(text, "a state (numbers with commas between them)")
        })
    }
}

impl TryFrom<Vec<f32>> for State {
    type Error = InvalidState;

    fn try_from(numbers: Vec<f32>) -> Result<Self, InvalidState> {
        Self::new(&numbers)
    }
}

impl From<State> for Vec<f32> {
    fn from(state: State) -> Self {
        state.numbers().to_vec()
    }
}

/// An action: its place among those that the world declares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ActionCode(pub u8);

/// A feedback: its place among those that the world declares. The first is that of the beginning of an episode, the last that of
/// an answer that could not be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(transparent)]
pub struct FeedbackCode(pub u8);

impl FeedbackCode {
    /// There was no action yet.
    pub const START: Self = Self(0);
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use super::*;

    #[test]
    fn states_are_equal_where_their_numbers_are() {
        let state = |numbers: &[f32]| State::new(numbers).unwrap();
        assert_eq!(state(&[0.0, 1.5]), state(&[-0.0, 1.5]));
        assert_ne!(state(&[0.0]), state(&[0.0, 0.0]));
        assert_eq!(state(&[1.0, 2.0]).cmp(&state(&[1.0, -2.0])), Ordering::Greater);
        assert_eq!(state(&[1.0]).cmp(&state(&[1.0, 0.0])), Ordering::Less);
        assert_eq!(state(&[3.0, 12.0, 0.5]).to_string(), "3,12,0.5");
        let text = serde_json::to_string(&state(&[3.0, 0.1])).unwrap();
        assert_eq!(text, "[3.0,0.1]");
        assert_eq!("3,0.1".parse(), Ok(state(&[3.0, 0.1])));
        assert!("3,,1".parse::<State>().is_err());
        assert_eq!(serde_json::from_str::<State>(&text).unwrap(), state(&[3.0, 0.1]));
    }

    #[test]
    fn what_is_no_state_is_refused() {
        assert_eq!(State::new(&[0.0; 17]), Err(InvalidState::TooLong(17)));
        for number in [f32::NAN, f32::INFINITY] {
            assert_eq!(State::new(&[0.0, number]), Err(InvalidState::NotFinite(1)));
        }
    }
}
