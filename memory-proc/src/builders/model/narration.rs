//! A demonstration in words, for a prompt.

use std::fmt::Write;

use case_book::{Demonstration, WorldDeclaration};

/// Narrates demonstration `number` in the words of `world`. Consecutive equal actions without an event become one line.
pub(super) fn narrate(number: usize, world: &WorldDeclaration, of: &Demonstration) -> String {
    let mut text = format!("## Demonstration {number}\nTask: \"{}\"\n", of.instruction);
    // Writing to a string cannot fail, here and below.
    let _ = writeln!(text, "- start: {}", world.sentence(&of.states[0]));
    let stages = of.stages();
    let mut times = 0;
    for (step, (action, states)) in of.actions.iter().zip(of.states.windows(2)).enumerate() {
        let step = step + 1;
        times += 1;
        let has_effect = states[0] != states[1];
        let completes = stages[step] > stages[step - 1];
        let next_differs = of.actions.get(step) != Some(action);
        let next_has_none = of.states.get(step) == of.states.get(step + 1);
        if next_differs || next_has_none || completes || !has_effect {
            let repeated = if times > 1 { format!(" {times}") } else { String::new() };
            let (words, state) = (world.action_words(*action), world.sentence(&states[1]));
            let _ = writeln!(text, "- {words}{repeated}: {state}");
            times = 0;
        }
        if !has_effect {
            let _ = writeln!(text, "- told: {}", world.feedback_sentence(of.feedback[step]));
        }
        if completes {
            let _ = writeln!(text, "- sub-goal {} of the task is completed", stages[step]);
        }
    }
    text
}
