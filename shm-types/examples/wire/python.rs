//! The wire for Python: structures for ctypes, whose sizes and offsets are checked when they are imported.

use std::fmt::Write;

use domain::codes::CodeSet;
use shm_types::attach::{FrameSize, Wait};
use shm_types::layout::{Shape, Struct};
use shm_types::message::{Description, MESSAGES, Role, Traffic};
use shm_types::{Attach, FrameControl};

use crate::COMMAND;
use crate::described::{CARRIED, PARTS, code_sets, constants, plain, traffic, words};

/// Longest line.
const WIDTH: usize = 100;

/// The whole module.
pub(crate) fn module() -> String {
    let mut text = format!(
        "\"\"\"The wire: structures, codes and constants, as docs/wire.md explains them.\n\n\
         Generated from the Rust code, do not edit:\n\n    {COMMAND}\n\"\"\"\n\n{IMPORTS}"
    );
    for constant in constants() {
        let _ =
            write!(text, "\n{}{} = {}\n", comment(constant.doc, 0), constant.name, constant.value);
    }
    code_sets().iter().for_each(|set| text.push_str(&enumeration(set)));
    let structs: Vec<_> =
        PARTS.into_iter().chain(CARRIED).chain(MESSAGES.iter().map(|m| m.layout)).collect();
    structs.iter().for_each(|layout| text.push_str(&structure(layout)));
    text.push_str(SERVICE);
    MESSAGES.iter().for_each(|message| text.push_str(&service(message)));
    text.push_str("}\n");
    text.push_str(QUEUES);
    text.push_str(&checks(&structs));
    text
}

const IMPORTS: &str = "\
from __future__ import annotations

import ctypes
import enum
from typing import NamedTuple
";

const SERVICE: &str = "

class Service(NamedTuple):
    \"\"\"A message's way through the run.\"\"\"

    #: Last part of the service's name; the generation and a slash come before it.
    name: str
    #: Who sends the message.
    senders: tuple[Role, ...]
    #: Who receives it: each of them gets every one.
    receivers: tuple[Role, ...]
    #: What bounds the queue: \"lanes\", \"frames\" or \"few\"; see queue_len().
    traffic: str


#: Every message's service.
SERVICES: dict[type[ctypes.Structure], Service] = {
";

const QUEUES: &str = "

def frame_chunks(frame_capacity: int, lanes: int) -> int:
    \"\"\"Chunks of the frame store: what a consumer must be able to hold and to have waiting.\"\"\"
    return frame_capacity + MAX_LOANED_FRAMES + frame_capacity // 8 + lanes + 16


def queue_len(traffic: str, frame_capacity: int, lanes: int) -> int:
    \"\"\"Messages that can wait for one receiver: what every peer has to make room for.\"\"\"
    if traffic == \"lanes\":
        return 2 * lanes + 16
    if traffic == \"frames\":
        return 2 * frame_chunks(frame_capacity, lanes)
    if traffic == \"few\":
        return 256
    raise ValueError(f\"{traffic!r} is not a kind of traffic\")


def document_queue_len(lanes: int) -> int:
    \"\"\"Documents that can wait for the policy.\"\"\"
    return 2 * lanes + 64
";

fn enumeration(set: &CodeSet) -> String {
    let CodeSet { name, doc, members } = set;
    let mut text = format!("\n\nclass {name}(enum.IntEnum):\n{}\n", docstring(doc));
    for member in *members {
        let _ = writeln!(
            text,
            "{}    {} = {}",
            comment(member.doc, 4),
            upper(member.name),
            member.code
        );
    }
    let words: Vec<_> = members
        .iter()
        .filter_map(|member| {
            Some(format!("            {}: {:?},\n", member.code, words(set, member.code)?))
        })
        .collect();
    if !words.is_empty() {
        let _ = write!(
            text,
            "\n    @property\n    def words(self) -> str:\n        \"\"\"The words for it.\"\"\"\n        \
             return {{\n{}        }}[self.value]\n",
            words.concat()
        );
    }
    text
}

fn structure(layout: &Struct) -> String {
    let Struct { name, type_name, doc, align, fields, .. } = layout;
    let mut text = format!("\n\nclass {name}(ctypes.Structure):\n{}\n", docstring(doc));
    for field in *fields {
        let _ = writeln!(
            text,
            "{}    {}: {}",
            comment(field.doc, 4),
            field.name,
            annotation(field.shape)
        );
    }
    if *align > 8 {
        let _ = writeln!(text, "\n    # Python looks at this from 3.13 on.\n    _align_ = {align}");
    }
    text.push_str("\n    _fields_ = [\n");
    for field in *fields {
        let _ = writeln!(text, "        ({:?}, {}),", field.name, ctype(field.shape));
    }
    let _ = write!(
        text,
        "    ]\n\n    @staticmethod\n    def type_name() -> str:\n        \"\"\"The name that iceoryx2 knows it by.\"\"\"\n        \
         return {type_name:?}\n"
    );
    text
}

fn service(message: &Description) -> String {
    let roles = |roles: &[Role]| -> String {
        roles
            .iter()
            .map(|role| format!("Role.{},", upper(role.word())))
            .collect::<Vec<_>>()
            .join(" ")
    };
    let Description { layout, service, from, to, traffic: kind } = message;
    format!(
        "    {}: Service(\n        {service:?},\n        ({}),\n        ({}),\n        {:?},\n    ),\n",
        layout.name,
        roles(from),
        roles(to),
        traffic(*kind),
    )
}

/// What is checked on import: layouts, and the lengths of queues of some runs, as the Rust code has them.
fn checks(structs: &[Struct]) -> String {
    let mut text = String::from(
        "\n\n# Bytes and field offsets, as the Rust compiler lays them out.\n\
         _LAYOUTS: dict[type[ctypes.Structure], tuple[int, dict[str, int]]] = {\n",
    );
    for Struct { name, bytes, fields, .. } in structs {
        let _ = writeln!(text, "    {name}: (\n        {bytes},\n        {{");
        for field in *fields {
            let _ = writeln!(text, "            {:?}: {},", field.name, field.offset);
        }
        text.push_str("        },\n    ),\n");
    }
    text.push_str(
        "}\n\nfor _struct, (_bytes, _offsets) in _LAYOUTS.items():\n    \
         assert ctypes.sizeof(_struct) == _bytes, _struct\n    \
         for _field, _offset in _offsets.items():\n        \
         assert getattr(_struct, _field).offset == _offset, (_struct, _field)\n",
    );
    text.push_str("\n# Queues of some runs, as the Rust code has them: frames, lanes, length.\n");
    for (frame_capacity, lanes) in [(1536, 1), (100, 64)] {
        let attach = example(frame_capacity, lanes);
        for kind in [Traffic::Lanes, Traffic::Frames, Traffic::Few] {
            let (name, length) = (traffic(kind), kind.queue_len(&attach));
            let _ =
                writeln!(text, "assert queue_len({name:?}, {frame_capacity}, {lanes}) == {length}");
        }
        let documents = shm_types::documents::queue_len(&attach);
        let _ = writeln!(text, "assert document_queue_len({lanes}) == {documents}");
    }
    text
}

fn example(frame_capacity: u32, lanes: u32) -> Attach {
    Attach {
        wire_version: shm_types::message::WIRE_VERSION,
        prefix: "mt".to_owned(),
        generation: 1,
        orchestrator_pid: 1,
        crew: Role::CREW.to_vec(),
        lanes,
        window: 6,
        frame: FrameSize::DEFAULT,
        frame_capacity,
        wait: Wait::default(),
        frame_control: FrameControl::default(),
        prompts: None,
        spans: None,
        root: std::path::PathBuf::new(),
    }
}

/// The type of a field for a type checker.
fn annotation(of: Shape) -> String {
    match of {
        Shape::Number("f32") => "float".to_owned(),
        Shape::Number(_) => "int".to_owned(),
        Shape::Struct(name) => name.to_owned(),
        Shape::Array(item, _) => format!("ctypes.Array[{}]", element(*item)),
    }
}

/// The type of an array's elements for a type checker.
fn element(of: Shape) -> String {
    match of {
        Shape::Struct(name) => name.to_owned(),
        Shape::Number(_) | Shape::Array(..) => ctype(of),
    }
}

/// The type of a field for ctypes.
fn ctype(of: Shape) -> String {
    match of {
        Shape::Number("u8") => "ctypes.c_uint8".to_owned(),
        Shape::Number("u16") => "ctypes.c_uint16".to_owned(),
        Shape::Number("u32") => "ctypes.c_uint32".to_owned(),
        Shape::Number("f32") => "ctypes.c_float".to_owned(),
        Shape::Number(_) => "ctypes.c_uint64".to_owned(),
        Shape::Struct(name) => name.to_owned(),
        Shape::Array(item, count) => format!("{} * {count}", ctype(*item)),
    }
}

/// `TurnLeft` as `TURN_LEFT`.
fn upper(name: &str) -> String {
    let mut text = String::new();
    for (at, letter) in name.char_indices() {
        if at > 0 && letter.is_ascii_uppercase() {
            text.push('_');
        }
        text.push(letter.to_ascii_uppercase());
    }
    text
}

/// The doc of a class.
fn docstring(doc: &str) -> String {
    let text = plain(doc).replace('`', "");
    let lines = wrapped(&text, WIDTH - 7);
    match &lines[..] {
        [line] => format!("    \"\"\"{line}\"\"\"\n"),
        lines => {
            let lines: Vec<_> = lines.iter().map(|line| format!("    {line}")).collect();
            format!("    \"\"\"{}\n    \"\"\"\n", lines.join("\n").trim_start())
        }
    }
}

/// The doc of a value.
fn comment(doc: &str, indent: usize) -> String {
    let lines = wrapped(&plain(doc).replace('`', ""), WIDTH - indent - 3);
    lines.iter().map(|line| format!("{:indent$}#: {line}\n", "")).collect()
}

fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let last = lines.len() - 1;
        if !lines[last].is_empty() && lines[last].len() + 1 + word.len() > width {
            lines.push(word.to_owned());
        } else {
            if !lines[last].is_empty() {
                lines[last].push(' ');
            }
            lines[last].push_str(word);
        }
    }
    lines
}
