//! Vectors to measure a search with: the given embeddings of images, then seeded neighbours of them.
//!
//! A neighbour is an embedding plus noise, scaled to length 1. The length of the noise is drawn from 0.02 to 0.5,
//! uniformly in its logarithm, so that near and far neighbours occur; its direction is uniform. A query is a neighbour
//! of an entry. Each vector depends on its number, the seed and the given embeddings only.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::embedding::Embedding;

/// Random directions that stand in for embeddings when none are given.
const DIRECTIONS: u32 = 2000;

/// The least and greatest length of noise.
const NOISE: (f32, f32) = (0.02, 0.5);

/// What a random vector is drawn for.
#[derive(Clone, Copy)]
enum DrawPurpose {
    Entry,
    Query,
    Direction,
}

/// Numbered vectors.
#[derive(Debug)]
pub struct SyntheticVectors {
    dimension: usize,
    seed: u64,
    /// The vectors that neighbours are derived from.
    origins: Vec<Embedding>,
    /// How many of `origins` are given embeddings: all or none.
    real: u32,
}

impl SyntheticVectors {
    /// Vectors derived from `embeddings`, or from random directions when there are none.
    pub fn new(embeddings: Vec<Embedding>, dimension: usize, seed: u64) -> Self {
        let real = embeddings.len() as u32;
        let mut vectors = Self { dimension, seed, origins: embeddings, real };
        if real == 0 {
            let direction = |number| {
                let mut draws = vectors.draws(DrawPurpose::Direction, number);
                vectors.noisy(None, 1.0, &mut draws)
            };
            vectors.origins = (0..DIRECTIONS).map(direction).collect();
        }
        vectors
    }

    /// Numbers in a vector.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// How many of the first `entries` are given embeddings.
    pub fn real(&self, entries: u32) -> u32 {
        self.real.min(entries)
    }

    /// The vector of an entry.
    pub fn entry(&self, number: u32) -> Embedding {
        if number < self.real {
            return self.origins[number as usize].clone();
        }
        let mut draws = self.draws(DrawPurpose::Entry, number);
        let origin = &self.origins[draws.next_u64() as usize % self.origins.len()];
        let length = length(&mut draws);
        self.noisy(Some(origin), length, &mut draws)
    }

    /// A query for a memory of `entries` entries.
    pub fn query(&self, number: usize, entries: u32) -> Embedding {
        let mut draws = self.draws(DrawPurpose::Query, number as u32);
        let entry = self.entry((draws.next_u64() % u64::from(entries.max(1))) as u32);
        let length = length(&mut draws);
        self.noisy(Some(&entry), length, &mut draws)
    }

    fn draws(&self, purpose: DrawPurpose, number: u32) -> ChaCha8Rng {
        let mut draws = ChaCha8Rng::seed_from_u64(self.seed);
        draws.set_stream(u64::from(number) << 2 | purpose as u64);
        draws
    }

    /// A vector plus noise of about the given length, scaled to length 1.
    fn noisy(&self, origin: Option<&Embedding>, length: f32, draws: &mut ChaCha8Rng) -> Embedding {
        let mut bytes = vec![0; 2 * self.dimension];
        draws.fill_bytes(&mut bytes);
        // The mean square of a number drawn evenly from -1 to 1 is a third.
        let scale = length * (3.0 / self.dimension as f32).sqrt() / 32_768.0;
        let noise = bytes.as_chunks().0.iter();
        let mut noise = noise.map(|&drawn| scale * (f32::from(i16::from_le_bytes(drawn)) + 0.5));
        let vector: Vec<f32> = match origin {
            None => noise.collect(),
            Some(origin) => {
                origin.as_slice().iter().map(|x| x + noise.next().unwrap_or(0.0)).collect()
            }
        };
        // Each number of the noise is an odd multiple of a half, so noise alone is never zero; and an origin is longer
        // than any noise.
        Embedding::normalised(&vector).unwrap_or_else(|| unreachable!("it has a direction"))
    }
}

/// Draws a length of noise.
fn length(draws: &mut ChaCha8Rng) -> f32 {
    let even = draws.next_u32() as f32 / u32::MAX as f32;
    NOISE.0 * (NOISE.1 / NOISE.0).powf(even)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::embedding::distance;

    #[test]
    fn the_first_entries_are_real_and_the_others_lie_near_them() {
        let real = |seed: u8| Embedding::normalised(&[1.0, f32::from(seed), -2.0, 0.5]).unwrap();
        let vectors = SyntheticVectors::new((0..5).map(real).collect(), 4, 7);
        assert_eq!((vectors.real(3), vectors.real(90)), (3, 5));
        for number in 0..5 {
            assert_eq!(vectors.entry(number), real(number as u8));
        }
        let again = SyntheticVectors::new((0..5).map(real).collect(), 4, 7);
        for number in 5..90 {
            let made = vectors.entry(number);
            let apart = |seed| distance(made.as_slice(), real(seed).as_slice());
            assert!((0..5).map(apart).fold(2.0, f32::min) < 0.4, "{number}");
            assert_eq!(made, again.entry(number));
            assert_eq!(vectors.query(number as usize, 50), again.query(number as usize, 50));
        }
        let other = SyntheticVectors::new((0..5).map(real).collect(), 4, 8);
        assert_ne!(other.entry(5), vectors.entry(5));
    }

    #[test]
    fn without_embeddings_none_is_real() {
        let vectors = SyntheticVectors::new(Vec::new(), 3, 1);
        assert_eq!((vectors.real(9), vectors.dimension()), (0, 3));
        assert_eq!(vectors.entry(0).as_slice().len(), 3);
    }
}
