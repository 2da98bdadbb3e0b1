//! Cases run with each representation, and under controls.

use domain::Representation;
use warehouse::TrajectoryKind;

use super::runner::{Condition, Frames, Runner};

/// Every how many cases one is run: two of each task type.
const EVERY: usize = 5;

#[test]
fn episodic_memory_helps_only_when_the_frames_are_real() {
    let mut runner = Runner::new();
    let episodic = Condition::of(Representation::Episodic);
    let mut successes = |condition| runner.successes(condition, EVERY);
    let working = successes(Condition::of(Representation::Working));
    let blank = successes(Condition { frames: Frames::Blank, ..episodic });
    let swapped = successes(Condition { frames: Frames::Swapped, ..episodic });
    let episodic = successes(episodic);
    let counts =
        format!("episodic {episodic}, working {working}, blank {blank}, swapped {swapped}");
    assert!(episodic >= 19, "{counts}");
    assert!(working + 5 <= episodic, "{counts}");
    assert!(blank <= 2 && swapped <= 3, "{counts}");
}

/// Each condition varies one thing. Bounds are successes in ten cases, one of each task type.
#[test]
fn every_representation_helps_as_far_as_its_content_allows() {
    use Representation::{Episodic, FullContext, Hybrid, Semantic, Summary, Working};
    let mut runner = Runner::new();
    let blank = |memory| Condition { frames: Frames::Blank, ..Condition::of(memory) };
    let new = |memory| Condition {
        start: TrajectoryKind::Test,
        demonstrations: 4,
        ..Condition::of(memory)
    };
    let rows = [
        ("no window, no memory", Condition { window: 0, ..Condition::of(Working) }, 0..=4),
        ("a whole demonstration", Condition::of(FullContext), 9..=10),
        (
            "a whole demonstration, with the hint",
            Condition { hint: true, ..Condition::of(FullContext) },
            9..=10,
        ),
        ("a summary", Condition::of(Summary), 9..=10),
        ("semantic knowledge", Condition::of(Semantic), 1..=9),
        ("both documents", Condition::of(Hybrid), 9..=10),
        ("views without actions", Condition { actions: false, ..Condition::of(Episodic) }, 1..=9),
        ("four demonstrations, new start", new(FullContext), 5..=9),
        ("a summary, new start", new(Summary), 5..=9),
        (
            "a summary, on a blocked route",
            Condition { start: TrajectoryKind::Blocked, ..new(Summary) },
            1..=8,
        ),
        ("a whole demonstration, blank frames", blank(FullContext), 0..=2),
        ("a summary, blank frames", blank(Summary), 0..=2),
    ];
    let counted = rows
        .map(|(what, condition, bounds)| (what, runner.successes(condition, 2 * EVERY), bounds));
    let wrong: Vec<_> =
        counted.iter().filter(|(_, count, bounds)| !bounds.contains(count)).collect();
    assert!(wrong.is_empty(), "{wrong:?} of {counted:?}");
}
