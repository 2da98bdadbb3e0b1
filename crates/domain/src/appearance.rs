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
    /// Labels and the standard look, and no plates: that of the paper's warehouse.
    pub const STANDARD: Self = Self { plates: false, labels: true, seed: 0 };

    /// The standard look with plates.
    pub const WITH_PLATES: Self = Self { plates: true, ..Self::STANDARD };

    /// The flags that give it to a process, each with its value.
    pub fn flags(self) -> [(&'static str, String); 3] {
        let word = |on: bool| if on { "on" } else { "off" }.to_owned();
        [
            ("--plates", word(self.plates)),
            ("--labels", word(self.labels)),
            ("--appearance-seed", self.seed.to_string()),
        ]
    }

    /// The [`flags`](Self::flags) whose values are not those of [`STANDARD`](Self::STANDARD).
    pub fn differing_flags(self) -> impl Iterator<Item = (&'static str, String)> {
        let standard = Self::STANDARD.flags();
        self.flags()
            .into_iter()
            .zip(standard)
            .filter(|(own, other)| own != other)
            .map(|(own, _)| own)
    }
}

impl Default for Appearance {
    fn default() -> Self {
        Self::STANDARD
    }
}

impl fmt::Display for Appearance {
    /// Writes how it differs from the standard: `plates, no labels, seed 7`; `standard` where it does not.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { plates, labels, seed } = self;
        let parts = [
            plates.then(|| "plates".to_owned()),
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

    /// The flags of a program that is given none, and what the paper's warehouse looks like.
    #[test]
    fn the_standard_has_labels_and_no_plates() {
        let flags = |appearance: Appearance| {
            appearance.flags().map(|(flag, value)| format!("{flag} {value}")).join(" ")
        };
        assert_eq!(flags(Appearance::STANDARD), "--plates off --labels on --appearance-seed 0");
        let differing = |appearance: Appearance| Vec::from_iter(appearance.differing_flags());
        assert_eq!(differing(Appearance::STANDARD), []);
        assert_eq!(differing(Appearance::WITH_PLATES), [("--plates", "on".to_owned())]);
    }

    #[test]
    fn only_differences_from_the_standard_are_written() {
        assert_eq!(Appearance::STANDARD.to_string(), "standard");
        assert_eq!(Appearance::WITH_PLATES.to_string(), "plates");
        let all = Appearance { plates: true, labels: false, seed: 7 };
        assert_eq!(all.to_string(), "plates, no labels, seed 7");
    }
}
