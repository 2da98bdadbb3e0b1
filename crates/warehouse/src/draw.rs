//! Random draws that are the same on every machine and with every version of the libraries: ChaCha8 with a key that is
//! defined here, and integers only.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// A stream of draws.
pub(crate) struct Draw(ChaCha8Rng);

impl Draw {
    /// Stream `stream` of `seed`. Streams of one seed are independent of each other.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..16].copy_from_slice(&stream.to_le_bytes());
        Self(ChaCha8Rng::from_seed(key))
    }

    /// A number below `bound`, which must not be 0. Every number is equally likely, to within one in 2^32.
    pub(crate) fn below(&mut self, bound: usize) -> usize {
        ((u64::from(self.0.next_u32()) * bound as u64) >> 32) as usize
    }

    /// One of `choices`, which must not be empty.
    pub(crate) fn pick<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.below(choices.len())]
    }

    /// `list` in random order (Fisher-Yates shuffle).
    pub(crate) fn shuffled<T>(&mut self, mut list: Vec<T>) -> Vec<T> {
        for i in (1..list.len()).rev() {
            list.swap(i, self.below(i + 1));
        }
        list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_never_change() {
        let mut draw = Draw::new(1, 2);
        let numbers: Vec<usize> = (0..8).map(|_| draw.below(1000)).collect();
        assert_eq!(numbers, [188, 329, 267, 276, 686, 477, 521, 239]);
        assert_eq!(draw.shuffled((0..6).collect()), [2, 3, 4, 5, 0, 1]);
        assert_ne!(Draw::new(1, 3).below(1 << 30), Draw::new(2, 3).below(1 << 30));
    }
}
