//! The files in `assets/` are those that the program generates.

use std::path::Path;

use warehouse::plan::{Planner, Prices};
use warehouse::{CaseSet, SHIPPED_COUNT, SHIPPED_SEED, TrajectoryKind, Variant, Warehouse};

/// Set this variable to write `assets/cases.toml` anew after a change to the assets or the generator.
const REGENERATE: &str = "MEMTRANSFER_REGENERATE";

#[test]
fn the_shipped_cases_are_what_their_seed_gives() {
    let warehouse = Warehouse::shipped();
    let generated = CaseSet::generate(&warehouse, SHIPPED_SEED, SHIPPED_COUNT).unwrap();
    let text = generated.to_toml(&warehouse.catalogue);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/cases.toml");
    if std::env::var_os(REGENERATE).is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let shipped = std::fs::read_to_string(&path).unwrap();
    assert!(
        text == shipped,
        "assets/cases.toml is not what seed {SHIPPED_SEED} gives; if the change is intended, write it \
         anew: {REGENERATE}=1 cargo test --release -p warehouse --test shipped"
    );
    assert_eq!(
        CaseSet::load(&path, &warehouse).unwrap(),
        generated,
        "the file is read back as the same set"
    );
}

#[test]
fn the_shipped_cases_satisfy_every_constraint() {
    let report = warehouse::validate(&Warehouse::shipped(), &CaseSet::shipped());
    println!("{report}");
    assert!(report.is_clean(), "{report}");
    assert_eq!(report.lines.iter().filter(|line| line.checked == 6 * SHIPPED_COUNT).count(), 4);
}

/// The specification has these numbers (section 4).
#[test]
fn references_are_longer_than_the_fewest_steps() {
    let (warehouse, cases) = (Warehouse::shipped(), CaseSet::shipped().cases);
    let planner = |variant| Planner::new(&warehouse, variant, Prices::STEPS);
    let unchanged = planner(Variant::UNCHANGED);
    let ratios = |kinds: &[TrajectoryKind]| {
        let of = cases.iter().flat_map(|case| kinds.iter().map(move |&kind| (case, kind)));
        let ratios = of.map(|(case, kind)| {
            let (start, task) = (case.trajectory(kind).start, &case.task);
            let fewest = match kind {
                TrajectoryKind::Blocked => planner(case.variant(kind)).cost(start, task),
                _ => unchanged.cost(start, task),
            };
            f64::from(case.replay(&warehouse, kind).length.unwrap()) / f64::from(fewest.unwrap())
        });
        let ratios: Vec<f64> = ratios.collect();
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        format!("{mean:.2}, at most {:.2}", ratios.iter().copied().fold(0.0, f64::max))
    };
    assert_eq!(ratios(&[TrajectoryKind::Original]), "1.20, at most 1.44");
    assert_eq!(ratios(&[TrajectoryKind::Test]), "1.20, at most 1.45");
    assert_eq!(ratios(&[TrajectoryKind::Blocked]), "1.16, at most 1.31");
    assert_eq!(ratios(&TrajectoryKind::ALL), "1.19, at most 1.50");
}
