//! The template's file as a struct.

use std::sync::LazyLock;

use serde::Deserialize;

pub(super) const FILE: &str = include_str!("../v1.toml");

/// Defines structs of texts, which have to be in the file and are the only ones there.
macro_rules! texts {
    ($($name:ident { $($field:ident),* $(,)? })*) => {
        $(
            #[derive(Debug, Deserialize)]
            #[serde(deny_unknown_fields)]
            pub(super) struct $name {
                $(pub(super) $field: String,)*
            }
        )*
    };
}

/// The template's texts. `v1.toml` says what each is for.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Template {
    pub(super) version: String,
    pub(super) system: String,
    pub(super) view_not_shown: String,
    pub(super) memory: MemoryTexts,
    pub(super) task: TaskTexts,
    pub(super) window: WindowTexts,
    pub(super) now: NowTexts,
    pub(super) view: ViewTexts,
    pub(super) words: WorldWords,
}

/// The words for what agents do, by world.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WorldWords {
    warehouse: Words,
    other: Words,
}

impl WorldWords {
    /// The names in texts, and the words for them in the world of this name.
    pub(super) fn of(&'static self, world: &str) -> [(&'static str, &'static str); 4] {
        let Words { walk, walked, place, changed } =
            if world == "warehouse" { &self.warehouse } else { &self.other };
        [("walk", walk), ("walked", walked), ("place", place), ("changed", changed)]
    }
}

texts! {
    MemoryTexts {
        begin, nothing, end, elsewhere, document, summary, semantic, note, captioned_begin, caption,
        captioned_end, demonstration_begin, demonstration_view, demonstration_actions, then, several,
        demonstration_end, part_begin, part_end, hint, retrieved_begin, one_retrieved_begin,
        retrieved_action, retrieved_view, retrieved_view_alone, retrieved_end,
    }
    TaskTexts { text }
    WindowTexts { begin, nothing, view, step, no_action, end }
    NowTexts { begin, end }
    ViewTexts { after }
    Words { walk, walked, place, changed }
}

/// The template that this program was built with.
pub(super) fn template() -> &'static Template {
    static TEMPLATE: LazyLock<Template> = LazyLock::new(|| {
        // The file is compiled in, and a test parses it.
        toml::from_str(FILE).expect("the template parses")
    });
    &TEMPLATE
}
