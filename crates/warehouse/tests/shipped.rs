//! The files in `assets/` are those that the program generates.

use std::path::Path;

use warehouse::{CaseSet, SHIPPED_COUNT, SHIPPED_SEED, Warehouse};

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
