//! The banks that external memories build themselves from.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use bytemuck::Zeroable;
use domain::Demonstrations;
use shm_types::MemoryDescription;
use shm_types::description::Scope;
use shm_types::message::{
    ExternalBuilt, ExternalStore, ExternalStored, MAX_FOLDER, MemoryEpisodeConfig, write_text,
};

use super::{ExternalMemories, ToExternal, is_over};
use crate::bank::{BankSteps, Collecting, MemoryBank};
use crate::demonstrations::DemonstrationLibrary;
use crate::embedded_views::EmbeddedViews;
use crate::episode::{AnnouncedMemory, MemoryKind, Reason, Unready};

/// Banks without an episode that are kept built.
const KEPT_BANKS: usize = 64;

/// A question that is so much older than a bank has been taken before it: an idle memory wakes up sooner.
const WAKE_NS: u64 = 200_000_000;

/// A bank of an external memory.
#[derive(Debug)]
pub(super) struct HostBank {
    pub(super) index: u8,
    /// The case, unless the bank is of all cases, and the set; `None`: it belongs to a sequence.
    of: Option<(Option<u32>, Demonstrations)>,
    bank: Arc<MemoryBank>,
    pins_bank: bool,
    embeds: bool,
    with_frames: bool,
    /// The episodes that wait for it or use it.
    users: u32,
    state: BankState,
    /// The saving or loading of what its memory knows.
    store: Option<StoreState>,
}

/// How far the building of a bank has got.
#[derive(Debug)]
enum BankState {
    /// The first so many views are ready.
    Waiting { ready: usize },
    /// Views are pinned and embedded a few at a time.
    Collecting(Collecting),
    /// Published, and being built.
    Building(Building),
    /// Built.
    Ready { store_bytes: u64 },
    /// Not built, and why.
    Failed(Reason),
}

#[derive(Debug)]
struct Building {
    /// When the bank was published.
    published_ns: u64,
    /// How many messages its memory had sent then.
    messages: u64,
    /// When its memory may have begun to build it.
    since_ns: u64,
}

/// How far saving or loading has got.
#[derive(Debug)]
enum StoreState {
    /// The memory has been asked to.
    Asked { since_ns: u64 },
    /// It has: bytes of its store. Or why not.
    Done(Result<u64, Reason>),
}

impl ExternalMemories {
    /// The memory of an episode outside of sequences, with the bank that it remembers.
    pub(crate) fn of_bank(
        &mut self,
        config: &MemoryEpisodeConfig,
        set: Demonstrations,
        library: &DemonstrationLibrary,
    ) -> Result<AnnouncedMemory, String> {
        let &MemoryEpisodeConfig { external: index, case, .. } = config;
        let &MemoryDescription { scope, embeddings: embeds, frames, .. } =
            self.description(index)?;
        let of = Some(((scope == Scope::Case).then_some(case), set));
        let known = self.banks.iter().find(|(_, bank)| bank.index == index && bank.of == of);
        let id = match known {
            Some((&id, _)) => id,
            None => {
                let chosen = match scope {
                    Scope::Case => library.of_case(case, set),
                    Scope::All => library.of_all_cases(set),
                };
                let chosen =
                    chosen.ok_or_else(|| format!("demonstrations {set}, which do not exist"))?;
                let bank = Arc::new(MemoryBank::new(chosen));
                let pins_bank = scope == Scope::Case && (embeds || frames);
                let state = match scope {
                    Scope::All if embeds => BankState::Collecting(Collecting::new(&bank)),
                    Scope::Case | Scope::All => BankState::Waiting { ready: 0 },
                };
                let id = self.add(HostBank {
                    index,
                    of,
                    bank,
                    pins_bank,
                    embeds,
                    with_frames: pins_bank && frames,
                    users: 0,
                    state,
                    store: None,
                });
                self.unused.push_back(id);
                id
            }
        };
        let &HostBank { ref bank, pins_bank, embeds, .. } = &self.banks[&id];
        let kind = MemoryKind::External { index, bank: Some(id) };
        Ok(AnnouncedMemory { kind, bank: bank.clone(), pins_bank, embeds })
    }

    /// The memory of an episode of a sequence.
    pub(crate) fn of_sequence(
        &self,
        config: &MemoryEpisodeConfig,
    ) -> Result<AnnouncedMemory, String> {
        let embeds = self.description(config.external)?.embeddings;
        let kind = MemoryKind::External { index: config.external, bank: None };
        Ok(AnnouncedMemory { kind, bank: Arc::default(), pins_bank: false, embeds })
    }

    /// Publishes a bank for the memory of a sequence. Returns its id.
    pub(crate) fn publish_for_sequence(
        &mut self,
        index: u8,
        steps: BankSteps<'_>,
        now_ns: u64,
    ) -> u64 {
        let state = self.building(index, now_ns);
        let id = self.add(HostBank {
            index,
            of: None,
            bank: Arc::default(),
            pins_bank: false,
            embeds: false,
            with_frames: false,
            users: 1,
            state,
            store: None,
        });
        self.outbox.push((index, ToExternal::Bank(id, steps.content(false))));
        id
    }

    /// Adds a bank. Returns its id.
    fn add(&mut self, bank: HostBank) -> u64 {
        self.last_bank += 1;
        self.banks.insert(self.last_bank, bank);
        self.last_bank
    }

    /// The state of a bank that is published to the memory `index` now.
    fn building(&self, index: u8, now_ns: u64) -> BankState {
        let messages = self.memories.get(&index).map_or(0, |memory| memory.messages);
        BankState::Building(Building { published_ns: now_ns, messages, since_ns: now_ns })
    }

    /// An episode uses a bank from now on.
    pub(crate) fn retain(&mut self, id: u64) {
        if let Some(bank) = self.banks.get_mut(&id) {
            bank.users += 1;
            self.unused.retain(|unused| *unused != id);
        }
    }

    /// An episode no longer uses a bank. Those that no episode has used for long are taken back.
    pub(crate) fn release(&mut self, id: u64) {
        let Some(bank) = self.banks.get_mut(&id) else { return };
        bank.users = bank.users.saturating_sub(1);
        if bank.users == 0 {
            self.unused.push_back(id);
        }
        let in_use =
            |state: &BankState| matches!(state, BankState::Building(_) | BankState::Collecting(_));
        while self.unused.len() > KEPT_BANKS {
            let oldest = self.unused.iter().position(|id| !in_use(&self.banks[id].state));
            let Some(id) = oldest.and_then(|at| self.unused.remove(at)) else { return };
            self.take_back(id);
        }
    }

    /// Takes back a bank.
    pub(crate) fn take_back(&mut self, id: u64) {
        if let Some(bank) = self.banks.remove(&id) {
            self.outbox.push((bank.index, ToExternal::TakeBack(id)));
        }
    }

    /// Gets the banks as far as they can get now. `asked_ns` has the time of each memory's oldest question that is open.
    pub(crate) fn build_banks<I: Clone>(
        &mut self,
        views: &mut EmbeddedViews<I>,
        asked_ns: &BTreeMap<u8, u64>,
        now_ns: u64,
    ) {
        self.restart_time_limits(asked_ns, now_ns);
        let limit = self.limits.build;
        for id in self.banks.keys().copied().collect::<Vec<_>>() {
            let Some(host) = self.banks.get_mut(&id) else { continue };
            let (bank, embeds, is_used) = (host.bank.clone(), host.embeds, host.users > 0);
            let steps = match &mut host.state {
                BankState::Building(building) if is_over(limit, building.since_ns, now_ns) => {
                    let name = self.name_of_bank(id);
                    let seconds = limit.as_secs();
                    let why = format!("external memory {name} was not built within {seconds} s");
                    self.finish(id, Err(Reason::overdue(why)), views);
                    continue;
                }
                BankState::Waiting { .. } if is_used && !host.pins_bank => {
                    Some(BankSteps::without_views(&bank))
                }
                BankState::Waiting { ready } if is_used => {
                    if !views.are_known(&bank.view_ids, ready, embeds) {
                        continue;
                    }
                    // Pinned until it is built, whatever becomes of the episodes.
                    views.pinned.try_pin(&bank.view_ids, embeds);
                    bank.with_views(|view_id| views.known(view_id, embeds))
                }
                BankState::Collecting(collecting) => {
                    views.collect(collecting, is_used);
                    if !collecting.is_complete() {
                        continue;
                    }
                    bank.with_views(|view_id| collecting.found.get(&view_id).cloned())
                }
                _ => continue,
            };
            let (index, with_frames) = (host.index, host.with_frames);
            let state = self.building(index, now_ns);
            if let (Some(steps), Some(host)) = (steps, self.banks.get_mut(&id)) {
                host.state = state;
                self.outbox.push((index, ToExternal::Bank(id, steps.content(with_frames))));
            }
        }
    }

    /// Restarts the time limits of what a memory cannot have begun: it does one thing after the other, and builds its banks
    /// in their order.
    fn restart_time_limits(&mut self, asked_ns: &BTreeMap<u8, u64>, now_ns: u64) {
        for (index, memory) in &mut self.memories {
            let is_storing = |bank: &HostBank| matches!(bank.store, Some(StoreState::Asked { .. }));
            let is_own = |bank: &&mut HostBank| bank.index == *index;
            let mut is_busy =
                self.banks.values().any(|bank| bank.index == *index && is_storing(bank));
            let mut building =
                self.banks.values_mut().filter(is_own).filter_map(|bank| match &mut bank.state {
                    BankState::Building(building) => Some(building),
                    _ => None,
                });
            if !is_busy && let Some(first) = building.next() {
                // It had the question first, and has sent nothing since it got the bank: it is answering still.
                let had_question = asked_ns
                    .get(index)
                    .is_some_and(|asked_ns| asked_ns.saturating_add(WAKE_NS) < first.published_ns);
                let is_answering = had_question && memory.messages == first.messages;
                is_busy = !is_answering;
            }
            for later in building {
                later.since_ns = now_ns;
            }
            if is_busy {
                memory.last_busy_ns = now_ns;
            }
        }
    }

    /// Checks that a bank is built.
    pub(crate) fn check_built(&self, id: u64) -> Result<(), Unready> {
        match self.banks.get(&id).map(|bank| &bank.state) {
            Some(BankState::Ready { .. }) => Ok(()),
            Some(BankState::Failed(why)) => Err(why.clone().into()),
            _ => Err(Unready::Waiting),
        }
    }

    /// The memory of a bank has built itself, or cannot. Returns which.
    ///
    /// # Errors
    /// When it was not asked to.
    pub(crate) fn built(
        &mut self,
        index: u8,
        message: &ExternalBuilt,
    ) -> Result<Result<u64, Reason>, String> {
        let &ExternalBuilt { bank: id, store_bytes, failure, .. } = message;
        let bank = self.banks.get(&id).filter(|bank| bank.index == index);
        if !bank.is_some_and(|bank| matches!(bank.state, BankState::Building(_))) {
            let name = self.name(index);
            return Err(format!(
                "external memory {name} has built bank {id}, which it was not asked for"
            ));
        }
        Ok(self.outcome(index, store_bytes, failure, "be built"))
    }

    /// Ends the building of a bank: its views need not be pinned any more.
    pub(crate) fn finish<I: Clone>(
        &mut self,
        id: u64,
        outcome: Result<u64, Reason>,
        views: &mut EmbeddedViews<I>,
    ) {
        let Some(bank) = self.banks.get_mut(&id) else { return };
        if bank.pins_bank && matches!(bank.state, BankState::Building(_)) {
            views.pinned.release(&bank.bank.view_ids);
        }
        bank.state = match outcome {
            Ok(store_bytes) => BankState::Ready { store_bytes },
            Err(why) => BankState::Failed(why),
        };
    }

    /// Has the memory of a bank save what it knows into a folder, or load it. Returns the bytes of its store.
    pub(crate) fn store(
        &mut self,
        id: u64,
        folder: &Path,
        loads: bool,
        now_ns: u64,
    ) -> Result<u64, Unready> {
        let limit = self.limits.build;
        let bank = self.banks.get_mut(&id).ok_or("its memory is gone")?;
        match bank.store.take() {
            None => {
                let message = store_message(id, folder, loads)?;
                bank.store = Some(StoreState::Asked { since_ns: now_ns });
                self.outbox.push((bank.index, ToExternal::Store(message)));
                Err(Unready::Waiting)
            }
            Some(StoreState::Asked { since_ns }) if is_over(limit, since_ns, now_ns) => {
                let (name, seconds) = (self.name_of_bank(id), limit.as_secs());
                let why = format!("external memory {name} has not stored within {seconds} s");
                Err(Reason::overdue(why).into())
            }
            Some(asked @ StoreState::Asked { .. }) => {
                bank.store = Some(asked);
                Err(Unready::Waiting)
            }
            Some(StoreState::Done(outcome)) => Ok(outcome?),
        }
    }

    /// The memory of a bank has saved or loaded.
    ///
    /// # Errors
    /// When it was not asked to.
    pub(crate) fn has_stored(&mut self, index: u8, message: &ExternalStored) -> Result<(), String> {
        let &ExternalStored { bank: id, store_bytes, failure } = message;
        let bank = self.banks.get(&id).filter(|bank| bank.index == index);
        if !bank.is_some_and(|bank| matches!(bank.store, Some(StoreState::Asked { .. }))) {
            let name = self.name(index);
            return Err(format!(
                "external memory {name} has stored bank {id}, which it was not asked for"
            ));
        }
        let outcome = self.outcome(index, store_bytes, failure, "learn, save or load");
        if let Some(bank) = self.banks.get_mut(&id) {
            bank.store = Some(StoreState::Done(outcome));
        }
        Ok(())
    }

    /// The name of the memory that a bank belongs to.
    fn name_of_bank(&self, id: u64) -> &str {
        self.banks.get(&id).map_or("unknown", |bank| self.name(bank.index))
    }

    /// Bytes that the memory of a bank stores; 0 if it does not tell.
    pub(crate) fn store_bytes(&self, id: u64) -> u64 {
        match self.banks.get(&id).map(|bank| &bank.state) {
            Some(BankState::Ready { store_bytes }) => *store_bytes,
            _ => 0,
        }
    }
}

/// The message that has the memory of a bank save or load.
///
/// # Errors
/// When the folder's path is too long.
fn store_message(bank: u64, folder: &Path, loads: bool) -> Result<Box<ExternalStore>, String> {
    let absolute = std::path::absolute(folder).map_err(|error| error.to_string())?;
    let path = absolute.to_str().filter(|path| path.len() <= MAX_FOLDER).ok_or_else(|| {
        format!("{} has no name of at most {MAX_FOLDER} bytes UTF-8", absolute.display())
    })?;
    let mut message = Box::new(ExternalStore { bank, loads: loads.into(), ..Zeroable::zeroed() });
    message.folder_len = write_text(&mut message.folder, path);
    Ok(message)
}
