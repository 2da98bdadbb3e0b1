//! `sim-proc act` as a child process.

use std::ffi::OsString;
use std::fmt;
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::rc::Rc;

use anyhow::{Context, Result, bail};
use case_book::act::{ActAnswer, ActRequest, WorldDescription};
use run_log::{ELSEWHERE_FILE, ELSEWHERE_HASH, RunLog, STREAMS_FILE};

/// The program that knows the world, `sim-proc`, and a variable that it needs; or that of another world.
#[derive(Debug, Clone)]
pub struct WorldProgram {
    /// Its path.
    pub path: PathBuf,
    /// Its first arguments.
    pub arguments: Vec<String>,
    /// The command that starts the worlds of runs in other worlds, if the user has given one. What a run folder says is not
    /// started: it may come from anyone.
    pub world_cmd: Option<String>,
    /// Name and value of the variable.
    pub variable: (&'static str, &'static str),
}

type Answer = dyn FnMut(&ActRequest) -> Result<ActAnswer>;

/// Answers requests about the worlds of one run.
pub struct Asker(Box<Answer>);

type FindAsker = dyn Fn(&RunLog) -> Result<Asker>;

/// How to find the [`Asker`] of a run.
#[derive(Clone)]
pub struct WorldAccess(Rc<FindAsker>);

impl fmt::Debug for Asker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Asker")
    }
}

impl fmt::Debug for WorldAccess {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("WorldAccess")
    }
}

impl WorldAccess {
    /// Access through `find`.
    pub fn new(find: impl Fn(&RunLog) -> Result<Asker> + 'static) -> Self {
        Self(Rc::new(find))
    }

    /// The one that answers about the run `log`.
    pub(crate) fn asker(&self, log: &RunLog) -> Result<Asker> {
        (self.0)(log)
    }
}

impl Asker {
    /// One that answers by `answer`.
    pub fn new(answer: impl FnMut(&ActRequest) -> Result<ActAnswer> + 'static) -> Self {
        Self(Box::new(answer))
    }

    /// Asks. What cannot be answered is an error.
    pub fn ask(&mut self, request: &ActRequest) -> Result<ActAnswer> {
        match (self.0)(request)? {
            ActAnswer::Error(problem) => bail!(problem),
            answer => Ok(answer),
        }
    }
}

/// What the world of `asker` is.
pub(crate) fn describe(asker: &mut Asker) -> Result<WorldDescription> {
    match asker.ask(&ActRequest::World)? {
        ActAnswer::World(description) => Ok(description),
        _ => bail!("the world describes something else"),
    }
}

/// The files of the world of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WorldFiles {
    /// The folder of its assets; `None`: the built-in ones.
    pub assets: Option<PathBuf>,
    /// Its streams.
    pub streams: Option<PathBuf>,
    /// Its other world, in which tasks are demonstrated.
    pub elsewhere: Option<PathBuf>,
}

impl WorldFiles {
    /// Those of the run `log`.
    pub fn of(log: &RunLog) -> Self {
        let settings = &log.manifest.settings;
        let has_elsewhere = log.manifest.hashes.contains_key(ELSEWHERE_HASH);
        Self {
            assets: settings.assets.clone(),
            streams: settings.stream.is_some().then(|| log.dir.join(STREAMS_FILE)),
            elsewhere: has_elsewhere.then(|| log.dir.join(ELSEWHERE_FILE)),
        }
    }

    /// As arguments of the program.
    pub(crate) fn arguments(self) -> Vec<OsString> {
        let Self { assets, streams, elsewhere } = self;
        let flags =
            [("--assets", assets), ("--streams", streams), ("--elsewhere", elsewhere)].into_iter();
        let given = flags.filter_map(|(name, file)| Some([name.into(), file?.into()]));
        given.flatten().collect()
    }
}

impl WorldProgram {
    /// Access to the worlds of runs through this program.
    pub fn access(&self) -> WorldAccess {
        let program = self.clone();
        WorldAccess::new(move |log| program.of_run(log)?.asker(&WorldFiles::of(log).arguments()))
    }

    /// The program of the world of the run `log`.
    ///
    /// # Errors
    /// When it is another world, and the user has not said how to start it.
    pub fn of_run(&self, log: &RunLog) -> Result<Self> {
        let settings = &log.manifest.settings;
        let Some(flag) = settings.own_world() else { return Ok(self.clone()) };
        let recorded = settings.world_cmd.as_deref().unwrap_or(flag);
        self.other_world()?.with_context(|| {
            format!(
                "this run took place in another world, which has to be asked: if you trust its program, give the command that \
                 starts it as --world-cmd, or set MEMTRANSFER_WORLD_CMD; the run was made with: {recorded}"
            )
        })
    }

    /// The program of the world that the user's command starts, if there is one.
    ///
    /// # Errors
    /// When it is no command.
    pub fn other_world(&self) -> Result<Option<Self>> {
        let Some(command) = &self.world_cmd else { return Ok(None) };
        let words = shlex::split(command).unwrap_or_default();
        let (path, arguments) = words.split_first().context("--world-cmd is no command")?;
        Ok(Some(Self { path: path.into(), arguments: arguments.to_vec(), ..self.clone() }))
    }

    /// Starts it to answer about the world that `arguments` say.
    ///
    /// # Errors
    /// When it cannot be started.
    pub fn asker(&self, arguments: &[OsString]) -> Result<Asker> {
        let mut running = RunningStage::start(self, arguments)?;
        Ok(Asker::new(move |request| running.ask(request)))
    }

    /// Describes the world that `arguments` say.
    ///
    /// # Errors
    /// When it cannot be used.
    pub fn describe(&self, arguments: &[OsString]) -> Result<WorldDescription> {
        describe(&mut self.asker(arguments)?)
    }

    /// What it prints with `verb` and `arguments`, and whether all is well: status 1 says that it is not.
    ///
    /// # Errors
    /// When it cannot be started, and what it gives as the reason for another status.
    pub fn print(&self, verb: &str, arguments: &[OsString]) -> Result<(String, bool)> {
        let output = self.command(verb).args(arguments).stdin(Stdio::null()).output();
        let output = output.with_context(|| format!("cannot start {}", self.path.display()))?;
        let messages = String::from_utf8_lossy(&output.stderr);
        match output.status.code() {
            Some(status @ (0 | 1)) => {
                eprint!("{messages}");
                Ok((String::from_utf8(output.stdout)?, status == 0))
            }
            _ if messages.is_empty() => bail!("{}: {}", self.path.display(), output.status),
            _ => {
                let reason = messages.trim_end();
                bail!("{}", reason.strip_prefix("sim-proc: ").unwrap_or(reason))
            }
        }
    }

    /// It with `verb` and its variable.
    pub fn command(&self, verb: &str) -> Command {
        let mut command = Command::new(&self.path);
        command.args(&self.arguments).arg(verb).env(self.variable.0, self.variable.1);
        for variable in domain::KEY_VARIABLES {
            command.env_remove(variable);
        }
        command
    }

    /// Starts a [`command`](Self::command) that answers on stdout what it reads on stdin.
    pub(crate) fn start(
        &self,
        mut command: Command,
    ) -> Result<(Child, ChildStdin, BufReader<ChildStdout>)> {
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("cannot start {}", self.path.display()))?;
        let pipes = child.stdin.take().zip(child.stdout.take());
        let (requests, answers) = pipes.context("a child process without pipes")?;
        Ok((child, requests, BufReader::new(answers)))
    }
}

/// The child process. It ends when this is dropped.
struct RunningStage {
    child: Child,
    requests: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

impl RunningStage {
    fn start(program: &WorldProgram, arguments: &[OsString]) -> Result<Self> {
        let mut command = program.command("act");
        command.args(arguments);
        let (child, requests, answers) = program.start(command)?;
        Ok(Self { child, requests: Some(requests), answers })
    }

    fn ask(&mut self, request: &ActRequest) -> Result<ActAnswer> {
        let mut line = serde_json::to_vec(request)?;
        line.push(b'\n');
        let mut answer = String::new();
        let sent = self.requests.as_mut().map(|pipe| pipe.write_all(&line));
        if !matches!(sent, Some(Ok(()))) || self.answers.read_line(&mut answer)? == 0 {
            bail!("the program that knows the world ended early; its messages are above");
        }
        serde_json::from_str(&answer).with_context(|| {
            let begin: String = answer.trim_end().chars().take(80).collect();
            format!(
                "the program that knows the world is another version, or something in it prints to standard output: it \
                 answered `{begin}`"
            )
        })
    }
}

impl Drop for RunningStage {
    fn drop(&mut self) {
        // Its input ends, and so does it.
        self.requests = None;
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
