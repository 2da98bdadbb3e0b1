use bytemuck::Zeroable;
use proptest::prelude::*;

use super::*;
use domain::{ActionCode, DocumentKind, Outcome, SegmentContent};

/// Calls `$check::<M>($arguments)` for every message `M`.
macro_rules! every_message {
    ($check:ident $(, $argument:expr)*) => {
        every_message!(@ $check, ($($argument),*), WorldEpisodeConfig StepCommand Observation StepReport MemoryEpisodeConfig PolicyEpisodeConfig
            ViewRequest View Eviction Recall RecallTrace SnapshotReport ExternalEpisode ExternalQuery ExternalBuilt
            ExternalStore ExternalStored ExternalAnswer
            Heartbeat Decision Handshake ErrorReport ShutdownReport Stop)
    };
    (@ $check:ident, $arguments:tt, $($message:ident)*) => {$($check::<$message>$arguments;)*};
}

#[test]
fn codes_are_positions() {
    for (code, role) in Role::ALL.iter().enumerate() {
        assert_eq!(Role::try_from(code as u8), Ok(*role));
    }
    assert!(Role::try_from(5).is_err());
    assert!(Outcome::try_from(NO_ACTION).is_err());
    assert_eq!(read_action(NO_ACTION), Ok(None));
    assert_eq!(read_action(63), Ok(Some(ActionCode(63))));
    assert!(read_action(64).is_err());
}

#[test]
fn counts_that_are_not_known_or_not_possible_are_absent() {
    let decision = Decision {
        images_asked: 4,
        images: 3,
        attempts: 1,
        prompt_tokens: NOT_MEASURED,
        ..Zeroable::zeroed()
    };
    let counts = decision.counts();
    assert_eq!((counts.images_asked, counts.images), (Some(4), Some(3)));
    assert_eq!((counts.attempts, counts.prompt_tokens), (Some(1), None));
    let unknown = Decision {
        images_asked: NOT_MEASURED,
        images: NOT_MEASURED,
        attempts: NOT_MEASURED,
        ..decision
    };
    let counts = unknown.counts();
    assert_eq!((counts.images_asked, counts.images, counts.attempts), (None, None, None));
    assert_eq!(Decision { images: 5, ..decision }.counts().images, None);
    assert_eq!(Decision { attempts: NOT_MEASURED - 1, ..decision }.counts().attempts, None);
}

#[test]
fn every_message_has_senders_and_receivers() {
    fn check<M: Message>() {
        assert!(!M::FROM.is_empty() && !M::TO.is_empty(), "{}", M::SERVICE);
        assert!(M::FROM.iter().all(|role| !M::TO.contains(role)), "{}", M::SERVICE);
    }
    every_message!(check);
}

proptest! {
    /// Whatever arrives is a value or an error.
    #[test]
    fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 8192)) {
        fn check<M: Message>(bytes: &[u8]) {
            let message: M = bytemuck::pod_read_unaligned(&bytes[..size_of::<M>()]);
            let _ = format!("{message:?}");
        }
        every_message!(check, &bytes);

        for &byte in &bytes {
            let _ = (StepKind::try_from(byte), ViewRequestKind::try_from(byte));
            let _ = (Outcome::try_from(byte), Role::try_from(byte));
            let _ = read_action(byte);
            let _ = (DocumentKind::try_from(byte), SegmentContent::try_from(byte));
            let _ = ErrorReportKind::try_from(byte);
        }
        let handshake: Handshake = bytemuck::pod_read_unaligned(&bytes[..size_of::<Handshake>()]);
        let _ = read_text(&handshake.facts, handshake.facts_len);
        for len in 0..=u32::from(u8::MAX) {
            if let Ok(text) = read_text(&bytes[..240], len) {
                let mut buffer = [0; 240];
                prop_assert_eq!(write_text(&mut buffer, text), len);
            }
        }
    }

    /// What is written is read, up to what fits.
    #[test]
    fn text_round_trips(text in any::<String>()) {
        let mut buffer = [0; 24];
        let used = write_text(&mut buffer, &text);
        let read = read_text(&buffer, used).map_err(|e| TestCaseError::fail(e.to_string()))?;
        prop_assert!(text.starts_with(read) && (read == text || read.len() > 20));
    }
}

#[test]
fn text_is_cut_at_a_character_and_read_with_care() {
    let mut buffer = [0; 4];
    let used = write_text(&mut buffer, "abcé");
    assert_eq!(read_text(&buffer, used), Ok("abc"));
    assert!(read_text(&buffer, 5).is_err());
    assert!(read_text(&[0xff; 4], 4).is_err());
}

/// Times of the run say whether a view was resident, and how long a memory took.
#[test]
fn what_policies_and_memories_are_told_has_no_times() {
    let told = |description: &&Description| {
        let is_theirs = |role: &Role| matches!(role, Role::Policy | Role::ExternalMemory);
        description.to.iter().any(is_theirs)
    };
    let told: Vec<_> = MESSAGES.iter().filter(told).collect();
    assert!(told.len() >= 8, "{told:?}");
    for Description { layout, .. } in told {
        let times = layout.fields.iter().filter(|field| field.name.ends_with("_ns"));
        assert_eq!(times.map(|field| field.name).collect::<Vec<_>>(), [""; 0], "{}", layout.name);
    }
}
