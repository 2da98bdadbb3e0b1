//! Memories in Python, started by runs.

use std::fs;
use std::process::{Child, Command};

use crate::{Bench, Ended, eventually, needs, processes_of, processes_with, repository};

/// The command that starts the memory in `examples/memories/NAME` with the Python that has its packages.
pub fn example(name: &str) -> String {
    let script = repository(&script(name));
    // All three need numpy.
    let packages = if matches!(name, "learning" | "stitch") { "top-k" } else { name };
    format!("{} {}", needs::memory_python(packages).display(), script.display())
}

fn script(name: &str) -> String {
    format!("examples/memories/{name}/memory.py")
}

/// `memtransfer` with these arguments and external memories, not started yet.
pub fn command(bench: &Bench, args: &[&str], memories: &[String]) -> Command {
    let mut command = bench.command(args);
    command.args(memories.iter().flat_map(|memory| ["--memory-cmd", memory]));
    command.env("PYTHONPATH", repository("python"));
    command
}

/// Starts [`command`].
pub fn start(bench: &Bench, args: &[&str], memories: &[String]) -> Child {
    command(bench, args, memories).spawn().expect("memtransfer starts")
}

/// Runs [`command`] and waits for it.
pub fn run(bench: &Bench, args: &[&str], memories: &[String]) -> Ended {
    Ended::of(start(bench, args, memories))
}

/// The process that runs the script of an example in a run of this bench; waits for it to start.
pub fn process_of_example(bench: &Bench, name: &str) -> u32 {
    let script = repository(&script(name));
    eventually(&format!("the memory {name} to start"), || {
        let started = processes_with(script.as_os_str().as_encoded_bytes());
        (&started & &processes_of(bench.registry.path())).into_iter().find(|pid| {
            let exe = fs::read_link(format!("/proc/{pid}/exe")).unwrap_or_default();
            exe.file_name().is_some_and(|name| name.to_string_lossy().contains("python"))
        })
    })
}
