//! Checks of messages that cannot be used.

use std::time::Duration;

use shm_types::BankContent;
use shm_types::message::ExternalQuery;

use super::{INSTRUCTION, MemoryKit, ordinary};
use crate::checks::clear_away;
use crate::memory::pose;
use crate::messages::{external_episode, query};
use crate::subject::{CheckResult, Trouble, wrong};

/// A message that cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Invalid {
    Feedback,
    Heading,
    Bank,
    Instruction,
    Episode,
    Demonstration,
}

/// All of them in words.
const INVALID: [(Invalid, &str); 6] = [
    (Invalid::Feedback, "a feedback code of 77"),
    (Invalid::Heading, "a pose with heading code 77"),
    (Invalid::Bank, "an episode that remembers a bank that was never published"),
    (Invalid::Instruction, "an instruction of 4,000,000,000 bytes"),
    (Invalid::Episode, "a query of an episode that never began"),
    (Invalid::Demonstration, "a bank whose demonstration lies outside of it"),
];

pub(super) fn invalid_messages(kit: &mut MemoryKit<'_>) -> CheckResult<String> {
    let subject = kit.subject()?;
    let bank = subject.remember(&ordinary())?;
    let mut ignored = Vec::new();
    for (lane, (invalid, what)) in (20..).zip(INVALID) {
        let mut begun = external_episode(lane, 0, bank, INSTRUCTION);
        match invalid {
            Invalid::Bank => begun.bank += 1_000_000,
            Invalid::Instruction => begun.instruction_len = 4_000_000_000,
            _ => {}
        }
        let mut id = subject.begin_with(begun)?;
        if invalid == Invalid::Episode {
            id.episode += 1_000_000;
        }
        let mut refused_bank = None;
        if invalid == Invalid::Demonstration {
            let mut content: BankContent = subject.content(&ordinary())?;
            content.demonstrations[1].first_step = 1_000_000;
            refused_bank = Some(subject.publish_unusable(&content)?);
        } else {
            subject.expect_refusal(id);
            let frame = subject.seen(10)?;
            let usual = query(id, frame, pose(10), &[]);
            let sent = match invalid {
                Invalid::Feedback => ExternalQuery { feedback: 77, ..usual },
                Invalid::Heading => {
                    let mut state = usual.state;
                    state[2] = 77.0;
                    ExternalQuery { state, ..usual }
                }
                _ => usual,
            };
            subject.neighbours.queries.send(&sent)?;
        }
        subject.notify()?;
        // Queries of another lane are still answered.
        let other = subject.begin(lane + 20, bank, INSTRUCTION)?;
        if let Err(Trouble::Wrong(why)) = subject.ask_and_wait(other, 11) {
            return wrong(format_args!("after {what}: {why}"));
        }
        subject.listen_for(Duration::from_millis(40))?;
        let is_refused = refused_bank.is_some_and(|bank| subject.refused(bank));
        if subject.take_errors().is_empty() && !is_refused {
            ignored.push(what);
        }
        // The lane itself is answered again, too, in its next episode.
        let again = subject.begin(lane, bank, INSTRUCTION)?;
        subject.ask_and_wait(again, 11)?;
    }
    if !ignored.is_empty() {
        return wrong(format_args!("neither report nor failure after {}", ignored.join(", ")));
    }
    clear_away(subject)
}
