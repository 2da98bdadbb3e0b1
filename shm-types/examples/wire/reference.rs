//! Renders the page: prose from a template, tables from the declarations.

use std::fmt::Write;

use domain::codes::CodeSet;
use shm_types::attach::PAGE_BYTES;
use shm_types::layout::{FieldType, Struct};
use shm_types::message::{Description, MESSAGES, Role, WIRE_VERSION};

use crate::COMMAND;
use crate::described::{
    CARRIED, PARTS, Section, code_sets, constants, messages, plain, traffic, words,
};

const TEMPLATE: &str = include_str!("wire.md");

/// The whole page.
///
/// # Panics
/// When the template, which is part of this program, names an unknown table.
pub(crate) fn page() -> String {
    let mut page = String::new();
    let mut rest = TEMPLATE;
    while let Some((before, after)) = rest.split_once("{{") {
        let (name, after) = after.split_once("}}").expect("a name in the template ends with }}");
        page.push_str(before);
        page.push_str(table(name).trim_end());
        rest = after;
    }
    page + rest
}

fn table(name: &str) -> String {
    match name {
        "notice" => format!("<!-- Generated: do not edit. {COMMAND} -->"),
        "page" => PAGE_BYTES.to_string(),
        "wire-version" => WIRE_VERSION.to_string(),
        "services" => services(),
        "policy-messages" => messages(Section::Policy).map(message).collect(),
        "memory-messages" => messages(Section::ExternalMemory).map(message).collect(),
        "other-messages" => messages(Section::Others).map(message).collect(),
        "parts" => PARTS.iter().map(structure).collect(),
        "carried" => CARRIED.iter().map(structure).collect(),
        "codes" => code_sets().iter().map(codes).collect(),
        "constants" => {
            let rows = constants();
            let rows = rows
                .iter()
                .map(|c| format!("| `{}` | {} | {} |\n", c.name, c.value.replace('"', "`"), c.doc));
            format!("| constant | value | meaning |\n|---|---|---|\n{}", rows.collect::<String>())
        }
        unknown => panic!("the template names an unknown table: {unknown}"),
    }
}

fn roles(roles: &[Role]) -> String {
    roles.iter().map(|role| role.word()).collect::<Vec<_>>().join(", ")
}

fn services() -> String {
    let mut table = String::from(
        "| service | message | bytes | from | to | queue |\n|---|---|---|---|---|---|\n",
    );
    for Description { layout, service, from, to, traffic: kind } in MESSAGES {
        let _ = writeln!(
            table,
            "| `{service}` | [{name}](#{anchor}) | {bytes} | {from} | {to} | {kind} |",
            name = layout.name,
            anchor = layout.name.to_lowercase(),
            bytes = layout.bytes,
            from = roles(from),
            to = roles(to),
            kind = traffic(*kind),
        );
    }
    table
}

fn message(message: &Description) -> String {
    let Description { layout, service, .. } = message;
    let head = format!("Service `{service}`, type name `{}`", layout.type_name);
    section(layout, &head)
}

fn structure(layout: &Struct) -> String {
    section(layout, &format!("Type name `{}`", layout.type_name))
}

fn section(layout: &Struct, head: &str) -> String {
    let Struct { name, doc, bytes, align, fields, .. } = layout;
    let mut text =
        format!("### {name}\n\n{}\n\n{head}, {bytes} bytes, alignment {align}.\n\n", plain(doc));
    text.push_str("| offset | bytes | type | field | meaning |\n|---:|---:|---|---|---|\n");
    for field in *fields {
        let _ = writeln!(
            text,
            "| {} | {} | {} | `{}` | {} |",
            field.offset,
            field.bytes,
            shape(field.shape),
            field.name,
            plain(field.doc).replace('|', "\\|"),
        );
    }
    text + "\n"
}

/// The name of a field's type in the tables.
fn shape(of: FieldType) -> String {
    match of {
        FieldType::Number(name) => name.to_owned(),
        FieldType::Struct(name) => format!("[{name}](#{})", name.to_lowercase()),
        FieldType::Array(item, count) => format!("{} × {count}", shape(*item)),
    }
}

fn codes(set: &CodeSet) -> String {
    let CodeSet { name, doc, members } = set;
    let has_words = members.iter().any(|member| words(set, member.code).is_some());
    let (head, rule) = if has_words { (" words |", "---|") } else { ("", "") };
    let mut text = format!(
        "### {name}\n\n{}\n\n| code | name |{head} meaning |\n|---:|---|{rule}---|\n",
        plain(doc)
    );
    for member in *members {
        let words = words(set, member.code).map_or(String::new(), |words| format!(" {words} |"));
        let _ = writeln!(
            text,
            "| {} | `{}` |{words} {} |",
            member.code,
            member.name,
            plain(member.doc)
        );
    }
    text + "\n"
}

#[cfg(test)]
mod tests {
    use shm_types::{Attach, FrameSize, RunDir};

    use super::TEMPLATE;

    /// The table of `attach.json` is written by hand.
    #[test]
    fn every_field_of_the_attach_file_is_explained() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunDir::create(folder.path()).unwrap();
        let attach = Attach {
            prompts: Some("/prompts".into()),
            external_memories: vec![0],
            frame: FrameSize::DEFAULT,
            ..run.attach()
        };
        let json = serde_json::to_value(&attach).unwrap();
        for (name, value) in json.as_object().unwrap() {
            let inner = value.as_object().into_iter().flatten();
            let names = inner.map(|(inner, _)| format!("`{name}.{inner}`")).collect::<Vec<_>>();
            let names = if names.is_empty() { vec![format!("`{name}`")] } else { names };
            for name in names {
                assert!(TEMPLATE.contains(&format!("| {name} |")), "{name} is not explained");
            }
        }
    }
}
