//! The messages to external memories, and the items of their answers.

use std::sync::Arc;

use bytemuck::Zeroable;
use domain::ActionCode;
use peer::memory::{MemoryItem, PlanPart, Source, Views};
use search::Embedding;
use shm_types::message::{
    AnswerItem, AnswerSource, ExternalAnswer, ExternalEpisode, ExternalQuery, ItemKind, Learning,
    MAX_EMBEDDING, MAX_ITEMS, MAX_PLAN, MAX_SOURCES, NO_ACTION, action_code, write_text,
};

use crate::episode::MemoryEpisode;

/// The message that announces an episode.
pub(super) fn episode_message(episode: &MemoryEpisode, bank: u64) -> Box<ExternalEpisode> {
    let mut message = ExternalEpisode {
        episode: episode.id,
        bank,
        seed: episode.seed,
        lane: episode.lane,
        text_budget: episode.budgets.text,
        image_budget: episode.budgets.images,
        repeat: episode.repeat,
        learning: match &episode.stream {
            None => Learning::OutsideOfStreams,
            Some(_) if episode.learns() => Learning::Learns,
            Some(_) => Learning::ReadsOnly,
        } as u32,
        ..Zeroable::zeroed()
    };
    message.instruction_len = write_text(&mut message.instruction, &episode.instruction);
    Box::new(message)
}

/// The message that passes on the agent's state; `None` before the first observation.
pub(super) fn query_message(
    episode: &MemoryEpisode,
    embedding: Option<&Embedding>,
) -> Option<Box<ExternalQuery>> {
    let current = episode.current.as_ref()?;
    let mut message = Box::new(ExternalQuery {
        episode: episode.id,
        frame: current.frame,
        lane: episode.lane,
        step: current.step,
        state: current.state.padded(),
        feedback: current.feedback.0,
        action: action_code(current.action),
        last: current.is_last.into(),
        ..Zeroable::zeroed()
    });
    // Longer embeddings are refused before a run.
    if let Some(numbers) =
        embedding.map(Embedding::as_slice).filter(|all| all.len() <= MAX_EMBEDDING)
    {
        message.embedding[..numbers.len()].copy_from_slice(numbers);
        message.embedding_len = numbers.len() as u32;
    }
    Some(message)
}

/// Reads the items of an answer with the note `note`. References are not checked.
pub(crate) fn read_items(message: &ExternalAnswer, note: &[u8]) -> Result<Vec<MemoryItem>, String> {
    let within = |what: &str, count: u32, most: usize| match count as usize {
        count if count <= most => Ok(count),
        count => Err(format!("it has {count} {what}, and at most {most} are allowed")),
    };
    let count = within("items", message.items_len, MAX_ITEMS)?;
    let sources = &message.sources[..within("sources", message.sources_len, MAX_SOURCES)?];
    let items = &message.items[..count];
    for AnswerSource { item, .. } in sources {
        let of = items.get(*item as usize).map(|of| of.kind);
        if of.is_none_or(|kind| kind != ItemKind::Text as u8 && kind != ItemKind::Plan as u8) {
            return Err(format!("a source is that of item {item}, which is no text and no plan"));
        }
    }
    let read = |(number, item)| {
        read_item(number, item, sources, note).map_err(|what| format!("item {number} {what}"))
    };
    (0..).zip(items).map(read).collect()
}

fn read_item(
    number: u32,
    item: &AnswerItem,
    sources: &[AnswerSource],
    note: &[u8],
) -> Result<MemoryItem, String> {
    let &AnswerItem { first_byte, bytes, demonstration, first_step: first, steps: count, .. } =
        item;
    let in_note = || {
        let end = (first_byte as usize).checked_add(bytes as usize);
        end.and_then(|end| note.get(first_byte as usize..end)).ok_or_else(|| {
            format!("names {bytes} bytes from byte {first_byte} of a note of {} bytes", note.len())
        })
    };
    let text = || -> Result<Arc<str>, String> {
        let text = str::from_utf8(in_note()?);
        text.map(Arc::from).map_err(|error| format!("holds a text that is not UTF-8: {error}"))
    };
    let distance = Some(item.distance).filter(|distance| !distance.is_nan());
    let its_sources = || {
        let its_own = sources.iter().filter(|source| source.item == number);
        let source = |source: &AnswerSource| Source {
            demonstration: source.demonstration,
            first: source.first_step,
            count: source.steps,
        };
        its_own.map(source).collect()
    };
    match ItemKind::try_from(item.kind) {
        Ok(ItemKind::Text) => Ok(MemoryItem::Text { text: text()?, sources: its_sources() }),
        Ok(ItemKind::Steps) => {
            let views = match item.views {
                0 => Views::None,
                1 => Views::All,
                2 => {
                    let (numbers, []) = in_note()?.as_chunks() else {
                        return Err(format!(
                            "names its keyframes in {bytes} bytes, expected 4 for each"
                        ));
                    };
                    let numbers = numbers.iter().map(|bytes| u32::from_le_bytes(*bytes));
                    Views::Keyframes(numbers.collect())
                }
                code => return Err(format!("has the code {code} for its views, expected 0 to 2")),
            };
            let actions = match item.actions {
                0 => false,
                1 => true,
                code => {
                    return Err(format!("has the code {code} for its actions, expected 0 or 1"));
                }
            };
            Ok(MemoryItem::Steps {
                source: Source { demonstration, first, count },
                views,
                actions,
                distance,
            })
        }
        Ok(ItemKind::Frame) if count != 1 => {
            Err(format!("is a captioned frame of {count} steps, expected 1"))
        }
        Ok(ItemKind::Frame) => {
            Ok(MemoryItem::Frame { demonstration, step: first, caption: text()?, distance })
        }
        Ok(ItemKind::Plan) => Ok(MemoryItem::Plan { parts: read_plan(in_note()?, its_sources())? }),
        Ok(ItemKind::Trajectory) => {
            Err("is a trajectory: steps of any length have the kind of steps".to_owned())
        }
        Err(error) => Err(format!("has no valid kind: {error}")),
    }
}

/// Reads a plan whose actions are `codes`: `NO_ACTION` stands for the next step of `sources`. An error continues "item 2 ...".
fn read_plan(codes: &[u8], sources: Vec<Source>) -> Result<Vec<PlanPart>, String> {
    if codes.len() > MAX_PLAN {
        return Err(format!("plans {} actions, and at most {MAX_PLAN} are allowed", codes.len()));
    }
    let taken = codes.iter().filter(|&&code| code == NO_ACTION).count();
    let named: u64 = sources.iter().map(|source| u64::from(source.count)).sum();
    if taken as u64 != named || sources.iter().any(|source| source.count == 0) {
        return Err(format!(
            "plans the expert's actions at {taken} steps, and its {} sources name {named}",
            sources.len()
        ));
    }
    let mut parts = Vec::new();
    let mut sources = sources.into_iter();
    // What is left of a source, and whether the last part is of it.
    let (mut left, mut goes_on) = (Source { demonstration: 0, first: 0, count: 0 }, false);
    for &code in codes {
        if code != NO_ACTION {
            parts.push(PlanPart::Own(ActionCode(code)));
            goes_on = false;
            continue;
        }
        if left.count == 0 {
            (left, goes_on) = (sources.next().unwrap_or(left), false);
        }
        match parts.last_mut() {
            Some(PlanPart::Steps(last)) if goes_on => last.count += 1,
            _ => parts.push(PlanPart::Steps(Source { count: 1, ..left })),
        }
        left = Source { first: left.first.saturating_add(1), count: left.count - 1, ..left };
        goes_on = true;
    }
    Ok(parts)
}
