//! The sources of documents: the selected demonstrations of all cases, in a world that is rendered.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use case_book::{Demonstration, DemonstrationBook, ViewPlace};
use domain::{Appearance, Demonstrations};

use crate::sha256_of_parts;

/// The demonstrations of a world, and how it is rendered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sources {
    book: Arc<DemonstrationBook>,
    /// How the world looks in frames.
    appearance: Appearance,
    /// Width and height of the frames.
    frame_size: u32,
}

impl Sources {
    /// The demonstrations of `book`, in square frames of this size with this appearance.
    pub fn new(
        book: impl Into<Arc<DemonstrationBook>>,
        frame_size: u32,
        appearance: Appearance,
    ) -> Self {
        Self { book: book.into(), appearance, frame_size }
    }

    /// All demonstrations.
    pub fn book(&self) -> &DemonstrationBook {
        &self.book
    }

    /// Width and height of the frames, in pixels.
    pub fn frame_size(&self) -> u32 {
        self.frame_size
    }

    /// How the world looks in frames.
    pub fn appearance(&self) -> Appearance {
        self.appearance
    }

    /// The demonstrations that `selection` names for any case, each once: in the order of the cases, and for each
    /// case in the order of its own set. None where the book lacks one of them.
    pub fn demonstrations(&self, selection: Demonstrations) -> Vec<&Demonstration> {
        let indices = self.book.of_all_cases(selection).unwrap_or_default().into_iter();
        indices.map(|index| &self.book.demonstrations[index as usize]).collect()
    }

    /// The different views in the demonstrations of `selection`, by number: where each is seen first.
    pub fn views(&self, selection: Demonstrations) -> BTreeMap<u32, ViewPlace> {
        let mut views = BTreeMap::new();
        for demonstration in self.book.of_all_cases(selection).unwrap_or_default() {
            let of = &self.book.demonstrations[demonstration as usize];
            for (step, &view) in (0..).zip(&of.views) {
                views.entry(view).or_insert(ViewPlace { demonstration, step });
            }
        }
        views
    }

    /// SHA-256, in hexadecimal digits, of everything that determines the demonstrations of `selection` and their views
    /// and is known without rendering: what the world says of itself, all of the demonstrations that is in words, what can be
    /// seen in the variants in which they take place, the frames' size, their appearance if it is not the standard one, and
    /// this program's version, which stands for how the world is drawn.
    ///
    /// Test references and other variants are left out: a document does not depend on them.
    pub fn sha256(&self, selection: Demonstrations) -> String {
        let Self { book, appearance, frame_size } = self;
        let demonstrations = self.demonstrations(selection);
        let variants: BTreeSet<u32> = demonstrations.iter().map(|of| of.variant).collect();
        let hashes: Vec<&str> = variants
            .iter()
            .map(|variant| book.variants.get(variant).map_or("", String::as_str))
            .collect();
        let mut parts = vec![
            "memtransfer sources v4".to_owned(),
            env!("CARGO_PKG_VERSION").to_owned(),
            format!("{:?}", book.world),
            hashes.join(" "),
            format!("{frame_size} x {frame_size}"),
        ];
        if *appearance != Appearance::STANDARD {
            parts.push(appearance.to_string());
        }
        for of in demonstrations {
            let Demonstration { instruction, states, feedback, sub_goals, actions, .. } = of;
            parts.push(instruction.clone());
            parts.push(format!("{states:?} {feedback:?} {sub_goals:?} {actions:?}"));
        }
        sha256_of_parts(parts.iter().map(String::as_str))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use case_book::{BookRequest, ElsewhereRequest};
    use warehouse::ELSEWHERE_VARIANT;
    use warehouse::case_book::write_books;

    use super::*;

    const FRAME: u32 = 448;

    fn book(seed_of_elsewhere: Option<u64>) -> DemonstrationBook {
        let elsewhere = seed_of_elsewhere.map(|seed| ElsewhereRequest { assets: None, seed });
        let demonstrations = vec![Demonstrations::AFTER];
        let request = BookRequest { demonstrations, elsewhere, ..BookRequest::default() };
        write_books(&request).unwrap().demonstrations
    }

    pub(crate) fn sources(frame_size: u32) -> Sources {
        Sources::new(book(None), frame_size, Appearance::STANDARD)
    }

    #[test]
    fn everything_that_a_view_depends_on_counts() {
        let standard = sources(FRAME);
        let hash = standard.sha256(Demonstrations::ALL);
        assert_eq!(hash, sources(FRAME).sha256(Demonstrations::ALL));
        assert_ne!(hash, sources(224).sha256(Demonstrations::ALL));
        assert_ne!(hash, standard.sha256(Demonstrations::ORIGINAL));
        let seeded = Appearance { seed: 7, ..Appearance::STANDARD };
        assert_ne!(hash, Sources::new(book(None), FRAME, seeded).sha256(Demonstrations::ALL));
        let mut stocked = book(None);
        stocked.variants.insert(0, "other items".to_owned());
        let stocked = Sources::new(stocked, FRAME, Appearance::STANDARD);
        assert_ne!(hash, stocked.sha256(Demonstrations::ALL));
    }

    #[test]
    fn everything_in_the_words_of_a_document_counts() {
        let book = book(None);
        let hash = |change: fn(&mut DemonstrationBook)| {
            let mut book = book.clone();
            change(&mut book);
            Sources::new(book, FRAME, Appearance::STANDARD).sha256(Demonstrations::ALL)
        };
        let changes: [fn(&mut DemonstrationBook); 7] = [
            |_| (),
            |book| book.world.state_sentence.push('!'),
            |book| book.demonstrations[0].instruction.push('!'),
            |book| book.demonstrations[0].states.swap(0, 1),
            |book| book.demonstrations[0].feedback.swap(0, 1),
            |book| book.demonstrations[0].sub_goals.clear(),
            |book| book.demonstrations[0].actions.reverse(),
        ];
        assert_eq!(changes.map(hash).into_iter().collect::<BTreeSet<_>>().len(), 7);
    }

    #[test]
    fn every_demonstration_of_a_set_is_listed_once() {
        let sources = sources(FRAME);
        let cases = sources.book.cases.len();
        let count = |selection| sources.demonstrations(selection).len();
        assert_eq!(count(Demonstrations::NONE), 0);
        assert_eq!(count(Demonstrations::ORIGINAL), cases);
        assert_eq!(count(Demonstrations::ALL), 4 * cases);
        // Every case's own two; the others belong to some case, too.
        assert!((2 * cases..4 * cases).contains(&count(Demonstrations::IRRELEVANT)));
        assert_eq!(count(Demonstrations::BEFORE_AFTER), 2 * cases);
        assert_eq!(count(Demonstrations::ELSEWHERE), 0, "there is no other warehouse");
    }

    #[test]
    fn views_with_one_number_show_the_same_and_are_listed_once() {
        let sources = sources(FRAME);
        let views = sources.views(Demonstrations::ALL);
        let poses: BTreeSet<_> =
            sources.demonstrations(Demonstrations::ALL).iter().flat_map(|of| &of.states).collect();
        assert_eq!(views.len(), poses.len(), "all take place in one variant");
        for (view, ViewPlace { demonstration, step }) in views {
            let of = &sources.book.demonstrations[demonstration as usize];
            assert_eq!(of.views[step as usize], view);
        }
    }

    #[test]
    fn documents_of_the_other_warehouse_depend_on_it_alone() {
        let seen = |seed| Sources::new(book(seed), FRAME, Appearance::STANDARD);
        let (one, two) = (seen(Some(1)), seen(Some(2)));
        let elsewhere = Demonstrations::ELSEWHERE;
        assert_eq!(one.sha256(elsewhere), seen(Some(1)).sha256(elsewhere));
        assert_ne!(one.sha256(elsewhere), two.sha256(elsewhere));
        assert_eq!(one.sha256(Demonstrations::ALL), seen(None).sha256(Demonstrations::ALL));
        let demonstrations = one.demonstrations(elsewhere);
        assert!(demonstrations.iter().all(|of| of.variant == ELSEWHERE_VARIANT));
    }

    #[test]
    fn a_demonstration_after_the_event_depends_on_what_is_closed() {
        let (sources, mut other) = (sources(FRAME), book(None));
        other.variants.insert(9, other.variants[&8].clone());
        let other = Sources::new(other, FRAME, Appearance::STANDARD);
        assert_eq!(sources.sha256(Demonstrations::ALL), other.sha256(Demonstrations::ALL));
        for selection in [Demonstrations::AFTER, Demonstrations::BEFORE_AFTER] {
            assert_ne!(sources.sha256(selection), other.sha256(selection));
        }
        assert_ne!(
            sources.sha256(Demonstrations::AFTER_BEFORE),
            sources.sha256(Demonstrations::BEFORE_AFTER)
        );
        assert!(sources.demonstrations(Demonstrations::AFTER).iter().all(|of| of.variant > 0));
    }
}
