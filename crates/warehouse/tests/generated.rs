//! Generated warehouses satisfy every constraint, with 50 cases each. `examples/worlds.rs` does the same for 200 of them.

use warehouse::{CaseSet, GeneratedWorld, validate};

#[test]
fn generated_worlds_satisfy_every_constraint() {
    for (seed, width, height) in
        [(1, 12, 12), (2, 12, 12), (3, 13, 17), (4, 16, 30), (5, 24, 14), (6, 24, 40), (7, 64, 64)]
    {
        let world = GeneratedWorld::generate(seed, width, height, None).unwrap();
        let cases = CaseSet::generate(&world.warehouse, seed, 50).unwrap();
        let report = validate(&world.warehouse, &cases);
        assert!(report.is_clean(), "{width}x{height} seed {seed}:\n{report}");
    }
}
