//! What the policy was given and what it answered, for each representation.

use shm_types::Representation;

use super::main_table::{NO_REQUESTS, mega};
use crate::conditions::Variation;
use crate::report::document::{Block, Cell, Column, Table};
use crate::report::plot::PlotError;
use crate::report::view::{View, name, pair_stubs, plain_or};

const SETTINGS: [(&str, &str, &str); 2] = [
    ("New start, 1 demo", "new/unchanged", "original"),
    ("New start, 4 demos", "new/unchanged", "4"),
];

pub(super) fn blocks(view: &View<'_>) -> Result<Vec<Block>, PlotError> {
    let settings = &view.log.manifest.settings;
    let columns = SETTINGS.iter().flat_map(|(over, _, _)| {
        ["Images", "Mtok", "Unreadable %"].map(|name| Column::under(*over, name))
    });
    let mut columns: Vec<Column> = columns.collect();
    columns.insert(0, Column::new("Full window"));
    let names = |representation| {
        SETTINGS.map(|(_, rest, demonstrations)| name(representation, rest, demonstrations))
    };
    let ours = |representation: Representation| {
        let window = Variation::STANDARD.window;
        let most = representation.images(window, settings.horizon, settings.keyframes);
        let mut cells = vec![Cell::Value(most.to_string())];
        for name in names(representation) {
            cells.push(view.ours(&name, |score| {
                plain_or(score.images_per_request.map(|images| images.mean), 2, NO_REQUESTS)
            }));
            cells.push(mega(view, &name));
            cells.push(view.ours(&name, |score| {
                plain_or(score.unread.map(|unread| unread.mean), 2, NO_REQUESTS)
            }));
        }
        cells
    };
    let theirs = |representation| {
        let original = name(representation, "original/unchanged", "original");
        let mut cells = vec![view.theirs(&original, |p| p.img.map(|img| format!("{img:.0}")))];
        for name in names(representation) {
            cells.push(view.theirs(&name, |_| None));
            cells.push(view.theirs(&name, |p| p.mtok.map(|mtok| format!("{mtok:.0}"))));
            cells.push(view.theirs(&name, |_| None));
        }
        cells
    };
    let table = Table {
        id: view.id("cost"),
        caption: "What a request held and what came back. Full window: most images of a request, which are the \
                  current view, the window and what memory supplies. Images: the mean over all requests, which is lower \
                  because the window fills up during an episode's first steps. Mtok: million prompt and completion \
                  tokens per 100 cases. Unreadable: percentage of answers in which no action could be read."
            .to_owned(),
        stubs: pair_stubs(),
        columns,
        groups: view.pairs(Representation::ALL, ours, theirs),
    };
    Ok(vec![Block::Table(table)])
}
