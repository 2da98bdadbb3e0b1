//! What an answer of an external memory supplies, and whether it may.
//!
//! Written from the wire document, apart from the host's own reading in the memory process: the two have to agree.

use std::fmt;

use shm_types::message::{
    AnswerItem, AnswerSource, ExternalAnswer, ItemKind, MAX_ITEMS, MAX_PLAN, MAX_SOURCES, NO_ACTION,
};

/// Consecutive steps of a demonstration: its number, the first step, the number of steps.
type Steps = (u32, u32, u32);

/// One item of an answer.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Supplied {
    kind: ItemKind,
    /// The text or the caption.
    pub(crate) text: String,
    /// Where it comes from.
    sources: Vec<Steps>,
    /// The steps whose views are supplied.
    pub(crate) views: Vec<u32>,
    actions: bool,
    /// The codes of a plan.
    planned: Vec<u8>,
    distance: Option<f32>,
}

impl fmt::Display for Supplied {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, text, sources, views, actions, planned, distance } = self;
        let kind = match kind {
            ItemKind::Text => "a text",
            ItemKind::Trajectory => "a trajectory",
            ItemKind::Frame => "a captioned frame",
            ItemKind::Steps => "steps",
            ItemKind::Plan => "a plan",
        };
        let mut parts = Vec::new();
        for (demonstration, first, count) in sources {
            parts.push(match count {
                1 => format!("step {first} of demonstration {demonstration}"),
                _ => format!(
                    "steps {first} to {} of demonstration {demonstration}",
                    first + count - 1
                ),
            });
        }
        parts.push(format!("{} views", views.len()));
        parts.extend(actions.then(|| "actions".to_owned()));
        parts.extend((!planned.is_empty()).then(|| format!("planned actions {planned:?}")));
        parts.extend(distance.map(|distance| format!("distance {distance}")));
        parts.extend((!text.is_empty()).then(|| format!("{text:?}")));
        write!(f, "{kind} ({})", parts.join(", "))
    }
}

/// Where two answers differ.
pub(super) fn difference(one: &[Supplied], other: &[Supplied]) -> String {
    let pairs = one.iter().zip(other);
    match (0..).zip(pairs).find(|(_, (one, other))| one != other) {
        Some((number, (one, other))) => format!("item {number} is {one}, then {other}"),
        None => format!("{} items, then {}", one.len(), other.len()),
    }
}

/// Reads an answer for an episode whose bank has demonstrations with these numbers of steps, in a world with `actions` actions.
///
/// # Errors
/// When it is not valid: why.
pub(super) fn read(
    message: &ExternalAnswer,
    note: Result<&[u8], &String>,
    demonstrations: &[u32],
    actions: usize,
) -> Result<Vec<Supplied>, String> {
    let note = note.map_err(Clone::clone)?;
    if message.failed > 1 {
        return Err(format!("`failed` is {}, and may be 0 or 1", message.failed));
    }
    let items = message.items.get(..message.items_len as usize).ok_or_else(|| {
        format!("it has {} items, and at most {MAX_ITEMS} are allowed", message.items_len)
    })?;
    let sources = message.sources.get(..message.sources_len as usize).ok_or_else(|| {
        format!("it has {} sources, and at most {MAX_SOURCES} are allowed", message.sources_len)
    })?;
    if let Some(source) = sources.iter().find(|source| source.item >= message.items_len) {
        return Err(format!("a source is of item {}, which the answer does not have", source.item));
    }
    let reader = Reader { note, demonstrations, actions, sources };
    let items = (0..).zip(items).map(|(number, item)| {
        reader.item(number, item).map_err(|what| format!("item {number} {what}"))
    });
    items.collect()
}

struct Reader<'a> {
    note: &'a [u8],
    demonstrations: &'a [u32],
    actions: usize,
    sources: &'a [AnswerSource],
}

impl Reader<'_> {
    fn item(&self, number: u32, item: &AnswerItem) -> Result<Supplied, String> {
        let kind = ItemKind::try_from(item.kind)
            .map_err(|_| format!("has kind {}, and there is none of that code", item.kind))?;
        let distance = Some(item.distance).filter(|distance| !distance.is_nan());
        if let Some(distance) = distance.filter(|distance| !distance.is_finite()) {
            return Err(format!("has the distance {distance}"));
        }
        let nothing = Supplied {
            kind,
            text: String::new(),
            sources: Vec::new(),
            views: Vec::new(),
            actions: false,
            planned: Vec::new(),
            distance,
        };
        let its_own = || self.steps(item.demonstration, item.first_step, item.steps);
        match kind {
            ItemKind::Text => {
                Ok(Supplied { text: self.text(item)?, sources: self.sources(number)?, ..nothing })
            }
            ItemKind::Plan => {
                let sources = self.sources(number)?;
                let planned = self.plan(item, &sources)?;
                Ok(Supplied { sources, planned, ..nothing })
            }
            ItemKind::Frame if item.steps != 1 => {
                Err(format!("is a captioned view of {} steps", item.steps))
            }
            ItemKind::Frame => Ok(Supplied {
                text: self.text(item)?,
                sources: vec![its_own()?],
                views: vec![item.first_step],
                ..nothing
            }),
            ItemKind::Steps => {
                let steps = its_own()?;
                let views = self.views(item)?;
                if item.actions > 1 {
                    return Err(format!("has `actions` {}, which may be 0 or 1", item.actions));
                }
                if views.is_empty() && item.actions == 0 {
                    return Err("has neither views nor actions".to_owned());
                }
                Ok(Supplied { sources: vec![steps], views, actions: item.actions == 1, ..nothing })
            }
            ItemKind::Trajectory => {
                Err("is a trajectory: steps of any length have the kind of steps".to_owned())
            }
        }
    }

    /// The sources of an item.
    fn sources(&self, number: u32) -> Result<Vec<Steps>, String> {
        let sources = self.sources.iter().filter(|source| source.item == number);
        let steps = |of: &AnswerSource| self.steps(of.demonstration, of.first_step, of.steps);
        sources.map(steps).collect()
    }

    /// The codes of a plan whose sources are `sources`.
    fn plan(&self, item: &AnswerItem, sources: &[Steps]) -> Result<Vec<u8>, String> {
        let codes = self.bytes(item)?;
        if codes.len() > MAX_PLAN {
            return Err(format!(
                "plans {} actions, and at most {MAX_PLAN} are allowed",
                codes.len()
            ));
        }
        let (expert, own): (Vec<u8>, Vec<u8>) = codes.iter().partition(|&&code| code == NO_ACTION);
        if let Some(code) = own.iter().find(|&&code| usize::from(code) >= self.actions) {
            let count = self.actions;
            return Err(format!("plans action {code}, and the world has {count} (from 0)"));
        }
        let named: u32 = sources.iter().map(|(_, _, count)| count).sum();
        if expert.len() != named as usize {
            return Err(format!(
                "has `NO_ACTION` for {} steps, and its sources name {named}",
                expert.len()
            ));
        }
        // The last step of a demonstration has no action.
        let acts = |&(demonstration, first, count): &Steps| {
            let last = self.demonstrations[demonstration as usize] - 1;
            count > 1 || first < last
        };
        if own.is_empty() && !sources.iter().any(acts) {
            return Err("is a plan without actions".to_owned());
        }
        Ok(codes.to_vec())
    }

    /// Steps of the bank.
    fn steps(&self, demonstration: u32, first: u32, count: u32) -> Result<Steps, String> {
        let all = self.demonstrations.len();
        let length = self.demonstrations.get(demonstration as usize).ok_or_else(|| {
            format!("names demonstration {demonstration}, and the bank has {all} (from 0)")
        })?;
        if count == 0 || u64::from(first) + u64::from(count) > u64::from(*length) {
            return Err(format!(
                "names {count} steps from step {first} of demonstration {demonstration}, which has {length} (from 0)"
            ));
        }
        Ok((demonstration, first, count))
    }

    /// The numbers of the steps whose views an item supplies.
    fn views(&self, item: &AnswerItem) -> Result<Vec<u32>, String> {
        let steps = item.first_step..item.first_step + item.steps;
        match item.views {
            0 => Ok(Vec::new()),
            1 => Ok(steps.collect()),
            2 => {
                let (numbers, rest) = self.bytes(item)?.as_chunks();
                let views: Vec<u32> = numbers.iter().copied().map(u32::from_le_bytes).collect();
                let inside = views.iter().all(|view| steps.contains(view));
                if !rest.is_empty() || !inside || !views.is_sorted_by(|a, b| a < b) {
                    return Err(format!(
                        "lists the views {views:?} and {} bytes; expected: ascending numbers of its steps {steps:?}",
                        rest.len()
                    ));
                }
                Ok(views)
            }
            code => Err(format!("has `views` {code}, which may be 0 to 2")),
        }
    }

    fn bytes(&self, item: &AnswerItem) -> Result<&[u8], String> {
        let AnswerItem { first_byte, bytes, .. } = *item;
        let end = u64::from(first_byte) + u64::from(bytes);
        if end > self.note.len() as u64 {
            return Err(format!(
                "names {bytes} bytes from byte {first_byte} of the note, which has {}",
                self.note.len()
            ));
        }
        Ok(&self.note[first_byte as usize..end as usize])
    }

    fn text(&self, item: &AnswerItem) -> Result<String, String> {
        let text = str::from_utf8(self.bytes(item)?);
        text.map(str::to_owned).map_err(|error| format!("has a text that is not UTF-8: {error}"))
    }
}
