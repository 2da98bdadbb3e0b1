//! Checks of queries and episodes.

use std::time::Duration;

use shm_types::message::{ExternalAnswer, MAX_INSTRUCTION, RequestId};
use shm_types::process::monotonic_ns;

use super::{INSTRUCTION, MemoryKit, ordinary};
use crate::LANES;
use crate::checks::clear_away;
use crate::memory::answers::Supplied;
use crate::memory::{ScriptedDemonstration, TestedMemory, demonstrated, pose};
use crate::messages::{external_episode, last_query};
use crate::subject::{CheckResult, Trouble, next, wrong};

pub(super) fn a_query(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let id = subject.begin(0, bank, INSTRUCTION)?;
    let (_, items) = subject.ask_and_wait(id, 3)?;
    clear_away(subject)?;
    let images: usize = items.iter().map(|item| item.views.len()).sum();
    let bytes: usize = items.iter().map(|item| item.text.len()).sum();
    Ok(format!("its first answer: {} items, {images} images, {bytes} bytes of text", items.len()))
}

/// The end of an episode.
pub(super) fn end(subject: &mut TestedMemory<'_>, id: RequestId) -> CheckResult<()> {
    subject.expect_none(id);
    subject.neighbours.queries.send(&last_query(id, pose(0)))?;
    subject.notify()
}

pub(super) fn an_episode(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let mut id = subject.begin(1, bank, INSTRUCTION)?;
    for seed in 0..8 {
        subject.ask_and_wait(id, seed)?;
        id = next(id);
    }
    end(subject, id)?;
    clear_away(subject)
}

pub(super) fn times(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let id = subject.begin(1, bank, INSTRUCTION)?;
    let asked = monotonic_ns();
    let (ExternalAnswer { received_ns, sent_ns, .. }, _) = subject.ask_and_wait(id, 1)?;
    let arrived = monotonic_ns();
    if !(asked <= received_ns && received_ns <= sent_ns && sent_ns <= arrived) {
        return wrong(format_args!(
            "a query of {asked} ns was answered before {arrived} ns, with `received_ns` {received_ns} and \
             `sent_ns` {sent_ns}"
        ));
    }
    clear_away(subject)
}

pub(super) fn many_lanes(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    for lane in 0..LANES {
        let id = subject.begin(lane, bank, INSTRUCTION)?;
        subject.ask(id, u64::from(lane) % 8)?;
    }
    subject.wait()?;
    clear_away(subject)
}

pub(super) fn interleaved(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let mut queries = Vec::new();
    for lane in [7, 60, 2, 31, 0, 63, 12, 40, 5] {
        let mut id = subject.begin(lane, bank, INSTRUCTION)?;
        for _ in 0..lane % 4 {
            subject.ask_and_wait(id, 3)?;
            id = next(id);
        }
        queries.push(id);
    }
    for &id in &queries {
        subject.ask(id, 3)?;
    }
    subject.wait()?;
    clear_away(subject)
}

pub(super) fn small_banks(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let large = subject.remember(&ordinary())?;
    let mut banks = vec![large];
    for (number, steps) in [(0, 1), (1, 2), (2, 4)] {
        banks.push(subject.remember(&[demonstrated(INSTRUCTION, number, steps)])?);
    }
    let mut queries = Vec::new();
    for (lane, &bank) in (0..).zip(&banks) {
        queries.push(subject.begin(lane, bank, INSTRUCTION)?);
    }
    // The view at the end of the large bank's last demonstration, then one that no bank has.
    for seed in [2009, 70] {
        for id in &mut queries {
            subject.ask(*id, seed)?;
            *id = next(*id);
        }
        subject.wait()?;
    }
    clear_away(subject)
}

pub(super) fn new_episode(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let other = subject.remember(&[demonstrated("Find a red cone.", 4, 6)])?;
    // The episode ends before it is answered.
    let old = subject.begin(9, bank, INSTRUCTION)?;
    subject.ask(old, 4)?;
    let new = subject.begin(9, other, "Find a red cone.")?;
    subject.ask(new, 4)?;
    subject.wait()?;
    // A report about the old query is welcome, and none is, too.
    subject.take_errors();
    // The episode ends without its last query.
    let newer = subject.begin(9, bank, INSTRUCTION)?;
    subject.ask_and_wait(newer, 5)?;
    clear_away(subject)
}

pub(super) fn late_queries(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let old = subject.begin(3, bank, INSTRUCTION)?;
    let new = subject.begin(3, bank, INSTRUCTION)?;
    subject.ask_and_wait(new, 5)?;
    subject.expect_refusal(old);
    subject.query(old, 5)?;
    subject.notify()?;
    subject.ask_and_wait(next(new), 6)?;
    subject.listen_for(Duration::from_millis(60))?;
    // A report is welcome, and none is, too.
    subject.take_errors();
    clear_away(subject)
}

pub(super) fn many_demonstrations(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let tasks = ["Find a blue barrel.", "Find a red cone.", "Go to aisle 3, then to the gate."];
    let demonstrations: Vec<ScriptedDemonstration> = (0..1000)
        .map(|number| demonstrated(tasks[number as usize % tasks.len()], number, 12))
        .collect();
    let began = monotonic_ns();
    let bank = subject.remember(&demonstrations)?;
    let built = monotonic_ns();
    let mut id = subject.begin(5, bank, INSTRUCTION)?;
    let mut answered = 0;
    for seed in 0..4 {
        let asked = monotonic_ns();
        subject.ask_and_wait(id, seed)?;
        answered = monotonic_ns() - asked;
        id = next(id);
    }
    end(subject, id)?;
    clear_away(subject)?;
    subject.take_back(bank)?;
    let milliseconds = |ns: u64| ns as f64 / 1e6;
    let (built, answered) = (milliseconds(built - began), milliseconds(answered));
    Ok(format!("built in {built:.0} ms, answers a query in {answered:.1} ms"))
}

pub(super) fn mixed_histories(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let own = demonstrated(INSTRUCTION, 0, 10);
    let back = ScriptedDemonstration {
        instruction: "Go back to the gate.".to_owned(),
        views: own.views.iter().rev().copied().collect(),
    };
    let stays =
        ScriptedDemonstration { views: vec![7; 5], ..demonstrated("Wait at the gate.", 0, 1) };
    let mut demonstrations = vec![own.clone(), back, own, stays];
    for (number, task) in (10..).zip(["Find a red cone.", "Find a pallet jack.", "Find the exit."])
    {
        demonstrations.push(demonstrated(task, number, 3 * number % 20 + 1));
    }
    let bank = subject.remember(&demonstrations)?;
    // Also from a start that no demonstration has seen, and for a task that none shows.
    for (lane, instruction) in [(6, INSTRUCTION), (7, "Find a yellow ladder.")] {
        let mut id = subject.begin(lane, bank, instruction)?;
        for seed in [7, 3, 80] {
            subject.ask_and_wait(id, seed)?;
            id = next(id);
        }
    }
    clear_away(subject)
}

pub(super) fn texts(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let full = "ß".repeat(MAX_INSTRUCTION / 2);
    let long = "Walk along the shelf — then turn; ".repeat(300);
    let said = ["Geh zum blauen Faß, dann zurück.", "青い樽を探してください 🛢", &full, "", " "];
    let told = said.into_iter().chain([long.as_str()]);
    let demonstrations: Vec<ScriptedDemonstration> =
        (0..).zip(told).map(|(number, text)| demonstrated(text, number, 4)).collect();
    let bank = subject.remember(&demonstrations)?;
    for instruction in said {
        let id = subject.begin(11, bank, instruction)?;
        subject.ask_and_wait(id, 2)?;
    }
    clear_away(subject)
}

pub(super) fn budgets(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let mut dropped = Vec::new();
    for (lane, (images, text)) in (12..).zip([(0, 0), (1, 64), (0, 65_536), (16, 0)]) {
        let mut begun = external_episode(lane, 0, bank, INSTRUCTION);
        (begun.image_budget, begun.text_budget) = (images, text);
        let id = subject.begin_with(begun)?;
        let (_, items) = subject.ask_and_wait(id, 4)?;
        let count = items_that_do_not_fit(&items, images as usize, text as usize);
        if count > 0 {
            dropped.push(format!(
                "{count} of {} items with {images} images and {text} bytes of text",
                items.len()
            ));
        }
    }
    clear_away(subject)?;
    if dropped.is_empty() {
        return Ok(String::new());
    }
    Err(Trouble::Doubtful(format!("a run would drop {}", dropped.join(", "))))
}

/// The number of items that the memory process drops.
fn items_that_do_not_fit(items: &[Supplied], mut images: usize, mut text: usize) -> usize {
    let mut dropped = 0;
    for item in items {
        if item.views.len() <= images && item.text.len() <= text {
            images -= item.views.len();
            text -= item.text.len();
        } else {
            dropped += 1;
        }
    }
    dropped
}
