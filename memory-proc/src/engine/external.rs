//! What external memories say, and what becomes of the episodes that wait for them.

use shm_types::Note;
use shm_types::message::{ExternalAnswer, ExternalBuilt, ExternalStored};

use super::Engine;
use crate::episode::{MemoryAnswer, MemoryEpisode, PendingStage, Reason};
use crate::external::ToExternal;

impl<I: Clone> Engine<I> {
    /// Takes a note of an external memory, which its next answer may name.
    ///
    /// # Errors
    /// When it names a lane that does not exist.
    pub fn external_note(&mut self, index: u8, note: Note) -> Result<(), String> {
        self.externals.take_note(index, self.lanes.len() as u32, note)
    }

    /// Takes the message that an external memory has built itself from a bank.
    ///
    /// # Errors
    /// When that is not expected.
    pub fn external_built(&mut self, index: u8, message: &ExternalBuilt) -> Result<(), String> {
        self.externals.hear(index);
        let outcome = self.externals.built(index, message)?;
        self.finish_bank(message.bank, outcome);
        Ok(())
    }

    /// Takes the message that an external memory has saved or loaded.
    ///
    /// # Errors
    /// When that is not expected.
    pub fn external_stored(&mut self, index: u8, message: &ExternalStored) -> Result<(), String> {
        self.externals.hear(index);
        self.externals.has_stored(index, message)
    }

    /// Takes the answer of an external memory. An invalid answer costs the episode that it belongs to.
    ///
    /// # Errors
    /// When it belongs to no running episode of that memory.
    pub fn external_answer(
        &mut self,
        index: u8,
        message: &ExternalAnswer,
        now_ns: u64,
    ) -> Result<(), String> {
        let &ExternalAnswer { lane, episode, step, .. } = message;
        self.externals.hear(index);
        let items = self.externals.items(index, message);
        let in_time = self.externals.check_time(index, message);
        let name = self.externals.name(index);
        let place = self.lanes.get_mut(lane as usize).and_then(|lane| lane.running.as_mut());
        let is_its_own = |running: &&mut MemoryEpisode| {
            running.id == episode && running.external() == Some(index)
        };
        let Some(running) = place.filter(is_its_own) else {
            return Err(format!(
                "answer of external memory {name} for episode {episode} in lane {lane}, which is no running episode \
                 of it"
            ));
        };
        let now = running.current.as_ref().map_or(0, |now| now.step);
        let Some(pending) = &running.pending else {
            return Err(format!(
                "answer of external memory {name} for step {step} of episode {episode}, after it was answered or given up"
            ));
        };
        let refused =
            |why: String| Reason::from(format!("external memory {name}, step {step}: {why}"));
        let checked = match pending.stage {
            PendingStage::Asked { bank, since_ns } if now == step => in_time.and_then(|()| {
                let checked = items.and_then(|items| running.checked(items, self.library.world()));
                checked.map(|checked| (checked, bank, since_ns)).map_err(refused)
            }),
            _ => {
                let why = format!("it answers step {step}, and the last question was step {now}");
                Err(refused(why))
            }
        };
        match checked {
            Ok((checked, bank, embedded_ns)) => {
                let store_bytes = match message.store_bytes {
                    0 => self.externals.store_bytes(bank),
                    told => told,
                };
                let method_ns = message.sent_ns.saturating_sub(message.received_ns);
                let answer = MemoryAnswer {
                    checked,
                    embedded_ns,
                    searched_ns: now_ns,
                    method_ns: method_ns.min(now_ns.saturating_sub(embedded_ns)),
                    store_bytes,
                    tokens: message.tokens,
                    pinned: false,
                };
                if let Some(pending) = &mut running.pending {
                    pending.stage = PendingStage::Answered(Box::new(answer));
                    self.pending.insert(lane);
                }
            }
            Err(why) => self.fail(lane, why),
        }
        Ok(())
    }

    /// A message could not be sent to an external memory: what waits for it fails.
    pub fn external_unreachable(&mut self, index: u8, message: &ToExternal, why: &str) {
        let why = format!("external memory {}: {why}", self.externals.name(index));
        match message {
            ToExternal::Bank(id, _) => self.finish_bank(*id, Err(why.into())),
            // What waits for it fails when its time is over.
            ToExternal::TakeBack(_) | ToExternal::Store(_) => {}
            ToExternal::Episode(message) => self.fail_episode(message.lane, message.episode, why),
            ToExternal::Query(message) => self.fail_episode(message.lane, message.episode, why),
        }
    }

    /// An external memory has closed its queues.
    pub fn external_left(&mut self, index: u8, now_ns: u64) {
        self.externals.has_left(index, now_ns);
    }

    /// Fails the episodes of external memories that have left.
    pub(super) fn fail_deserted(&mut self, now_ns: u64) {
        for lane in 0..self.lanes.len() as u32 {
            let running = self.lanes[lane as usize].running.as_ref();
            let external = running.and_then(MemoryEpisode::external);
            if let Some(why) = external.and_then(|index| self.externals.gone(index, now_ns)) {
                self.fail(lane, why);
            }
        }
    }

    fn fail_episode(&mut self, lane: u32, episode: u64, why: String) {
        let running = self.lanes.get(lane as usize).and_then(|lane| lane.running.as_ref());
        if running.is_some_and(|running| running.id == episode) {
            self.fail(lane, why);
        }
    }
}
