//! The harness of all drills: runs in a sandbox, trials that disturb one each, and what must be true afterwards.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::io;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

use memory_proc::paths::CacheFolder;
use memtransfer_tests::{Ended, kill, processes_of, program, shared_memory_of, sorted_log};

use crate::Extent;
use crate::report::Report;

/// The shared library that counts calls and disturbs processes.
const FAULTS: &str = include_str!("faults.c");

/// How long processes may take to end that nothing keeps alive. Machines that run drills are loaded.
const PATIENCE: Duration = Duration::from_secs(180);

/// How often a command is repeated until its run is complete. A fault can end a run more than once: it stays excluded for a
/// session.
const REPETITIONS: u32 = 3;

/// One disturbance of a run.
pub(crate) struct Trial {
    /// Names the trial in a violation.
    pub(crate) name: String,
    /// The kind of disturbance, as the report counts them.
    pub(crate) class: String,
    /// Disturbs a run, and checks that it recovers. Returns whether the disturbance took place before the run was over.
    pub(crate) disturb: Disturb,
}

/// Disturbs a run, and checks that it recovers. Returns whether the disturbance took place.
type Disturb = Box<dyn FnOnce(&mut Sandbox) -> Result<bool, String> + Send>;

impl Trial {
    pub(crate) fn new(
        name: impl Into<String>,
        class: impl Into<String>,
        disturb: impl FnOnce(&mut Sandbox) -> Result<bool, String> + Send + 'static,
    ) -> Self {
        Self { name: name.into(), class: class.into(), disturb: Box::new(disturb) }
    }
}

/// Executes `trials`, one in each sandbox at a time, until all are done, `most` faults took place or time is over.
pub(crate) fn execute(
    extent: &Extent,
    report: &mut Report,
    sandboxes: Vec<Sandbox>,
    most: u64,
    trials: impl Iterator<Item = Trial> + Send,
) {
    let next = Mutex::new((report, trials));
    let lock = || next.lock().expect("no thread panics");
    let next_trial = || {
        let (report, trials) = &mut *lock();
        let is_over = report.faults() >= most || extent.is_over(report);
        if is_over { None } else { trials.next() }
    };
    let next_trial = &next_trial;
    thread::scope(|scope| {
        for mut sandbox in sandboxes {
            scope.spawn(move || {
                while let Some(Trial { name, class, disturb }) = next_trial() {
                    let took_place = disturb(&mut sandbox);
                    let (report, _) = &mut *lock();
                    report.add("trials", 1.0);
                    match took_place {
                        Ok(false) => report.add("trials without a disturbance", 1.0),
                        Ok(true) => report.fault(&class),
                        Err(violation) => {
                            report.fault(&class);
                            report.outcome(&name, Err(violation));
                        }
                    }
                }
            });
        }
    });
}

/// The folders of a drill's runs. Numbers in their names do not count for the patterns of paths.
pub(crate) struct Sandbox {
    folder: PathBuf,
    runs: u32,
    undisturbed: BTreeMap<RunWorld, Undisturbed>,
}

/// Which world a run takes place in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum RunWorld {
    Warehouse,
    /// That of `--world-cmd`, the program [`EXTERNAL_WORLD`].
    External,
}

/// The program of an external world.
pub(crate) const EXTERNAL_WORLD: &str = "misbehaving-world";

/// A run that was not disturbed.
struct Undisturbed {
    /// The log, sorted.
    log: Vec<String>,
    /// Seconds that it took.
    seconds: f64,
}

/// One run: the arguments of its command, and where it is recorded.
pub(crate) struct Run {
    pub(crate) out: PathBuf,
    pub(crate) args: Vec<String>,
    world: RunWorld,
}

impl Run {
    /// Lets the same policy be a command of the user's, which sees the same frames.
    pub(crate) fn make_policy_external(&mut self) {
        let command = format!("{} serve --policy grounded", program("policy-proc").display());
        if let Some(at) = self.args.iter().position(|arg| arg == "--policy") {
            let flags = ["--policy-cmd", &command, "--plates", "on"].map(str::to_owned);
            self.args.splice(at..at + 2, flags);
        }
    }
}

impl Sandbox {
    /// As many as told, with an undisturbed run in each of `worlds`. These run at the same time: how long one takes depends on the
    /// others.
    pub(crate) fn several(count: u32, worlds: &[RunWorld]) -> Result<Vec<Self>, String> {
        let mut sandboxes = (0..count).map(Self::new).collect::<Result<Vec<_>, _>>()?;
        if let Some(first) = sandboxes.first() {
            let embeddings = first.embed(worlds)?;
            for sandbox in &sandboxes {
                copy_folder(&embeddings, &sandbox.cache().join("embeddings"))
                    .map_err(|error| format!("cannot copy {}: {error}", embeddings.display()))?;
            }
        }
        thread::scope(|scope| {
            let runs: Vec<_> = sandboxes
                .iter_mut()
                .map(|sandbox| scope.spawn(move || sandbox.run_undisturbed(worlds)))
                .collect();
            runs.into_iter().try_for_each(|run| run.join().expect("no thread panics"))
        })?;
        Ok(sandboxes)
    }

    /// One, with an undisturbed run in the warehouse.
    pub(crate) fn one() -> Result<Self, String> {
        Self::several(1, &[RunWorld::Warehouse])?.pop().ok_or_else(|| "no sandbox".to_owned())
    }

    fn new(number: u32) -> Result<Self, String> {
        let folder = PathBuf::from(format!("/tmp/mtd{}{number:02}", std::process::id()));
        let sandbox = Self { folder, runs: 0, undisturbed: BTreeMap::new() };
        sandbox
            .prepare()
            .map_err(|error| format!("cannot prepare {}: {error}", sandbox.folder.display()))?;
        Ok(sandbox)
    }

    /// Lets runs embed their images with the user's cache, so that the next drill finds them there. Returns the folder of that
    /// cache's embeddings.
    fn embed(&self, worlds: &[RunWorld]) -> Result<PathBuf, String> {
        let users = CacheFolder::from_environment().map_err(|error| error.to_string())?;
        for &world in worlds {
            let out = self.folder.join("runs").join(format!("embeds-{world:?}"));
            let mut command = self.command(&Self::run_of(world, out).args);
            check_complete(&Ended::run(command.env("MEMTRANSFER_CACHE", users.root())))?;
        }
        Ok(users.root().join("embeddings"))
    }

    fn run_undisturbed(&mut self, worlds: &[RunWorld]) -> Result<(), String> {
        // The first run takes longer: it also hashes the models.
        for &world in worlds.iter().chain(worlds) {
            let run = self.run_in_world(world);
            let began = Instant::now();
            let ended = Ended::of(self.start(&run, &[])?);
            let seconds = began.elapsed().as_secs_f64();
            check_complete(&ended)?;
            self.undisturbed.insert(world, Undisturbed { log: sorted_log(&run.out), seconds });
            self.check_clean()?;
        }
        Ok(())
    }

    /// The folders, the library, and a cache that shares the models with the user's, and nothing that is written.
    fn prepare(&self) -> io::Result<()> {
        fs::create_dir(&self.folder)?;
        fs::create_dir(self.folder.join("runs"))?;
        let cache = self.cache();
        fs::create_dir(&cache)?;
        let users = CacheFolder::from_environment().map_err(io::Error::other)?;
        for name in ["models", "onnxruntime"] {
            symlink(users.root().join(name), cache.join(name))?;
        }
        let source = self.folder.join("faults.c");
        fs::write(&source, FAULTS)?;
        let mut cc = Command::new("cc");
        cc.args(["-shared", "-fPIC", "-O1", "-o"]).arg(self.library()).arg(&source).arg("-ldl");
        match cc.status()?.success() {
            true => Ok(()),
            false => Err(io::Error::other("cc cannot compile faults.c")),
        }
    }

    pub(crate) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(crate) fn cache(&self) -> PathBuf {
        self.folder.join("cache")
    }

    /// Where live runs are registered.
    pub(crate) fn registry(&self) -> PathBuf {
        self.folder.join("r")
    }

    fn library(&self) -> PathBuf {
        self.folder.join("faults.so")
    }

    /// The undisturbed run in the world of `run`.
    fn undisturbed(&self, run: &Run) -> &Undisturbed {
        &self.undisturbed[&run.world]
    }

    /// Seconds that a run takes.
    pub(crate) fn usual(&self, run: &Run) -> f64 {
        self.undisturbed(run).seconds
    }

    /// Notes that a run took so many seconds: other runs at a time make it faster or slower than the first was.
    pub(crate) fn took(&mut self, run: &Run, seconds: f64) {
        if let Some(Undisturbed { seconds: usual, .. }) = self.undisturbed.get_mut(&run.world) {
            *usual = 0.8 * *usual + 0.2 * seconds;
        }
    }

    /// A short run that has not begun: all kinds of processes, built-in memories and an external one.
    pub(crate) fn run(&mut self) -> Run {
        self.run_in_world(RunWorld::Warehouse)
    }

    /// As [`Self::run`], in this world.
    pub(crate) fn run_in_world(&mut self, world: RunWorld) -> Run {
        self.runs += 1;
        Self::run_of(world, self.folder.join("runs").join(self.runs.to_string()))
    }

    /// As [`Self::run`], in this folder.
    pub(crate) fn run_in(out: PathBuf) -> Run {
        Self::run_of(RunWorld::Warehouse, out)
    }

    fn run_of(world: RunWorld, out: PathBuf) -> Run {
        let well_behaved = |name: &str| format!("{} well-behaved", program(name).display());
        let mut args: Vec<String> = "run --starts original,new --demos original --memory working,episodic \
                                     --frame-size 64 --lanes 3"
            .split_whitespace()
            .chain(match world {
                RunWorld::Warehouse => {
                    "--policy grounded --cases t01-01,t03-02 --max-steps 6 --backend cpu".split(' ')
                }
                RunWorld::External => {
                    "--policy imitate --cases corridor-1,corridor-2 --routes unchanged,blocked --max-steps 20".split(' ')
                }
            })
            .map(str::to_owned)
            .collect();
        if world == RunWorld::External {
            args.extend(["--world-cmd".to_owned(), well_behaved(EXTERNAL_WORLD)]);
        }
        args.extend(["--memory-cmd".to_owned(), well_behaved("misbehaving-memory")]);
        args.extend(["--out".to_owned(), out.display().to_string()]);
        Run { out, args, world }
    }

    /// The command `memtransfer` with `args` in the sandbox.
    pub(crate) fn command(&self, args: &[String]) -> Command {
        let mut command = Command::new(program("memtransfer"));
        command.args(args);
        self.in_sandbox(&mut command);
        command
    }

    /// Makes a command use the sandbox.
    pub(crate) fn in_sandbox(&self, command: &mut Command) {
        command
            .current_dir(&self.folder)
            .env("MEMTRANSFER_RUN_DIR", self.registry())
            .env("MEMTRANSFER_CACHE", self.cache())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
    }

    /// Starts a run, with these variables, and with [`FAULTS`] loaded if they are for that.
    pub(crate) fn start(&self, run: &Run, variables: &[(&str, String)]) -> Result<Child, String> {
        let mut command = self.command(&run.args);
        if variables.iter().any(|(name, _)| name.starts_with("DRILL_")) {
            command.env("LD_PRELOAD", self.library());
        }
        command.envs(variables.iter().map(|(name, value)| (name, value)));
        command.spawn().map_err(|error| format!("cannot start memtransfer: {error}"))
    }

    /// What must be true when the command of a disturbed run has ended, with `was_killed` by the drill: it said why, no
    /// process goes on, and the same command completes the run with the log of an undisturbed one.
    pub(crate) fn check_recovery(
        &self,
        run: &Run,
        ended: &Ended,
        was_killed: bool,
    ) -> Result<(), String> {
        check_message(ended, was_killed)?;
        self.wait_for_processes()?;
        let (mut status, mut last) = (ended.status, String::new());
        for _ in 0..REPETITIONS {
            if status == Some(0) {
                break;
            }
            let again = Ended::of(self.start(run, &[])?);
            check_message(&again, false)?;
            (status, last) = (again.status, again.stderr);
        }
        if status != Some(0) {
            return Err(format!(
                "not complete after {REPETITIONS} more times; at first: {}; at last: {last}",
                ended.stderr
            ));
        }
        self.check_log(run)?;
        fs::remove_dir_all(&run.out).map_err(|error| format!("{}: {error}", run.out.display()))?;
        self.check_clean()
    }

    /// The log is that of an undisturbed run.
    pub(crate) fn check_log(&self, run: &Run) -> Result<(), String> {
        let (log, reference) = (sorted_log(&run.out), &self.undisturbed(run).log);
        if log == *reference {
            return Ok(());
        }
        let differs = log.iter().zip(reference).find(|(one, other)| one != other);
        Err(format!(
            "the log has {} lines and differs from that of an undisturbed run, which has {}; the first difference: \
             {differs:?}",
            log.len(),
            reference.len()
        ))
    }

    /// Waits for all processes of all runs to end.
    pub(crate) fn wait_for_processes(&self) -> Result<(), String> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let left = processes_of(&self.registry());
            if left.is_empty() {
                return Ok(());
            }
            if Instant::now() > deadline {
                let named: Vec<String> = left.iter().map(|pid| describe(*pid)).collect();
                left.into_iter().for_each(kill);
                return Err(format!("processes go on: {}", named.join("; ")));
            }
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// The process of the run that has this program.
    pub(crate) fn process(&self, program: &str) -> Option<u32> {
        processes_of(&self.registry()).into_iter().find(|pid| {
            let exe = fs::read_link(format!("/proc/{pid}/exe")).unwrap_or_default();
            exe.file_name() == Some(OsStr::new(program))
        })
    }

    /// Kills the process of the run that has this program, if it is there.
    pub(crate) fn kill_program(&self, program: &str) {
        self.process(program).into_iter().for_each(kill);
    }

    /// `memtransfer clean` leaves nothing.
    pub(crate) fn check_clean(&self) -> Result<(), String> {
        let runs = self.registered();
        let clean = self.command(&["clean".to_owned()]).spawn();
        let clean = Ended::of(clean.map_err(|error| format!("cannot start memtransfer: {error}"))?);
        if clean.status != Some(0) {
            return Err(format!("`memtransfer clean` fails: {}", clean.stderr));
        }
        let mut left = shared_memory_of(&runs);
        left.extend(self.registered());
        if left.is_empty() {
            return Ok(());
        }
        let said = clean.stdout;
        Err(format!("left after `memtransfer clean`, which said {said:?}: {}", left.join(", ")))
    }

    /// The names of all registered runs.
    pub(crate) fn registered(&self) -> Vec<String> {
        let entries = fs::read_dir(self.registry()).into_iter().flatten().flatten();
        let folders = entries.filter(|entry| entry.path().is_dir());
        folders.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
    }
}

impl Drop for Sandbox {
    fn drop(&mut self) {
        processes_of(&self.registry()).into_iter().for_each(kill);
        if let Err(error) = fs::remove_dir_all(&self.folder) {
            eprintln!("cannot remove {}: {error}", self.folder.display());
        }
    }
}

/// An undisturbed run is complete.
fn check_complete(ended: &Ended) -> Result<(), String> {
    match ended.status {
        Some(0) => Ok(()),
        _ => Err(format!("an undisturbed run fails: {}", ended.stderr)),
    }
}

/// Copies the files of a folder, which is made anew.
fn copy_folder(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir(to)?;
    for file in fs::read_dir(from)? {
        let file = file?;
        fs::copy(file.path(), to.join(file.file_name()))?;
    }
    Ok(())
}

/// A process that fails says why, and no process panics.
fn check_message(ended: &Ended, was_killed: bool) -> Result<(), String> {
    if ended.stderr.contains("panicked at") {
        return Err(format!("a panic: {}", ended.stderr));
    }
    match ended.status {
        Some(0) => Ok(()),
        None if was_killed => Ok(()),
        None => Err(format!("ended on a signal, or did not end in time: {}", ended.stderr)),
        Some(_) if ended.stderr.trim().is_empty() => Err("failed without a message".to_owned()),
        Some(_) => Ok(()),
    }
}

/// A process for a message: its number, command line, and state.
fn describe(pid: u32) -> String {
    let read = |file: &str| fs::read(format!("/proc/{pid}/{file}")).unwrap_or_default();
    let line = String::from_utf8_lossy(&read("cmdline")).replace('\0', " ");
    let waits = String::from_utf8_lossy(&read("wchan")).into_owned();
    format!("{pid} ({line}, in {waits})")
}
