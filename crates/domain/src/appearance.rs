//! How the world looks where that does not change what is in it.

use std::fmt;

/// What may differ between pictures of the same world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Appearance {
    /// Whether a coloured plate hangs above every item.
    pub plates: bool,
    /// Whether anything is written: names of items, numbers of bays, signs.
    pub labels: bool,
    /// Determines the light and the tints of walls, floor and racks; 0 is the standard look.
    pub seed: u64,
}

impl Appearance {
    /// Plates, labels and the standard look.
    pub const STANDARD: Self = Self { plates: true, labels: true, seed: 0 };

    /// The flags that give it to a process, each with its value.
    pub fn flags(self) -> [(&'static str, String); 3] {
        let word = |on: bool| if on { "on" } else { "off" }.to_owned();
        [
            ("--plates", word(self.plates)),
            ("--labels", word(self.labels)),
            ("--appearance-seed", self.seed.to_string()),
        ]
    }
}

impl Default for Appearance {
    fn default() -> Self {
        Self::STANDARD
    }
}

impl fmt::Display for Appearance {
    /// Writes how it differs from the standard: `no plates, no labels, seed 7`; `standard` where it does not.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { plates, labels, seed } = self;
        let parts = [
            (!plates).then(|| "no plates".to_owned()),
            (!labels).then(|| "no labels".to_owned()),
            (*seed != 0).then(|| format!("seed {seed}")),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        f.pad(&if parts.is_empty() { "standard".to_owned() } else { parts.join(", ") })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_differences_from_the_standard_are_written() {
        assert_eq!(Appearance::STANDARD.to_string(), "standard");
        let all = Appearance { plates: false, labels: false, seed: 7 };
        assert_eq!(all.to_string(), "no plates, no labels, seed 7");
    }
}
