//! How much fits into a prompt.

use std::iter::Sum;
use std::ops::Add;

/// How much of a prompt something takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PartSize {
    /// Characters.
    pub chars: usize,
    /// Images.
    pub images: usize,
}

/// What is left of a prompt for demonstrations or notes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Room {
    /// Characters.
    pub chars: usize,
    /// Images.
    pub images: usize,
}

/// What stands around a text: a line break, and notes have a heading.
const AROUND: usize = "## Notes 1234\n\n\n".len();

impl Room {
    /// The number of leading parts that fit.
    pub fn fitting(self, sizes: impl IntoIterator<Item = PartSize>) -> usize {
        let mut used = PartSize::default();
        let fits = |size: &PartSize| {
            used = used + *size + PartSize { chars: AROUND, images: 0 };
            used.chars <= self.chars && used.images <= self.images
        };
        sizes.into_iter().take_while(fits).count()
    }
}

impl Add for PartSize {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { chars: self.chars + other.chars, images: self.images + other.images }
    }
}

impl Sum for PartSize {
    fn sum<I: Iterator<Item = Self>>(sizes: I) -> Self {
        sizes.fold(Self::default(), Self::add)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn characters_and_images_are_limits() {
        let part = PartSize { chars: 100 - AROUND, images: 3 };
        let parts = [part; 5];
        for (chars, images, expected) in
            [(500, 15, 5), (499, 15, 4), (500, 14, 4), (99, 15, 0), (100, 2, 0), (9999, 50, 5)]
        {
            assert_eq!(Room { chars, images }.fitting(parts), expected, "{chars} {images}");
        }
    }
}
