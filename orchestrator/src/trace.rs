//! A trace of a run for Perfetto (<https://ui.perfetto.dev>): what each process worked on, and the stages of each step.
//!
//! Chrome's JSON trace format. Each process has a track for every kind of work (from the
//! [spans](shm_types::spans) that it records) and one for every lane with the stages of its steps (from their
//! [stamps](Stamps)). A stage includes waiting. Slices of one track never overlap: Perfetto drops a slice that begins
//! within another and ends after it.

use std::fs::{self, File};
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde_json::{Value, json};
use shm_types::message::Role;
use shm_types::process::monotonic_ns;
use shm_types::spans::Span;

use crate::lanes::Stamps;

/// Numbers of lanes' tracks begin here; smaller ones are those of work.
pub(crate) const FIRST_LANE: u32 = 100;

/// A trace that is being written.
#[derive(Debug)]
pub(crate) struct RunTrace {
    path: PathBuf,
    file: BufWriter<File>,
    /// Where processes record their spans.
    spans: PathBuf,
    began_ns: u64,
    is_first: bool,
    lanes: u32,
    /// Whether an external memory took part.
    has_external: bool,
}

impl RunTrace {
    /// A trace in the file `path`, which is replaced.
    ///
    /// # Errors
    /// When the file, or the folder for spans beside it, cannot be made.
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let path = std::path::absolute(path)?;
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).with_context(|| format!("--trace {}", path.display()))?;
        }
        let file = durable::output::create(&path)
            .with_context(|| format!("--trace {}", path.display()))?;
        let mut spans = path.clone().into_os_string();
        spans.push(".spans");
        let spans = PathBuf::from(spans);
        if spans.exists() {
            remove_spans(&spans).with_context(|| {
                format!("cannot remove {}, where a killed run has left its spans", spans.display())
            })?;
        }
        fs::create_dir(&spans).with_context(|| format!("cannot make {}", spans.display()))?;
        let mut file = BufWriter::new(file);
        file.write_all(b"{\"displayTimeUnit\":\"ns\",\"traceEvents\":[")?;
        let began_ns = monotonic_ns();
        Ok(Self { path, file, spans, began_ns, is_first: true, lanes: 0, has_external: false })
    }

    /// The folder in which processes record their spans.
    pub(crate) fn spans(&self) -> &Path {
        &self.spans
    }

    /// Adds the stages of a step.
    ///
    /// # Errors
    /// When the file cannot be written to.
    pub(crate) fn step(&mut self, stamps: &Stamps) -> Result<()> {
        let s = stamps;
        self.lanes = self.lanes.max(s.lane + 1);
        self.has_external |= s.memory.external().is_some();
        let whole = [(Role::Orchestrator, "step", s.commanded_ns, s.logged_ns)];
        let stages = [
            (Role::Sim, "dynamics", s.woken_ns, s.stepped_ns),
            (Role::Sim, "render", s.stepped_ns, s.rendered_ns),
            (Role::Sim, "publish", s.rendered_ns, s.published_ns),
            (Role::Memory, "embed", s.received_ns, s.embedded_ns),
            (Role::Memory, "search", s.embedded_ns, s.searched_ns),
            // By its own clock: the messages to it and back are taken to be equally long.
            (
                Role::ExternalMemory,
                "method",
                s.method_began_ns(),
                s.method_began_ns() + s.method_ns,
            ),
            (Role::Memory, "assemble", s.searched_ns, s.assembled_ns),
            (Role::Policy, "queue", s.joined_ns, s.started_ns),
            (Role::Policy, "decide", s.started_ns, s.decided_ns),
        ];
        for (role, name, start_ns, end_ns) in whole.into_iter().chain(stages) {
            // A stage that the step skips has no stamps.
            if start_ns == 0 || end_ns <= start_ns {
                continue;
            }
            let arguments = json!({ "step": s.step, "episode": s.episode, "memory": s.memory });
            let track = (role, FIRST_LANE + s.lane);
            self.slice(track, name, (start_ns, end_ns), &arguments)?;
        }
        Ok(())
    }

    /// Adds the processes' spans, names the tracks and completes the file. Returns its path.
    ///
    /// # Errors
    /// When the file cannot be written, or spans cannot be read.
    pub(crate) fn finish(mut self) -> Result<PathBuf> {
        let mut tracks: Vec<(Role, String)> = Vec::new();
        let mut files: Vec<PathBuf> = fs::read_dir(&self.spans)?
            .map(|entry| Ok(entry?.path()))
            .collect::<Result<_>>()
            .with_context(|| format!("cannot list {}", self.spans.display()))?;
        files.sort();
        for path in files {
            let Some(role) = role_of(&path) else { continue };
            let file =
                durable::open(&path).with_context(|| format!("cannot read {}", path.display()))?;
            for line in BufReader::new(file).lines() {
                // The last line of a process that was killed may be torn.
                let Ok(span) = serde_json::from_str::<Span>(&line?) else { continue };
                let Span { track, name, start_ns, end_ns, count } = span;
                let place = tracks.iter().position(|known| *known == (role, track.clone()));
                let place = place.unwrap_or_else(|| {
                    tracks.push((role, track));
                    tracks.len() - 1
                });
                let arguments = json!({ "count": count });
                self.slice((role, 1 + place as u32), &name, (start_ns, end_ns), &arguments)?;
            }
        }
        let has_external = self.has_external;
        for &role in Role::ALL.iter().filter(|role| **role != Role::ExternalMemory || has_external)
        {
            let name = json!({ "name": role.word() });
            self.meta("process_name", (role, 0), &name)?;
            self.meta("process_sort_index", (role, 0), &json!({ "sort_index": role as u8 }))?;
            for lane in 0..self.lanes {
                let track = (role, FIRST_LANE + lane);
                self.meta("thread_name", track, &json!({ "name": format!("lane {lane}") }))?;
                self.meta("thread_sort_index", track, &json!({ "sort_index": track.1 }))?;
            }
        }
        for (place, (role, track)) in (1..).zip(&tracks) {
            self.meta("thread_name", (*role, place), &json!({ "name": track }))?;
            self.meta("thread_sort_index", (*role, place), &json!({ "sort_index": place }))?;
        }
        self.file.write_all(b"\n]}\n")?;
        self.file.flush().with_context(|| format!("cannot write {}", self.path.display()))?;
        fs::remove_dir_all(&self.spans)
            .with_context(|| format!("cannot remove {}", self.spans.display()))?;
        Ok(self.path)
    }

    fn slice(
        &mut self,
        (role, track): (Role, u32),
        name: &str,
        (start_ns, end_ns): (u64, u64),
        arguments: &Value,
    ) -> Result<()> {
        let us = |ns: u64| ns as f64 / 1000.0;
        self.event(&json!({
            "ph": "X", "name": name, "pid": pid(role), "tid": track,
            "ts": us(start_ns.saturating_sub(self.began_ns)),
            "dur": us(end_ns.saturating_sub(start_ns)), "args": arguments,
        }))
    }

    fn meta(&mut self, what: &str, (role, track): (Role, u32), arguments: &Value) -> Result<()> {
        self.event(&json!({
            "ph": "M", "name": what, "pid": pid(role), "tid": track, "args": arguments,
        }))
    }

    fn event(&mut self, event: &Value) -> Result<()> {
        let separator = if std::mem::take(&mut self.is_first) { "\n" } else { ",\n" };
        self.file.write_all(separator.as_bytes())?;
        serde_json::to_writer(&mut self.file, event)
            .with_context(|| format!("cannot write {}", self.path.display()))
    }
}

/// A process's number in the trace: viewers treat 0 as special.
fn pid(role: Role) -> u32 {
    role as u32 + 1
}

/// Removes the files that processes recorded their spans in, and their folder, which must have no others.
fn remove_spans(folder: &Path) -> std::io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if role_of(&path).is_some() && path.extension().is_some_and(|end| end == "jsonl") {
            fs::remove_file(path)?;
        }
    }
    fs::remove_dir(folder)
}

/// The process whose spans are in the file, by its name.
fn role_of(path: &Path) -> Option<Role> {
    let name = path.file_stem()?.to_str()?;
    let (word, _) = name.rsplit_once('-')?;
    Role::ALL.iter().copied().find(|role| role.word() == word)
}

#[cfg(test)]
mod tests {
    use domain::Representation;
    use shm_types::spans::spans_file;

    use super::*;

    #[test]
    fn a_trace_has_tracks_for_processes_lanes_and_work() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep").join("t.json");
        let mut trace = RunTrace::create(&path).unwrap();
        let at = |us: u64| trace.began_ns + us * 1000;
        let stamps = Stamps {
            step: 4,
            commanded_ns: at(1),
            woken_ns: at(2),
            stepped_ns: at(3),
            rendered_ns: at(7),
            logged_ns: at(9),
            ..Stamps::new(8, 1, Representation::Working.into())
        };
        let span = Span {
            track: "renderer".into(),
            name: "draw".into(),
            start_ns: at(3),
            end_ns: at(6),
            count: 2,
        };
        let kept = serde_json::to_string(&span).unwrap() + "\n{\"track\":";
        std::fs::write(spans_file(trace.spans(), Role::Sim, 0, 1), kept).unwrap();
        trace.step(&stamps).unwrap();
        let spans = trace.spans().to_owned();
        assert_eq!(trace.finish().unwrap(), path);
        assert!(!spans.exists());

        let text = std::fs::read_to_string(&path).unwrap();
        let read: Value = serde_json::from_str(&text).unwrap();
        let events = read["traceEvents"].as_array().unwrap();
        let slices: Vec<String> = events
            .iter()
            .filter(|event| event["ph"] == "X")
            .map(|e| format!("{} {}:{} {}+{}", e["name"], e["pid"], e["tid"], e["ts"], e["dur"]))
            .collect();
        insta::assert_snapshot!(slices.join("\n"), @r#"
        "step" 1:101 1.0+8.0
        "dynamics" 2:101 2.0+1.0
        "render" 2:101 3.0+4.0
        "draw" 2:1 3.0+3.0
        "#);
        let names = events.iter().filter(|event| event["name"] == "thread_name");
        let external = |event: &&Value| event["pid"] == pid(Role::ExternalMemory);
        assert_eq!(events.iter().filter(external).count(), 0, "the run has none");
        let names: Vec<&Value> = names.map(|event| &event["args"]["name"]).collect();
        assert!(names.contains(&&json!("lane 1")) && names.contains(&&json!("renderer")));
    }

    #[test]
    fn every_external_memory_has_a_file_of_its_own() {
        let file = |index| spans_file(Path::new("spans"), Role::ExternalMemory, index, 2);
        assert_ne!(file(0), file(1));
        assert_eq!(role_of(&file(1)), Some(Role::ExternalMemory));
    }

    #[test]
    fn only_spans_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let spans = folder.path().join("spans");
        fs::create_dir(&spans).unwrap();
        fs::write(spans_file(&spans, Role::Policy, 0, 1), "").unwrap();
        remove_spans(&spans).unwrap();
        assert!(!spans.exists());
        fs::create_dir(&spans).unwrap();
        fs::write(spans.join("mine.txt"), "mine").unwrap();
        assert!(remove_spans(&spans).is_err());
        assert_eq!(fs::read_to_string(spans.join("mine.txt")).unwrap(), "mine");
    }

    #[test]
    fn a_pipe_in_place_of_the_file_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trace.json");
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mkfifoat(rustix::fs::CWD, &path, mode).unwrap();
        let error = format!("{:#}", RunTrace::create(&path).unwrap_err());
        assert!(error.contains("--trace") && error.contains("a pipe"), "{error}");
    }
}
