//! One step as text for a terminal.

use std::fmt::Write;

use domain::prompt_log::{RecordedItem, RecordedPart, RecordedUsage, RecordedView};

use results::step_view::{RecordedPrompt, StepView};

/// Characters of a text that are printed; page and JSON have all.
const MOST: usize = 2000;

/// Hexadecimal digits that identify an image.
const DIGITS: usize = 8;

/// Renders the step.
pub(super) fn render(shown: &StepView) -> String {
    let mut text = format!("{}, step {} of {}\n\n", shown.key, shown.step, shown.steps);
    let mut fact = |name: &str, value: &str| {
        let _ = writeln!(text, "{name:<10} {value}");
    };
    if let Some(prompt) = &shown.prompt {
        fact("Task", &prompt.entry.request.instruction);
    }
    fact("Pose", &format!("{} (column, row, heading)", shown.pose));
    fact("Feedback", shown.feedback);
    fact("Action", shown.action.unwrap_or("none that could be read: the agent stayed"));
    if let Some(retrieved) = &shown.retrieved {
        fact("Retrieved", &in_words(retrieved));
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

/// Where what was retrieved comes from.
pub(super) fn in_words(retrieved: &str) -> String {
    retrieved.split('+').map(source_in_words).collect::<Vec<_>>().join("; ")
}

/// One source: `o12`, `t03-07:o12`, or `-` for none.
fn source_in_words(retrieved: &str) -> String {
    let (case, view) = match retrieved.split_once(':') {
        Some((case, view)) => (format!(" of {case}, another task"), view),
        None => (String::new(), retrieved),
    };
    let (letter, step) = view.split_at(view.len().min(1));
    let which = match letter {
        "o" => "original",
        "p" => "opposite",
        "n" => "nearby",
        "d" => "distant",
        _ => return "nothing".to_owned(),
    };
    format!("view {step} of the demonstration `{which}`{case}")
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
            RecordedItem::Trajectory(hash) => demonstration(text, prompt.trajectory(hash)),
            RecordedItem::Frame { frame, caption } => {
                let _ = writeln!(text, "    image {}", short(frame));
                indented(text, prompt.text(caption));
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

/// What an item of memory is.
pub(super) fn title(item: &RecordedItem, prompt: &RecordedPrompt) -> String {
    match item {
        RecordedItem::Text { kind, text } => {
            format!("Text ({kind}), {} characters", prompt.text(text).chars().count())
        }
        RecordedItem::Segment { distance: Some(distance), .. } => {
            format!("Retrieved, at distance {distance:.4}")
        }
        RecordedItem::Segment { distance: None, .. } => "Part of a demonstration".to_owned(),
        RecordedItem::Trajectory(_) => "Demonstration".to_owned(),
        RecordedItem::Frame { .. } => "Remembered view".to_owned(),
    }
}

/// What came of the request and what it took.
pub(super) fn facts(prompt: &RecordedPrompt) -> Vec<(&'static str, String)> {
    let entry = &prompt.entry;
    let mut facts = Vec::new();
    if let Some(answer) = &entry.answer {
        let action = answer.action.as_ref().map(|action| format!(": {action}"));
        facts.push(("Outcome", format!("{}{}", answer.outcome, action.unwrap_or_default())));
        let left_out = match answer.images_asked.saturating_sub(answer.images) {
            0 => String::new(),
            some => format!(", {some} left out"),
        };
        facts.push(("Images", format!("{} shown{left_out}", answer.images)));
    }
    if let Some(why) = &entry.failed {
        facts.push(("Failed", why.clone()));
    }
    if let Some(usage) = &entry.usage {
        facts.push(("Tokens", tokens(usage)));
        let asked = match (usage.replayed, usage.attempts) {
            (true, _) => "answered from the response cache".to_owned(),
            (false, 1) => "1 attempt".to_owned(),
            (false, attempts) => format!("{attempts} attempts"),
        };
        facts.push(("Asked", asked));
    }
    let timing = &entry.timing;
    let ms = |from: u64, to: u64| format!("{:.1} ms", to.saturating_sub(from) as f64 / 1e6);
    let mut times = format!("decided after {}", ms(timing.received_ns, timing.decided_ns));
    if timing.prompted_ns > 0 {
        times += &format!(", prompt built in {}", ms(timing.started_ns, timing.prompted_ns));
    }
    if timing.sent_ns > 0 {
        times += &format!(", {} from sending to decision", ms(timing.sent_ns, timing.decided_ns));
    }
    facts.push(("Time", times));
    facts
}

fn tokens(usage: &RecordedUsage) -> String {
    let mut text = Vec::new();
    let of_prompt: Vec<String> = [
        ("cached", usage.cached_tokens),
        ("images", usage.image_tokens),
        ("memory, estimated", usage.memory_tokens),
    ]
    .into_iter()
    .filter_map(|(what, count)| Some(format!("{what} {}", count?)))
    .collect();
    let parts =
        if of_prompt.is_empty() { String::new() } else { format!(" ({})", of_prompt.join(", ")) };
    text.extend(usage.prompt_tokens.map(|count| format!("prompt {count}{parts}")));
    text.extend(usage.completion_tokens.map(|count| format!("answer {count}")));
    if text.is_empty() { "not reported".to_owned() } else { text.join(", ") }
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
        let _ = writeln!(text, "  ... {rest} more characters (--html or --json have them)");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_source_is_named() {
        insta::assert_snapshot!(in_words("o12+t03-07:n3"), @"view 12 of the demonstration `original`; view 3 of the demonstration `nearby` of t03-07, another task");
        assert_eq!(in_words("-"), "nothing");
    }
}
