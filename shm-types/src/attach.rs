//! What a process must know to join a run: `attach.json` in the run's folder.
//!
//! The orchestrator writes the file for each generation and removes it when the run is over; every other process reads
//! it when it starts. A process that the orchestrator did not start reads it again periodically, to join the next
//! generation or to end with the run. The sizes of all queues and of the frame store follow from this file, so
//! processes that read it agree on them.

use std::ffi::OsStr;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

pub use domain::limits::MAX_FRAMES;

use crate::message::{MAX_EXTERNAL_MEMORIES, MAX_WINDOW, MAX_WORLDS, Role, Traffic, WIRE_VERSION};

/// Name of the file in a run's folder.
pub const ATTACH_FILE: &str = "attach.json";

/// The environment variable that names the run's folder to an external program.
pub const ATTACH_VARIABLE: &str = "MEMTRANSFER_ATTACH";

/// The environment variable that tells a world its index among the worlds of a run; without it, it is the first.
pub const WORLD_INDEX_VARIABLE: &str = "MEMTRANSFER_WORLD_INDEX";

/// Bytes of a page of shared memory; a frame is a whole number of pages.
pub const PAGE_BYTES: usize = 4096;

/// Maximum number of lanes a run can have.
pub const MAX_LANES: u32 = 4096;

/// Default of [`Attach::frame_capacity`]: every view of the unchanged world fits.
pub const DEFAULT_FRAMES: u32 = 1536;

/// Default window length h (specification, section 5).
pub const DEFAULT_WINDOW: u32 = 6;

/// Frames that renderers can fill at the same time.
pub const MAX_LOANED_FRAMES: u32 = 32;

/// Longest path of a run's folder, in bytes: names of sockets in it must fit into 108.
pub const MAX_ROOT_BYTES: usize = 48;

/// Everything a process needs to join a run. A reader ignores fields that it does not know.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attach {
    /// [`WIRE_VERSION`] of the program that wrote the file.
    pub wire_version: u32,
    /// Prefix of the names of everything that the run has in shared memory.
    pub prefix: String,
    /// Grows by one whenever the processes are restarted; part of every service's name.
    pub generation: u32,
    /// Process id of the orchestrator.
    pub orchestrator_pid: u32,
    /// The roles that take part beside the orchestrator. Senders wait for the receivers of these roles.
    pub participants: Vec<Role>,
    /// World processes, at most as many as lanes; each has a frame store of its own.
    pub worlds: u8,
    /// The indices of the external memories that take part.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub external_memories: Vec<u8>,
    /// Episodes that run at the same time.
    pub lanes: u32,
    /// Longest window h of any lane.
    pub window: u32,
    /// Size of every frame.
    pub frame: FrameSize,
    /// Frames of each world that may be resident at the same time (`--frame-budget`).
    pub frame_capacity: u32,
    /// How a process waits for work.
    pub wait: Wait,
    /// What observed frames show.
    pub frame_control: FrameControl,
    /// Folder into which the policy writes its [prompt log](domain::prompt_log); absent without `--log-prompts`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompts: Option<PathBuf>,
    /// Folder into which each process writes its [spans](crate::spans); absent without `--trace`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spans: Option<PathBuf>,
    /// The run's folder, which the file was read from. Not in the file, so that the folder can be mounted under
    /// another path.
    #[serde(skip)]
    pub root: PathBuf,
}

/// Width and height of a frame in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct FrameSize {
    /// Pixels in a row: a multiple of 64, so that a row is a multiple of 256 bytes.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl FrameSize {
    /// 448 x 448: 196 pages.
    pub const DEFAULT: Self = Self { width: 448, height: 448 };

    /// Bytes of the pixels: RGBA8, rows top to bottom without gaps.
    pub const fn bytes(self) -> usize {
        self.width as usize * self.height as usize * 4
    }

    /// Pages that hold them.
    pub const fn pages(self) -> usize {
        self.bytes().div_ceil(PAGE_BYTES)
    }
}

/// How a process waits for events.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Wait {
    /// Microseconds to poll before sleeping. 0 sleeps at once, which is best unless every process has a core of its
    /// own.
    pub spin_us: u32,
}

/// What frames show. Controls other than [`Rendered`](Self::Rendered) test that results come from pixels. Views that memory
/// requests are rendered, except by [`BlankAll`](Self::BlankAll).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrameControl {
    /// The agent's view.
    #[default]
    Rendered,
    /// A uniform grey.
    Blank,
    /// The view from another pose.
    Swapped,
    /// A uniform grey, and in the views that memory requests as well.
    BlankAll,
}

impl FrameControl {
    /// The word on the command line and in files.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Rendered => "rendered",
            Self::Blank => "blank",
            Self::Swapped => "swapped",
            Self::BlankAll => "blank-all",
        }
    }
}

/// Why `attach.json` cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum AttachError {
    /// The file cannot be read or written.
    #[error("{}: {cause}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        cause: io::Error,
    },
    /// The file is not the expected JSON.
    #[error("{}: {cause}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// The parser's error.
        cause: serde_json::Error,
    },
    /// The file was written for another wire version.
    #[error(
        "the run uses wire version {theirs} and this program {ours}: use programs of the same version"
    )]
    WireVersion {
        /// The version of the file.
        theirs: u32,
        /// The version of this program.
        ours: u32,
    },
    /// A field has an invalid value.
    #[error("{field} is {value}, but must be {expected}")]
    Value {
        /// The field.
        field: &'static str,
        /// Its value.
        value: String,
        /// The accepted values.
        expected: String,
    },
}

/// Maximum number of steps in a batch.
const MAX_BATCH: u32 = 16;

impl Attach {
    /// Steps that a process works on before it notifies the next process: a quarter of the lanes. With batches of
    /// all lanes the processes would take turns instead of working at the same time.
    pub fn batch_len(&self) -> usize {
        self.lanes.div_ceil(4).min(MAX_BATCH) as usize
    }

    /// The first generation of the run in `folder`, with this process as its orchestrator, one lane and every other
    /// setting at its default.
    pub fn new(folder: &Path) -> Self {
        Self {
            wire_version: WIRE_VERSION,
            prefix: prefix(folder),
            generation: 1,
            orchestrator_pid: std::process::id(),
            participants: Role::CHILDREN.to_vec(),
            worlds: 1,
            external_memories: Vec::new(),
            lanes: 1,
            window: DEFAULT_WINDOW,
            frame: FrameSize::DEFAULT,
            frame_capacity: DEFAULT_FRAMES,
            wait: Wait::default(),
            frame_control: FrameControl::default(),
            prompts: None,
            spans: None,
            root: folder.to_owned(),
        }
    }

    /// Reads and checks `attach.json` in the run's folder `dir`.
    ///
    /// # Errors
    /// When the file is missing or not the expected JSON, was written for another wire version, or holds an invalid
    /// value.
    pub fn read(dir: &Path) -> Result<Self, AttachError> {
        let path = dir.join(ATTACH_FILE);
        let file_error = |cause| AttachError::File { path: path.clone(), cause };
        let text = fs::read_to_string(&path).map_err(file_error)?;
        let json_error = |cause| AttachError::Json { path: path.clone(), cause };
        // First the version: a file of another version may have other fields.
        let value: serde_json::Value = serde_json::from_str(&text).map_err(json_error)?;
        let theirs = value.get("wire_version").and_then(serde_json::Value::as_u64);
        if let Some(theirs) = theirs.filter(|&theirs| theirs != u64::from(WIRE_VERSION)) {
            let theirs = u32::try_from(theirs).unwrap_or(u32::MAX);
            return Err(AttachError::WireVersion { theirs, ours: WIRE_VERSION });
        }
        let attach: Self = serde_json::from_value(value).map_err(json_error)?;
        let attach = Self { root: dir.canonicalize().map_err(file_error)?, ..attach };
        attach.check()?;
        Ok(attach)
    }

    /// Checks the values and writes `attach.json` into the run's folder `dir`, atomically.
    ///
    /// # Errors
    /// When a value is invalid, or the file cannot be written.
    pub fn write(&self, dir: &Path) -> Result<(), AttachError> {
        self.check()?;
        write_json(dir, ATTACH_FILE, self)
    }

    /// Removes `attach.json` from the run's folder `dir`: the run is over.
    ///
    /// # Errors
    /// When the file exists and cannot be removed.
    pub fn withdraw(dir: &Path) -> Result<(), AttachError> {
        let path = dir.join(ATTACH_FILE);
        match fs::remove_file(&path) {
            Err(cause) if cause.kind() != io::ErrorKind::NotFound => {
                Err(AttachError::File { path, cause })
            }
            _ => Ok(()),
        }
    }

    /// The index of the world that the lane, or the demonstration, with this number belongs to.
    pub fn world_of(&self, number: u32) -> u8 {
        (number % u32::from(self.worlds)) as u8
    }

    /// The most lanes that a world has.
    pub fn lanes_of_world(&self) -> u32 {
        self.lanes.div_ceil(self.worlds.into())
    }

    /// The most processes with one of `roles` that can take part in the run.
    pub(crate) fn places(&self, roles: &[Role]) -> usize {
        let places = |role: &Role| match role {
            Role::Sim => self.worlds.into(),
            Role::ExternalMemory => self.external_memories.len(),
            _ => 1,
        };
        roles.iter().map(places).sum()
    }

    /// The number of processes with one of `roles` that take part in the run.
    pub fn count(&self, roles: &[Role]) -> usize {
        let processes = |role: &Role| match role {
            Role::Orchestrator => 1,
            Role::ExternalMemory => self.external_memories.len(),
            role if !self.participants.contains(role) => 0,
            role => self.places(&[*role]),
        };
        roles.iter().map(processes).sum()
    }

    /// As [`Self::count`], without external memories: a run goes on without them.
    pub(crate) fn count_required(&self, roles: &[Role]) -> usize {
        let is_external = roles.contains(&Role::ExternalMemory);
        self.count(roles) - if is_external { self.external_memories.len() } else { 0 }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// For the first invalid one.
    pub fn check(&self) -> Result<(), AttachError> {
        let value = |field, value: &dyn ToString, expected: String| {
            Err(AttachError::Value { field, value: value.to_string(), expected })
        };
        if self.wire_version != WIRE_VERSION {
            return Err(AttachError::WireVersion { theirs: self.wire_version, ours: WIRE_VERSION });
        }
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if !self.prefix.starts_with("mt")
            || self.prefix.len() > 16
            || !self.prefix.chars().all(plain)
        {
            let expected = "\"mt\" and up to 14 letters, digits or underscores".to_owned();
            return value("prefix", &self.prefix, expected);
        }
        if !(1..=MAX_LANES).contains(&self.lanes) {
            return value("lanes", &self.lanes, format!("1 to {MAX_LANES}"));
        }
        let most = self.lanes.min(MAX_WORLDS as u32);
        if !(1..=most).contains(&self.worlds.into()) {
            return value("worlds", &self.worlds, format!("1 to {most}, and at most the lanes"));
        }
        let most = MAX_WINDOW as u32;
        if self.window > most {
            return value("window", &self.window, format!("0 to {most}"));
        }
        let FrameSize { width, height } = self.frame;
        if width == 0 || !width.is_multiple_of(64) || width > 4096 {
            return value("frame.width", &width, "a multiple of 64 up to 4096".to_owned());
        }
        if !(1..=4096).contains(&height) {
            return value("frame.height", &height, "1 to 4096".to_owned());
        }
        if !(1..=MAX_FRAMES).contains(&self.frame_capacity) {
            return value("frame_capacity", &self.frame_capacity, format!("1 to {MAX_FRAMES}"));
        }
        let most = MAX_EXTERNAL_MEMORIES;
        if let Some(index) =
            self.external_memories.iter().find(|&&index| usize::from(index) >= most)
        {
            return value("external_memories", index, format!("0 to {}", most - 1));
        }
        if !self.external_memories.is_sorted_by(|a, b| a < b) {
            let found = format!("{:?}", self.external_memories);
            return value("external_memories", &found, "ascending indices".to_owned());
        }
        // attach.json is text.
        for (field, path) in [("prompts", &self.prompts), ("spans", &self.spans)] {
            if let Some(path) = path.as_ref().filter(|path| path.to_str().is_none()) {
                let expected = "a path in UTF-8: choose another folder for the run".to_owned();
                return value(field, &path.display(), expected);
            }
        }
        if self.wait.spin_us > 1_000_000 {
            return value("wait.spin_us", &self.wait.spin_us, "0 to 1000000".to_owned());
        }
        Ok(())
    }

    /// Chunks of a world's frame store, one frame each: frames that are resident, that renderers fill, and that are evicted
    /// but still pinned by a consumer. Shared memory never holds more.
    pub const fn frame_chunks(&self) -> u32 {
        self.frame_capacity + MAX_LOANED_FRAMES + self.spare_frames()
    }

    /// Chunks for frames that are evicted but still pinned.
    pub const fn spare_frames(&self) -> u32 {
        self.frame_capacity / 8 + self.lanes + 16
    }

    /// Messages of a service that can wait for one receiver: the queue length that all processes must agree on.
    pub const fn queue_len(&self, traffic: Traffic) -> usize {
        match traffic {
            Traffic::Lanes => 2 * self.lanes as usize + 16,
            Traffic::Frames => 2 * self.frame_chunks() as usize,
            Traffic::Few => 256,
        }
    }

    /// Maximum number of bytes of shared memory that a world of the run can use: every chunk of its frame store with a page of
    /// headers each, and an allowance for messages.
    pub const fn shared_memory_bytes(&self) -> u64 {
        let chunk = (self.frame.pages() + 1) * PAGE_BYTES;
        let messages = (16 << 20) + self.lanes as u64 * (64 << 10);
        self.frame_chunks() as u64 * chunk as u64 + messages
    }
}

/// Writes `value` into the file `name` of the folder `dir`, atomically.
pub(crate) fn write_json(
    dir: &Path,
    name: &str,
    value: &impl Serialize,
) -> Result<(), AttachError> {
    let (path, draft) = (dir.join(name), dir.join(format!("{name}.new")));
    let json_error = |cause| AttachError::Json { path: path.clone(), cause };
    let text = serde_json::to_string_pretty(value).map_err(json_error)?;
    fs::File::create(&draft)
        .and_then(|mut file| writeln!(file, "{text}"))
        .and_then(|()| fs::rename(&draft, &path))
        .map_err(|cause| AttachError::File { path: path.clone(), cause })
}

/// The prefix of the names in shared memory of the run in `folder`.
pub(crate) fn prefix(folder: &Path) -> String {
    format!("mt{}_", folder.file_name().map(OsStr::to_string_lossy).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attach() -> Attach {
        Attach {
            prefix: "mt0_".to_owned(),
            generation: 3,
            orchestrator_pid: 17,
            participants: vec![Role::Sim],
            worlds: 3,
            external_memories: vec![0, 2],
            lanes: 8,
            frame_capacity: 100,
            wait: Wait { spin_us: 20 },
            frame_control: FrameControl::Swapped,
            ..Attach::new(Path::new(""))
        }
    }

    /// The error of reading a file in which `from` is replaced by `to`.
    fn error_with(from: &str, to: &str) -> String {
        let dir = tempfile::tempdir().unwrap();
        attach().write(dir.path()).unwrap();
        let path = dir.path().join(ATTACH_FILE);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{from} is not in {text}");
        fs::write(&path, text.replace(from, to)).unwrap();
        let error = Attach::read(dir.path()).unwrap_err().to_string();
        error.replace(&path.display().to_string(), "FILE")
    }

    #[test]
    fn a_written_file_is_read_back() {
        let dir = tempfile::tempdir().unwrap();
        attach().write(dir.path()).unwrap();
        let root = dir.path().canonicalize().unwrap();
        assert_eq!(Attach::read(dir.path()).unwrap(), Attach { root, ..attach() });
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "no draft is left");
        Attach::withdraw(dir.path()).unwrap();
        Attach::withdraw(dir.path()).unwrap();
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn invalid_values_are_refused_and_named() {
        for (from, to, said) in [
            ("\"lanes\": 8", "\"lanes\": 0", "lanes is 0, but must be 1 to 4096"),
            ("\"window\": 6", "\"window\": 33", "window is 33, but must be 0 to 32"),
            ("448", "450", "frame.width is 450, but must be a multiple of 64 up to 4096"),
            ("mt0_", "mt/../", "prefix is mt/../, but must be \"mt\" and up to 14"),
            ("\"worlds\": 3", "\"worlds\": 9", "worlds is 9, but must be 1 to 8"),
            ("100", "0", "frame_capacity is 0, but must be 1 to"),
            ("\"spin_us\": 20", "\"spin_us\": 2000000", "wait.spin_us is 2000000"),
            ("\"lanes\"", "\"lance\"", "FILE: missing field `lanes`"),
            ("swapped", "swopped", "FILE: unknown variant `swopped`"),
            ("\"lanes\": 8", "\"lanes\": -8", "FILE: invalid value"),
            ("\"mt0_\"", "5", "FILE: invalid type"),
            ("\"mt0_\"", "", "FILE: expected value"),
        ] {
            let error = error_with(from, to);
            assert!(error.starts_with(said) || error.contains(said), "{error}");
        }
    }

    #[test]
    fn a_path_that_is_not_text_is_named() {
        use std::os::unix::ffi::OsStrExt;
        let prompts = Path::new(OsStr::from_bytes(b"caf\xe9/prompts")).to_owned();
        let attach = Attach { prompts: Some(prompts), ..attach() };
        let error = attach.check().unwrap_err().to_string();
        assert!(error.starts_with("prompts is caf\u{fffd}/prompts, but must be a path in UTF-8"));
    }

    #[test]
    fn unknown_fields_are_ignored() {
        let dir = tempfile::tempdir().unwrap();
        let traced = Attach { spans: Some("spans".into()), ..attach() };
        traced.write(dir.path()).unwrap();
        let path = dir.path().join(ATTACH_FILE);
        let text = fs::read_to_string(&path).unwrap();
        let text = text.replace("\"lanes\"", "\"future\": {\"a\": [1]}, \"lanes\"");
        fs::write(&path, text.replace("\"width\"", "\"depth\": 1, \"width\"")).unwrap();
        let root = dir.path().canonicalize().unwrap();
        assert_eq!(Attach::read(dir.path()).unwrap(), Attach { root, ..traced });
    }

    #[test]
    fn another_wire_version_is_named_before_anything_else() {
        let from = format!("\"wire_version\": {WIRE_VERSION}");
        let to = "\"wire_version\": 99, \"news\": true";
        let ours = format!("the run uses wire version 99 and this program {WIRE_VERSION}");
        assert!(error_with(&from, to).starts_with(&ours));
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = Attach::read(Path::new("/nowhere")).unwrap_err();
        let error = format!("{error}{:?}", std::error::Error::source(&error));
        assert!(error.starts_with("/nowhere/attach.json: "), "{error}");
        assert_eq!(error.matches("No such file").count(), 1, "the cause is printed once");
    }

    #[test]
    fn frames_are_whole_pages() {
        assert_eq!((FrameSize::DEFAULT.bytes(), FrameSize::DEFAULT.pages()), (802_816, 196));
        let odd = FrameSize { width: 64, height: 65 };
        assert_eq!((odd.bytes(), odd.pages()), (16_640, 5));
        assert!(attach().shared_memory_bytes() > 100 * 802_816);
    }
}
