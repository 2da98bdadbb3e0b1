//! Cases walked with each representation, and under controls.

use domain::Representation;
use warehouse::Start;

use crate::walker::{Frames, Setup, Walker};

/// Every how many cases one is walked: two of each type.
const EVERY: usize = 5;

#[test]
fn memory_is_followed_through_the_pixels_and_only_through_them() {
    let mut walker = Walker::new();
    let episodic = Setup::of(Representation::Episodic);
    let mut solved = |setup| walker.solved(setup, EVERY);
    let working = solved(Setup::of(Representation::Working));
    let blank = solved(Setup { frames: Frames::Blank, ..episodic });
    let swapped = solved(Setup { frames: Frames::Swapped, ..episodic });
    let episodic = solved(episodic);
    let told = format!("episodic {episodic}, working {working}, blank {blank}, swapped {swapped}");
    assert!(episodic >= 19, "{told}");
    assert!(working + 5 <= episodic, "{told}");
    assert!(blank <= 2 && swapped <= 3, "{told}");
}

/// The conditions vary one thing each; bounds are in cases of ten, one of each type.
#[test]
fn every_representation_is_used_in_the_way_its_content_allows() {
    use Representation::{Episodic, FullContext, Hybrid, Semantic, Summary, Working};
    let mut walker = Walker::new();
    let blank = |memory| Setup { frames: Frames::Blank, ..Setup::of(memory) };
    let new = |memory| Setup { start: Start::Test, demonstrations: 4, ..Setup::of(memory) };
    let rows = [
        ("no window, no memory", Setup { window: 0, ..Setup::of(Working) }, 0..=4),
        ("a whole demonstration", Setup::of(FullContext), 9..=10),
        (
            "a whole demonstration, with the hint",
            Setup { hint: true, ..Setup::of(FullContext) },
            9..=10,
        ),
        ("a summary", Setup::of(Summary), 9..=10),
        ("general knowledge", Setup::of(Semantic), 6..=10),
        ("both documents", Setup::of(Hybrid), 9..=10),
        ("views without actions", Setup { actions: false, ..Setup::of(Episodic) }, 1..=8),
        ("four demonstrations, from elsewhere", new(FullContext), 5..=9),
        ("a summary, from elsewhere", new(Summary), 5..=9),
        ("a summary, on a blocked route", Setup { start: Start::Blocked, ..new(Summary) }, 2..=8),
        ("a whole demonstration, blind", blank(FullContext), 0..=2),
        ("a summary, blind", blank(Summary), 0..=2),
    ];
    let solved = rows.map(|(what, setup, bounds)| (what, walker.solved(setup, 2 * EVERY), bounds));
    let wrong: Vec<_> =
        solved.iter().filter(|(_, solved, bounds)| !bounds.contains(solved)).collect();
    assert!(wrong.is_empty(), "{wrong:?} of {solved:?}");
}
