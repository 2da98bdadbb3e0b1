//! The template's file as a struct, and the replacement of names in its texts.

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

/// `text` with each `{name}` of `values` replaced. Names inside values are not replaced, and other braces stay.
pub(super) fn fill(text: &str, values: &[(&str, &str)]) -> String {
    let mut filled = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('{') {
        let (before, from_brace) = rest.split_at(at);
        filled.push_str(before);
        let known = values.iter().find_map(|&(name, value)| {
            let after = from_brace[1..].strip_prefix(name)?.strip_prefix('}')?;
            Some((value, after))
        });
        match known {
            Some((value, after)) => {
                filled.push_str(value);
                rest = after;
            }
            None => {
                filled.push('{');
                rest = &from_brace[1..];
            }
        }
    }
    filled.push_str(rest);
    filled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_replaced_once_and_other_braces_stay() {
        let values = [("a", "{b}"), ("b", "B")];
        for (text, filled) in [
            ("{a} and {b}", "{b} and B"),
            ("{c} {a", "{c} {a"),
            ("{{b}}", "{B}"),
            ("é{a}é", "é{b}é"),
            ("", ""),
        ] {
            assert_eq!(fill(text, &values), filled);
        }
    }
}
