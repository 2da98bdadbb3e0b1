//! The settings of a run, as the manifest records them.
//!
//! [`KEYS`] is the table of all settings: a key has the same name as a flag, an environment variable, in a suite file and in
//! the manifest. The crate `settings` merges them from those sources and checks what concerns several.

mod cases;
mod documents;
mod group;
mod model;
mod stream;
mod suite;
mod table;

pub use cases::CaseSelector;
pub use documents::DocumentSource;
pub use group::Group;
pub use model::{ModelSettings, ResponseCache};
pub use stream::StreamSettings;
pub use suite::SuiteName;
pub use table::{Effect, KEYS, Key, MAX_IMAGES, STREAM_TABLE, Scope, VARIABLE_PREFIX};

use std::collections::BTreeSet;
use std::path::PathBuf;

use domain::names::named;
use domain::{Appearance, Demonstrations, ExternalName, MemoryKind, Mismatch};
use serde::{Deserialize, Serialize};

use crate::{Condition, Frames, PolicyKind};

named! {
    /// Whether something that a person might not find in a warehouse is drawn: `--plates` and `--labels`.
    #[derive(Default)]
    Drawn, "value" {
        /// Drawn.
        #[default]
        On = "on",
        /// Not drawn.
        Off = "off",
    }
}

named! {
    /// A world that no command starts, and that is not the warehouse: `--world`.
    WorldStart, "way of starting a world" {
        /// The user starts it.
        External = "external",
    }
}

/// The settings of a run, complete. `memtransfer run --help` describes each field under the same name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "each field is documented once, as a flag of `memtransfer run`")]
pub struct RunSettings {
    pub suite: SuiteName,
    pub policy: PolicyKind,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy_cmd: Option<String>,
    /// The command that starts another world than the warehouse.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_cmd: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world: Option<WorldStart>,
    /// The folder of the case book of a world that the user starts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_book: Option<PathBuf>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub memory_cmd: Vec<String>,
    /// Whether an external memory is awaited that the user starts: the word `external` in `--memory`.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub external_memory: bool,
    /// The external memories that learn in streams, as they describe themselves.
    #[serde(default, skip_serializing_if = "BTreeSet::is_empty")]
    pub learning_memories: BTreeSet<ExternalName>,
    /// The groups of conditions, at least one.
    #[serde(rename = "group")]
    pub groups: Vec<Group>,
    /// The streams, for a run that consists of streams.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stream: Option<StreamSettings>,
    pub cases: Vec<CaseSelector>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<u32>,
    pub seed: u64,
    pub max_steps: u32,
    pub horizon: u32,
    #[serde(default = "one")]
    pub hits: u32,
    pub keyframes: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub memory_images: Option<u32>,
    #[serde(default = "default_text_bytes")]
    pub memory_text_bytes: u32,
    pub documents: DocumentSource,
    pub frame_size: u32,
    pub frames: Frames,
    /// A manifest without it is of an earlier version, whose worlds had plates.
    #[serde(default)]
    pub plates: Drawn,
    #[serde(default)]
    pub labels: Drawn,
    #[serde(default)]
    pub appearance_seed: u64,
    pub encoder: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_file: Option<PathBuf>,
    /// How the model is asked; with `--policy openai` only.
    #[serde(flatten, default, skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelSettings>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub assets: Option<PathBuf>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elsewhere: Option<PathBuf>,
    pub out: PathBuf,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub log_prompts: bool,
    pub lanes: u32,
    #[serde(default = "one")]
    pub worlds: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub encoder_threads: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_budget: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub backend: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub provider: Option<String>,
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub warm_views: bool,
    pub spin_us: u32,
    pub step_timeout: u32,
    #[serde(default = "default_memory_timeout")]
    pub memory_timeout: u32,
    pub start_timeout: u32,
}

/// Most bytes of text that memory supplies at a step, where nothing is said.
pub const MEMORY_TEXT_BYTES: u32 = 1 << 20;

/// Seconds in which an external memory answers, where nothing is said.
pub const MEMORY_TIMEOUT: u32 = 30;

fn one() -> u32 {
    1
}

fn default_text_bytes() -> u32 {
    MEMORY_TEXT_BYTES
}

fn default_memory_timeout() -> u32 {
    MEMORY_TIMEOUT
}

/// Most conditions of all groups together, those that occur twice counted twice.
const MAX_CONDITIONS: usize = 10_000;

/// The largest value of numbers that are multiplied with each other.
const MAX_FACTOR: u32 = 10_000;

/// The largest number of repetitions, and of steps and images.
const MAX_NUMBER: u32 = 1_000_000;

impl RunSettings {
    /// Checks that a run of these settings can be counted: that nothing computed from them overflows or takes unlimited
    /// time. Call it with settings that were read, before anything else.
    ///
    /// # Errors
    /// Names the first value that is too large.
    pub fn check_size(&self) -> Result<(), String> {
        let stream = self.stream.as_ref();
        let of_stream = |count: fn(&StreamSettings) -> u32| stream.map_or(0, count);
        let largest = |count: fn(&Group) -> u32| self.groups.iter().map(count).max().unwrap_or(0);
        for (name, value, most) in [
            ("horizon", self.horizon, MAX_FACTOR),
            ("hits", self.hits, MAX_FACTOR),
            ("keyframes", self.keyframes, MAX_NUMBER),
            ("memory-images", self.memory_images.unwrap_or(0), MAX_NUMBER),
            ("max-steps", self.max_steps, MAX_NUMBER),
            (
                "window",
                largest(|group| group.window.iter().copied().max().unwrap_or(0)),
                MAX_NUMBER,
            ),
            ("runs", largest(|group| group.runs), MAX_NUMBER),
            ("streams", of_stream(|stream| stream.streams), MAX_FACTOR),
            ("blocks", of_stream(|stream| stream.blocks), MAX_FACTOR),
            ("cases-per-block", of_stream(|stream| stream.cases_per_block), MAX_FACTOR),
            ("rounds", of_stream(|stream| stream.rounds), MAX_FACTOR),
        ] {
            if value > most {
                return Err(format!("{name} is {value}, and at most {most} is possible"));
            }
        }
        let products = self.groups.iter().map(Group::product);
        let conditions = products.fold(0, usize::saturating_add);
        if conditions > MAX_CONDITIONS {
            return Err(format!(
                "{conditions} conditions, and at most {MAX_CONDITIONS} are possible"
            ));
        }
        Ok(())
    }

    /// The conditions of all groups, each once, in the order of the groups.
    pub fn conditions(&self) -> Vec<Condition> {
        self.runs().into_iter().map(|(condition, _)| condition).collect()
    }

    /// The conditions with the number of repetitions of each.
    pub fn runs(&self) -> Vec<(Condition, u32)> {
        group::union(&self.groups, &self.learning_memories)
    }

    /// The largest number of images that a request under `condition` can hold: the current view, the window, and those
    /// of memory.
    pub fn images(&self, condition: &Condition) -> u32 {
        1 + condition.variation.window + self.memory_images_of(condition.memory)
    }

    /// The largest number of images that `memory` can add to a request.
    pub fn memory_images_of(&self, memory: MemoryKind) -> u32 {
        let most = self.memory_image_budget();
        let built_in = memory.built_in();
        built_in.map_or(most, |one| one.images(self.horizon, self.hits, self.keyframes).min(most))
    }

    /// Maximum number of bytes of text that a memory supplies at a step: none where what it supplies is blank.
    pub fn memory_text_budget(&self) -> u32 {
        match self.frames {
            Frames::BlankAll => 0,
            Frames::Rendered | Frames::Blank | Frames::Swapped => self.memory_text_bytes,
        }
    }

    /// Most images that a memory may supply at a step. By default no built-in memory has more.
    pub fn memory_image_budget(&self) -> u32 {
        let most_built_in = self.keyframes.max(self.hits * (1 + self.horizon));
        self.memory_images.unwrap_or(most_built_in)
    }

    /// How the world looks in frames.
    pub fn appearance(&self) -> Appearance {
        Appearance {
            plates: self.plates == Drawn::On,
            labels: self.labels == Drawn::On,
            seed: self.appearance_seed,
        }
    }

    /// The demonstrations that the memory of `condition` holds, of those that the run has. In a suite of streams an arm's memory is
    /// built from demonstrations of the stream.
    pub fn demonstrations_of(&self, condition: &Condition) -> Demonstrations {
        let control = condition.control_set().filter(|_| self.stream.is_none());
        control.unwrap_or(condition.demonstrations)
    }

    /// In what episodes differ from the demonstrations, beside start and route: each once, without [`Mismatch::None`].
    pub fn mismatches(&self) -> impl Iterator<Item = Mismatch> + '_ {
        let listed =
            |mismatch: &Mismatch| self.groups.iter().any(|group| group.mismatch.contains(mismatch));
        Mismatch::ALL.iter().copied().filter(|one| *one != Mismatch::None).filter(listed)
    }

    /// Whether tasks are demonstrated in another warehouse.
    pub fn demonstrates_elsewhere(&self) -> bool {
        let named = self.groups.iter().flat_map(|group| &group.demos).copied();
        let conditions = self.conditions();
        let held = conditions.iter().map(|condition| self.demonstrations_of(condition));
        named.chain(held).any(Demonstrations::take_place_elsewhere)
    }

    /// The flag with which another world takes the place of the warehouse.
    pub fn own_world(&self) -> Option<&'static str> {
        let external = self.world.map(|_| "--world external");
        self.world_cmd.as_ref().map(|_| "--world-cmd").or(external)
    }

    /// Whether the run has memories in processes of their own.
    pub const fn has_external_memories(&self) -> bool {
        self.external_memory || !self.memory_cmd.is_empty()
    }

    /// Adds external memories, each with its name and whether it learns, to every group, except to a suite's groups
    /// without a memory of demonstrations, unless all are such.
    pub fn add_external_memories(&mut self, memories: &[(ExternalName, bool)]) {
        let is_for_working = |group: &Group| {
            group.name.is_some() && !group.memory.iter().any(|memory| memory.uses_demonstrations())
        };
        let all = self.groups.iter().all(is_for_working);
        for group in self.groups.iter_mut().filter(|group| all || !is_for_working(group)) {
            group.memory.extend(memories.iter().map(|(name, _)| MemoryKind::External(*name)));
        }
        let learning = memories.iter().filter(|(_, learns)| *learns);
        self.learning_memories.extend(learning.map(|(name, _)| *name));
    }

    /// The names of the external memories that the groups have, each once.
    pub fn external_names(&self) -> BTreeSet<ExternalName> {
        let memories = self.groups.iter().flat_map(|group| &group.memory);
        memories.filter_map(|memory| memory.external()).collect()
    }
}
