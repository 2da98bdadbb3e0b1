//! Generated warehouses satisfy every constraint, with 50 cases each; the largest with a case of each task type.
//! `examples/worlds.rs` does the same for 200 of them.

use warehouse::{CaseSet, GeneratedWorld, validate};

#[test]
fn generated_worlds_satisfy_every_constraint() {
    for (seed, width, height, count) in [
        (1, 12, 12, 50),
        (2, 12, 12, 50),
        (3, 13, 17, 50),
        (4, 16, 30, 50),
        (5, 24, 14, 50),
        (6, 24, 40, 50),
        (7, 64, 64, 10),
    ] {
        let world = GeneratedWorld::generate(seed, width, height, None).unwrap();
        let cases = CaseSet::generate(&world.warehouse, seed, count).unwrap();
        let report = validate(&world.warehouse, &cases);
        assert!(report.is_clean(), "{width}x{height} seed {seed}:\n{report}");
    }
}
