//! An episode, or one step of it, as text for a terminal.

use std::fmt::Write;

use domain::prompt_log::{RecordedItem, RecordedPart, RecordedView};
use report::table::table;
use run_log::source::{SourceStep, distances, sources};
use run_log::step_view::{RecordedPrompt, facts, planned, title};
use world_client::TimelineStep;

use super::{ShownEpisode, ShownStep};

/// Characters of a text that are printed; JSON has all.
const MOST: usize = 2000;

/// Hexadecimal digits that identify an image.
const DIGITS: usize = 8;

/// Renders the episode.
pub(super) fn episode(shown: &ShownEpisode) -> String {
    let ShownEpisode { key, policy, reference, events, points, steps } = shown;
    let mut text = format!("{key}: {} steps; the reference has {reference}\n", steps.len());
    let _ = writeln!(text, "{}", policy.sentence("Policy"));
    for event in *events {
        let _ = writeln!(text, "  after {:>3}  {}", event.step, event.words);
    }
    if points.is_some_and(|points| points.loops.is_none()) {
        let _ = writeln!(text, "  Loops are not recorded in this log.");
    }
    let mut rows = table(&["Step", "State", "Feedback", "Action", "Retrieved", "Distances"], 0);
    (1..6).for_each(|column| rows.set_text(column));
    for (number, step) in steps.iter().enumerate() {
        let TimelineStep { state_text, feedback, action, retrieved, distances, .. } = step;
        let column = |word: &Option<&str>| word.unwrap_or_default().to_owned();
        rows.add_row([
            number.to_string(),
            state_text.clone(),
            feedback.clone(),
            action.as_deref().unwrap_or("?").to_owned(),
            column(retrieved),
            column(distances),
        ]);
    }
    let _ = write!(text, "{rows}");
    text
}

/// Renders the step.
pub(super) fn step(shown: &ShownStep) -> String {
    let mut text = format!("{}, step {} of {}\n\n", shown.key, shown.step, shown.steps);
    let mut fact = |name: &str, value: &str| {
        let _ = writeln!(text, "{name:<10} {value}");
    };
    if let Some(prompt) = &shown.prompt {
        fact("Task", &prompt.entry.request.instruction);
    }
    let TimelineStep { state_text, feedback, action, retrieved, distances: told, .. } =
        shown.logged;
    fact("State", state_text);
    fact("Feedback", feedback);
    let stayed = "none that could be read: the agent stayed";
    fact("Action", action.as_deref().unwrap_or(stayed));
    if let Some(retrieved) = retrieved {
        let told = distances(told.unwrap_or_default());
        let told = told.into_iter().chain(std::iter::repeat(None));
        let in_words = |(source, distance): (SourceStep, Option<f64>)| match distance {
            Some(distance) => format!("{} (distance {distance})", source.in_words()),
            None => source.in_words(),
        };
        let words: Vec<String> = sources(retrieved).into_iter().zip(told).map(in_words).collect();
        let words = words.join("; ");
        fact("Retrieved", if words.is_empty() { "nothing" } else { &words });
    }
    match &shown.prompt {
        Some(prompt) => prompt_text(&mut text, prompt),
        None => text.push_str(
            "\nThe run has no prompt log of this step. Prompts are logged while episodes run: give the run's\n\
             command again with --log-prompts and another --out.\n",
        ),
    }
    text
}

fn prompt_text(text: &mut String, prompt: &RecordedPrompt) {
    let request = &prompt.entry.request;
    let _ = writeln!(text, "{:<10} image {}", "View", short(&request.frame));
    if request.starts_as_demonstrated {
        let _ = writeln!(text, "{:<10} a demonstration started where this episode did", "Hint");
    }
    if request.demonstrated_elsewhere {
        let _ = writeln!(text, "{:<10} the memory was made in another warehouse", "Hint");
    }
    let _ = writeln!(text, "\nWindow, oldest first");
    if request.window.is_empty() {
        let _ = writeln!(text, "  empty");
    }
    for past in &request.window {
        let action = past.action.as_deref().unwrap_or("not understood");
        let _ = writeln!(text, "  image {}  {action:<14} {}", short(&past.frame), past.feedback);
    }
    let _ = writeln!(text, "\nMemory");
    if request.items.is_empty() {
        let _ = writeln!(text, "  nothing");
    }
    for item in &request.items {
        let _ = writeln!(text, "  {}", title(item, prompt));
        match item {
            RecordedItem::Text { kind, text: hash } if kind == "note" => {
                indented(text, prompt.text(hash));
            }
            RecordedItem::Text { .. } => {}
            RecordedItem::Segment { steps, .. } => demonstration(text, steps),
            RecordedItem::Trajectory { steps, .. } => {
                demonstration(text, prompt.trajectory(steps));
            }
            RecordedItem::Frame { frame, caption, .. } => {
                let _ = writeln!(text, "    image {}", short(frame));
                indented(text, prompt.text(caption));
            }
            RecordedItem::Plan { parts } => {
                parts.iter().for_each(|part| indented(text, &planned(part)));
            }
        }
    }
    if let Some(exchange) = &prompt.entry.exchange {
        for message in &exchange.messages {
            let _ = writeln!(text, "\nMessage of role {}", message.role);
            for part in &message.parts {
                match part {
                    RecordedPart::Text(content) => indented(text, content),
                    RecordedPart::Stored(hash) => indented(text, prompt.text(hash)),
                    // Never in a log.
                    RecordedPart::Png(_) => {}
                    RecordedPart::Image(hash) => {
                        let _ = writeln!(text, "  [image {}]", short(hash));
                    }
                }
            }
        }
        let _ = writeln!(text, "\nReply");
        indented(text, exchange.reply.as_deref().unwrap_or("(none)"));
        if let Some(why) = &exchange.unread {
            let _ = writeln!(text, "  No action could be read in it: {why}");
        }
    }
    text.push('\n');
    for (name, value) in facts(prompt) {
        let _ = writeln!(text, "{name:<10} {value}");
    }
}

fn demonstration(text: &mut String, steps: &[RecordedView]) {
    for (index, seen) in steps.iter().enumerate() {
        let view = seen
            .frame
            .as_deref()
            .map_or_else(|| "-".to_owned(), |hash| format!("image {}", short(hash)));
        let action = seen.action.as_deref().unwrap_or("");
        let _ = writeln!(text, "    {index:>3}  {view:<16} {action}");
    }
}

fn short(hash: &str) -> &str {
    hash.get(..DIGITS).unwrap_or(hash)
}

fn indented(text: &mut String, content: &str) {
    let shown: String = content.chars().take(MOST).collect();
    for line in shown.trim_end().lines() {
        let _ = writeln!(text, "  {line}");
    }
    let rest = content.chars().count().saturating_sub(MOST);
    if rest > 0 {
        let _ = writeln!(text, "  ... {rest} more characters (--json has them)");
    }
}

#[cfg(test)]
mod tests {
    use domain::{FeedbackCode, State};
    use rigs::records::{manifest, world};
    use scores::FailurePoints;
    use world_client::frames::ViewKey;
    use world_client::{EpisodeEvent, EventLevel};

    use super::*;

    #[test]
    fn an_episode_is_told_step_by_step() {
        let event = |step, words: &str| EpisodeEvent {
            step,
            level: EventLevel::Info,
            words: words.to_owned(),
        };
        let world = world().declaration;
        let step = |step, row, feedback_code, action: Option<&str>, retrieved| {
            let state = State::new(&[1.0, row, 0.0]).unwrap();
            TimelineStep {
                step,
                state,
                state_text: world.state_text(&state),
                feedback: world.feedback_sentence(feedback_code).to_owned(),
                feedback_code,
                action: action.map(str::to_owned),
                sub_goals: 0,
                retrieved,
                distances: None,
                view: ViewKey::State(0, state),
            }
        };
        let shown = ShownEpisode {
            key: "episodic/original/unchanged/original/run1/a",
            policy: manifest().policy_label(),
            reference: 8,
            events: &[event(1, "sub-goal 1 of 2 is met"), event(3, "failed: never-saw")],
            points: Some(&FailurePoints { last_progress: 1, loops: None, divergence: None }),
            steps: &[
                step(0, 2.0, FeedbackCode::START, Some("move forward"), Some("o12")),
                step(1, 3.0, FeedbackCode(1), None, Some("-")),
                step(2, 3.0, world.not_understood(), Some("turn left"), Some("o3+n4")),
            ],
        };
        insta::assert_snapshot!(episode(&shown), @"
        episodic/original/unchanged/original/run1/a: 3 steps; the reference has 8
        Policy: grounded, scripted stand-in. It tests the harness; its figures are no claim about any model.
          after   1  sub-goal 1 of 2 is met
          after   3  failed: never-saw
          Loops are not recorded in this log.
        ────────────────────────────────────────────────────────────────────────────────────────────────────
        Step  State      Feedback                                         Action        Retrieved  Distances
        ────────────────────────────────────────────────────────────────────────────────────────────────────
           0  1,2,north  The episode has just begun.                      move forward  o12
           1  1,3,north  You moved.                                       ?             -
           2  1,3,north  Your last answer was not understood: you did     turn left     o3+n4
                         not move.
        ────────────────────────────────────────────────────────────────────────────────────────────────────
        ");
    }
}
