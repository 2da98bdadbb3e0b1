//! An entry of the prompt log in words.

use domain::prompt_log::{RecordedActions, RecordedItem, RecordedUsage};

use super::RecordedPrompt;

/// What an item of memory is.
pub fn title(item: &RecordedItem, prompt: &RecordedPrompt) -> String {
    match item {
        RecordedItem::Text { kind, text } => {
            format!("Text ({kind}), {} characters", prompt.text(text).chars().count())
        }
        RecordedItem::Segment { distance: Some(distance), instruction, .. } => {
            format!("Retrieved, at distance {distance:.4}: {instruction}")
        }
        RecordedItem::Segment { distance: None, instruction, .. } => {
            format!("Part of a demonstration: {instruction}")
        }
        RecordedItem::Trajectory { instruction, .. } => format!("Demonstration: {instruction}"),
        RecordedItem::Frame { instruction, .. } => format!("Remembered view: {instruction}"),
        RecordedItem::Plan { parts } => {
            let actions: usize = parts.iter().map(|part| part.actions.len()).sum();
            format!("Plan of {actions} actions")
        }
    }
}

/// A part of a plan in one line: where its actions are from, and the actions; a repeated one is written once.
pub fn planned(part: &RecordedActions) -> String {
    let from = match &part.instruction {
        Some(instruction) => format!("From the demonstration of: {instruction}"),
        None => "Of the memory's own".to_owned(),
    };
    let runs = part.actions.chunk_by(|a, b| a == b).map(|run| match run.len() {
        1 => run[0].clone(),
        times => format!("{} x{times}", run[0]),
    });
    format!("{from}: {}", runs.collect::<Vec<_>>().join(", "))
}

/// What came of the request and what it took.
pub fn facts(prompt: &RecordedPrompt) -> Vec<(&'static str, String)> {
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
        ("reusable, estimated", usage.reusable_tokens),
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
