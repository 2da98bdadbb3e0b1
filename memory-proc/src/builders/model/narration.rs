//! A demonstration in words, for a prompt.

use std::collections::BTreeSet;
use std::fmt::Write;

use domain::{Action, Pose};
use plates::{Landmark, Plate};

use crate::builders::Transcript;
use crate::builders::names::CatalogueNames;

/// Narrates demonstration `number`. Consecutive equal steps without an event become one line, and an item is named when
/// it is first seen. Names are those in the demonstration's own instruction.
pub(super) fn narrate(number: usize, transcript: &Transcript) -> String {
    let Transcript { instruction, steps } = transcript;
    let names = CatalogueNames::of(instruction);
    let mut text = format!("## Demonstration {number}\nTask: \"{instruction}\"\n");
    let mut repeated: Option<(Action, u32)> = None;
    let mut known: BTreeSet<Landmark> = BTreeSet::new();
    let mut previous: Option<Pose> = None;
    let mut completed = 0;
    for (index, step) in steps.iter().enumerate() {
        let mut landmarks = step.seen.landmarks.clone();
        landmarks.sort_unstable();
        landmarks.retain(|landmark| known.insert(*landmark));
        // An action that changed nothing.
        let blocked = previous.replace(step.pose) == Some(step.pose);
        let changes = repeated.is_some_and(|(action, _)| step.action != Some(action));
        let eventful = !landmarks.is_empty() || step.completed > completed || blocked || changes;
        if eventful && let Some((action, times)) = repeated.take() {
            let times = if times > 1 { format!(" {times}") } else { String::new() };
            // Writing to a string cannot fail, here and below.
            let _ = writeln!(text, "- {}{times}: at {}", action.words(), place(step.pose));
        }
        if index == 0 {
            let _ = writeln!(text, "- start: at {}", place(step.pose));
        }
        if blocked {
            text.push_str("- the way is blocked\n");
        }
        for Landmark { standpoint, face, plate } in landmarks {
            let (label, code) = (names.label(plate), plate_code(plate));
            let _ = writeln!(
                text,
                "- sees {label} [plate {code}]: stand at {standpoint} facing {face}"
            );
        }
        if step.completed > completed {
            completed = step.completed;
            let _ = writeln!(text, "- sub-goal {completed} of the task is completed");
        }
        if let Some(action) = step.action {
            let times = repeated.map_or(0, |(_, times)| times);
            repeated = Some((action, times + 1));
        }
    }
    text
}

fn place(pose: Pose) -> String {
    format!("{} facing {}", pose.cell, pose.heading)
}

/// A plate as documents write it: `061-245`.
fn plate_code(plate: Plate) -> String {
    let [a, b, c, d, e, f] = plate.0;
    format!("{a}{b}{c}-{d}{e}{f}")
}
