//! Reasoning that a model writes into its answer, between tags.

/// The tags around reasoning, in lower case: those of Qwen, DeepSeek and others; Claude and others; Gemini; Mistral; Kimi;
/// Sky-T1; Seed; and the channels of gpt-oss, where the answer has a channel of its own.
const TAGS: [(&str, &str); 10] = [
    ("<think>", "</think>"),
    ("<thinking>", "</thinking>"),
    ("<thought>", "</thought>"),
    ("<reasoning>", "</reasoning>"),
    ("<reflection>", "</reflection>"),
    ("[think]", "[/think]"),
    ("◁think▷", "◁/think▷"),
    ("<|begin_of_thought|>", "<|end_of_thought|>"),
    ("<seed:think>", "</seed:think>"),
    ("<|channel|>analysis", "<|channel|>final<|message|>"),
];

/// Whether a text has reasoning, and the text without it and without surrounding white space.
///
/// The answer follows the last tag that closes reasoning; some chat templates open it, so that the text only closes it. Where
/// nothing follows, what is before the reasoning is the answer. Reasoning that was cut off has none.
pub fn split_reasoning(text: &str) -> (bool, &str) {
    // Of the same length: only ASCII letters change.
    let lower = text.to_ascii_lowercase();
    let opened = |from: usize| {
        let starts = TAGS.iter().filter_map(|(open, _)| Some((lower[from..].find(open)?, open)));
        starts.min().map(|(at, open)| (from + at, open.len()))
    };
    let closed = TAGS.iter().filter_map(|(_, close)| Some((lower.rfind(close)?, close))).max();
    let before = |end: usize| &text[..opened(0).map_or(end, |(start, _)| start.min(end))];
    let (reasoning, answer) = match (closed, opened(0)) {
        (None, None) => ("", text),
        (None, Some((start, length))) => (&text[start + length..], &text[..start]),
        (Some((at, close)), first) => {
            let end = at + close.len();
            let start = first.filter(|(start, _)| *start < at);
            let reasoning = &text[start.map_or(0, |(start, length)| start + length)..at];
            let answer = &text[end..opened(end).map_or(text.len(), |(start, _)| start)];
            match (answer.trim().is_empty(), start) {
                (false, _) => (reasoning, answer),
                (true, Some(_)) => (reasoning, before(at)),
                // Only closed, and nothing follows: an answer with a stray tag.
                (true, None) => ("", before(at)),
            }
        }
    };
    (!reasoning.trim().is_empty(), answer.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasoning_is_no_answer() {
        for (text, expected) in [
            ("North", (false, "North")),
            ("<think>\n</think>North", (false, "North")),
            ("<think>hm</think>\nNorth", (true, "North")),
            ("hm</think>North", (true, "North")),
            ("<THINK>a</THINK><think>b</think> North", (true, "North")),
            ("<thinking>hm</thinking>North", (true, "North")),
            ("◁think▷hm◁/think▷North", (true, "North")),
            ("[THINK]hm[/THINK]North", (true, "North")),
            (
                "<|channel|>analysis<|message|>hm<|end|><|channel|>final<|message|>North",
                (true, "North"),
            ),
            ("North</think>", (false, "North")),
            ("North <think>hm</think>", (true, "North")),
            ("<think>hm</think>", (true, "")),
            ("<thinking>hm", (true, "")),
            ("<think>a</think>North<think>b", (true, "North")),
            ("", (false, "")),
        ] {
            assert_eq!(split_reasoning(text), expected, "{text:?}");
        }
    }
}
