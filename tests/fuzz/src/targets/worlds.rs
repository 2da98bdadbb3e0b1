//! Warehouses, cases and streams.

use std::fs;
use std::sync::OnceLock;

use domain::StreamOrder;
use warehouse::case_file::CASES_FILE;
use warehouse::{CATALOGUE_FILE, CaseSet, Elsewhere, LAYOUT_FILE, StreamSet, Warehouse};

use crate::files::with_files;

const LAYOUT: &[u8] = include_bytes!("../../../../assets/layout.toml");
const CATALOGUE: &[u8] = include_bytes!("../../../../assets/catalogue.toml");

fn world() -> &'static (Warehouse, CaseSet) {
    static WORLD: OnceLock<(Warehouse, CaseSet)> = OnceLock::new();
    WORLD.get_or_init(|| (Warehouse::shipped(), CaseSet::shipped()))
}

/// Assets are refused, or every item stands in the hall, and cases are written and read back equal.
pub(crate) fn assets(input: &[u8]) {
    let given = [(LAYOUT_FILE, LAYOUT), (CATALOGUE_FILE, CATALOGUE)];
    let names = [LAYOUT_FILE, CATALOGUE_FILE, CASES_FILE];
    with_files(&given, &names, input, |folder| {
        let Ok(warehouse) = Warehouse::load(folder) else { return };
        for item in &warehouse.items {
            assert!(warehouse.layout.is_free(item.standpoint));
            assert!(item.item_type < warehouse.catalogue.types.len());
        }
        let cases_file = folder.join(CASES_FILE);
        let Ok(cases) = CaseSet::load(&cases_file, &warehouse) else { return };
        fs::write(&cases_file, cases.to_toml(&warehouse.catalogue)).unwrap();
        assert_eq!(CaseSet::load(&cases_file, &warehouse).unwrap(), cases);
    });
}

/// Streams are refused, or every block has a world, and they are written and read back equal.
pub(crate) fn streams(input: &[u8]) {
    let Ok(text) = str::from_utf8(input) else { return };
    let (warehouse, cases) = world();
    let Ok(set) = StreamSet::parse(text, warehouse, cases) else { return };
    assert_eq!(set.states(warehouse).unwrap().len(), set.worlds.len());
    for (number, stream) in (0..).zip(&set.streams) {
        assert!(stream.cases().iter().all(|&case| (case as usize) < cases.cases.len()));
        for event in stream.blocks.iter().flat_map(|block| &block.events) {
            assert!(!event.describe(warehouse).is_empty());
        }
        for order in StreamOrder::ALL {
            let mut blocks = set.order(number, order);
            blocks.sort_unstable();
            assert!(blocks.into_iter().eq(0..stream.blocks.len() as u32));
        }
    }
    assert_eq!(StreamSet::parse(&set.to_text(), warehouse, cases).unwrap(), set);
}

/// Another warehouse is refused, or it demonstrates every case, and is written and read back equal.
pub(crate) fn elsewhere(input: &[u8]) {
    // The catalogue and the layout are those of a drawn warehouse where the input says so, and demonstrations too.
    static DRAWN: OnceLock<String> = OnceLock::new();
    let (warehouse, cases) = world();
    let drawn = DRAWN.get_or_init(|| Elsewhere::generate(warehouse, cases, 3).unwrap().to_text());
    let mut text = String::from_utf8_lossy(input).into_owned();
    if let Some(changes) = text.strip_prefix("DRAWN\n") {
        let mut changed = drawn.clone();
        // Lines `AT TEXT`: the characters from there on are replaced.
        for (at, new) in changes.lines().filter_map(|line| line.split_once(' ')) {
            let Ok(at) = at.parse::<usize>() else { continue };
            let (at, end) =
                (at % changed.len(), (at % changed.len() + new.len()).min(changed.len()));
            if changed.is_char_boundary(at) && changed.is_char_boundary(end) {
                changed.replace_range(at..end, new);
            }
        }
        text = changed;
    }
    let Ok(other) = Elsewhere::parse(&text, warehouse, cases) else { return };
    assert!((0..cases.cases.len()).all(|case| other.demonstration(case).is_some()));
    assert_eq!(Elsewhere::parse(&other.to_text(), warehouse, cases).unwrap(), other);
}
