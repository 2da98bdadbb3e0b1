//! `memtransfer doctor`: checks what a run needs by using it.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;
use std::time::SystemTime;

use anyhow::{Context, anyhow, bail, ensure};
use case_book::BookRequest;
use clap::{Args, ValueEnum};
use conditions::settings::{DocumentSource, RunSettings};
use documents::DocumentName;
use domain::{Pose, cache_folder, create_private_folder};
use llm::{Endpoint, Servers, Source};
use orchestrator::books::{Books, WRITING_TIMEOUT};
use orchestrator::documents::needed;
use orchestrator::run_documents::{RunDocuments, listed};
use orchestrator::scratch::{self, ScratchFolder};
use orchestrator::selection::SelectedCases;
use run_log::DOCTOR_FILE;
use rustix::fs::{Access, access};
use rustix::io::Errno;
use rustix::process::{Resource, getrlimit};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use settings::{Layer, resolve, variable};
use shm_types::process::{SHARED_MEMORY, check_shared_memory};
use shm_types::{RunDir, registry};
use supervise::sibling;

use super::list::list;
use super::{Exit, WorldArgs, print, print_json};
use crate::signals::{self, Signals};

/// Files that a process of a run opens, rounded up. The memory process opened most, 149, with 1 and with 1024 lanes.
const OPEN_FILES: u64 = 256;

/// The name of findings about a model's server.
const ENDPOINT: &str = "endpoint";

/// Why a check has no result.
const STOPPED: &str = "stopped by a signal";

#[derive(Debug, Args)]
#[command(after_help = "\
Exit status 1 when something is missing. Requests to a model are those of a run with the settings of
the environment: set MEMTRANSFER_IMAGE_BUDGET, MEMTRANSFER_REASONING and others as for
`memtransfer run`.

Examples:
  memtransfer doctor
  memtransfer doctor --world-cmd ./my-world
  memtransfer doctor --policy openai --model NAME --base-url http://localhost:8000/v1")]
pub(super) struct DoctorArgs {
    #[command(flatten)]
    world: WorldArgs,
    /// Also check the server of this policy's model, with about thirty requests, some of them of the size
    /// that a run sends
    #[arg(long, value_name = "POLICY", value_enum, requires = "model")]
    policy: Option<ModelPolicy>,
    /// With --policy openai: the model, by the name that the server knows
    #[arg(long, value_name = "NAME", env = "MEMTRANSFER_MODEL")]
    model: Option<String>,
    /// With --policy openai: the server, up to /v1, or several, each of which is checked [default:
    /// $MEMTRANSFER_BASE_URL, else $OPENAI_BASE_URL; the key is $OPENAI_API_KEY]
    #[arg(long, value_name = "URL,...")]
    base_url: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// A policy that asks a model.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum ModelPolicy {
    /// A model behind an OpenAI-compatible endpoint
    Openai,
}

/// The result of one check.
#[derive(Debug, Serialize)]
struct DoctorFinding {
    what: Cow<'static, str>,
    ok: bool,
    /// Whether a run works, but with doubtful results, or without keeping some of them for later runs.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    doubtful: bool,
    /// What was found, or what is wrong and how to fix it.
    about: String,
    /// Details, as data.
    #[serde(skip_serializing_if = "Option::is_none")]
    data: Option<Value>,
}

impl DoctorFinding {
    fn of(what: &'static str, outcome: anyhow::Result<String>) -> Self {
        let (ok, about) = match outcome {
            Ok(about) => (true, about),
            Err(error) => (false, format!("{error:#}")),
        };
        Self { what: what.into(), ok, doubtful: false, about, data: None }
    }
}

/// The parts of `policy-proc probe`'s report that are used here.
#[derive(Deserialize)]
struct Probed {
    endpoint: String,
    model: String,
    findings: Vec<ProbedFinding>,
    differences: Option<Vec<ProbedDifference>>,
}

#[derive(Deserialize)]
struct ProbedDifference {
    setting: String,
    paper: String,
    here: String,
}

#[derive(Deserialize)]
struct ProbedFinding {
    what: String,
    mark: ProbedMark,
    about: String,
}

#[derive(Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
enum ProbedMark {
    Ok,
    Doubtful,
    Bad,
}

pub(super) fn run(args: &DoctorArgs) -> anyhow::Result<Exit> {
    let signals = Signals::listen().context("cannot listen to signals")?;
    let findings = check(args, signals.stop())?;
    if let Some(signal) = signals.received() {
        say!("stopped by {}", signals::name(signal));
        return Ok(Exit::Signal(signal));
    }
    if args.json {
        print_json(&findings)?;
    } else {
        for DoctorFinding { what, ok, doubtful, about, .. } in &findings {
            let mark = match (ok, doubtful) {
                (false, _) => "NOT YET ",
                (true, true) => "doubtful",
                (true, false) => "ok      ",
            };
            print(&format!("{mark} {what}: {about}"))?;
        }
    }
    let all = findings.iter().all(|finding| finding.ok);
    Ok(if all { Exit::Complete } else { Exit::Failed })
}

/// All findings; those of programs are failures once `stop` is set.
fn check(args: &DoctorArgs, stop: &AtomicBool) -> anyhow::Result<Vec<DoctorFinding>> {
    // One view is rendered and then embedded, as in a run.
    let scratch = ScratchFolder::new().context("cannot make a temporary folder")?;
    let view = scratch.path().join("view.png");
    let mut findings = vec![
        match args.world.other.command() {
            Some(command) => DoctorFinding::of("world and cases", other_world(command)),
            None => DoctorFinding::of("warehouse and cases", world(&args.world)),
        },
        DoctorFinding::of("programs", programs()),
        DoctorFinding::of("shared memory", shared_memory()),
        DoctorFinding::of("open files", open_files(args)),
        cache(),
        DoctorFinding::of("rendering", rendering(&args.world, &view, stop)),
        DoctorFinding::of("ONNX Runtime and encoder", encoder(&args.world, &view, stop)),
        DoctorFinding::of("leftovers of killed runs", leftovers()),
    ];
    if let (Some(ModelPolicy::Openai), Some(model)) = (args.policy, &args.model) {
        match servers(args) {
            Err(error) => findings.push(DoctorFinding::of(ENDPOINT, Err(error))),
            Ok(servers) => {
                for server in servers.all() {
                    match endpoint(model, server, &servers, stop) {
                        Ok(found) => findings.extend(found),
                        Err(error) => findings.push(DoctorFinding::of(ENDPOINT, Err(error))),
                    }
                }
            }
        }
    }
    Ok(findings)
}

fn world(args: &WorldArgs) -> anyhow::Result<String> {
    let items = list::<Value>(args, "items", args.flags())?.len();
    let cases = args.program()?.describe(&args.flags())?.cases.len();
    Ok(format!("{items} items, {cases} cases (`memtransfer validate` checks them all)"))
}

/// The case book of the world that `command` starts.
fn other_world(command: &str) -> anyhow::Result<String> {
    let book = Books::of_world(Some(command), &BookRequest::default(), WRITING_TIMEOUT)?.cases.book;
    let world = &book.world.declaration;
    Ok(format!(
        "{} {}, {} cases, {} actions (`memtransfer conformance` checks how it takes part in runs)",
        world.name,
        world.version,
        book.cases.len(),
        world.actions.len()
    ))
}

fn programs() -> anyhow::Result<String> {
    let names = ["sim-proc", "memory-proc", "policy-proc"];
    names.into_iter().try_for_each(|name| sibling(name).map(drop))?;
    Ok(format!("{} lie beside this one", names.join(", ")))
}

fn shared_memory() -> anyhow::Result<String> {
    let run = RunDir::create(&registry::default_base())?;
    let attach = run.attach();
    check_shared_memory(attach.shared_memory_bytes())?;
    let mib = attach.shared_memory_bytes() >> 20;
    Ok(format!("{SHARED_MEMORY} has room for a default run ({mib} MiB at most)"))
}

/// Checks the limit on open files. A process of a run opens the services of the wire, the same number whatever the number of
/// lanes, and for a model a connection for each request in flight.
fn open_files(args: &DoctorArgs) -> anyhow::Result<String> {
    let mut needed = OPEN_FILES;
    if let (Some(ModelPolicy::Openai), Some(model)) = (args.policy, &args.model) {
        let connections = settings(model)?.model.map_or(0, |model| model.max_connections);
        // A server that cannot be asked is another finding.
        let servers = servers(args).map_or(1, |servers| servers.all().count());
        needed += u64::from(connections) * servers as u64;
    }
    let limit = getrlimit(Resource::Nofile).current;
    enough_files(needed, limit)
}

/// Whether a process may open `needed` files; no limit is `None`.
fn enough_files(needed: u64, limit: Option<u64>) -> anyhow::Result<String> {
    match limit {
        None => Ok("not limited".to_owned()),
        Some(limit) => {
            ensure!(
                limit >= needed,
                "a process of a run may open {limit} files, and needs up to {needed}: `ulimit -n {needed}`"
            );
            Ok(format!("{limit} in a process, of which a run needs up to {needed}"))
        }
    }
}

/// Checks that what runs keep for each other can be read and written.
fn cache() -> DoctorFinding {
    const WHAT: &str = "cache folder";
    let folder = match cache_folder().context("no folder") {
        Ok(folder) => folder,
        Err(error) => return DoctorFinding::of(WHAT, Err(error)),
    };
    let shown = folder.display();
    if let Err(error) = access(&folder, Access::READ_OK | Access::EXEC_OK) {
        let error = anyhow!("cannot read {shown}: {error}; `cargo xtask setup` makes and fills it");
        return DoctorFinding::of(WHAT, Err(error));
    }
    match unwritable(&folder) {
        None => DoctorFinding::of(WHAT, Ok(format!("{shown} can be read and written"))),
        Some((path, error)) => DoctorFinding {
            doubtful: true,
            ..DoctorFinding::of(
                WHAT,
                Ok(format!(
                    "{} cannot be written ({error}): runs use what is there, and can neither build documents that are \
                     missing nor keep embeddings and replies. Make it writable for this user, or set MEMTRANSFER_CACHE",
                    path.display()
                )),
            )
        },
    }
}

/// What a run would write in the cache folder `cache` and cannot, and why; what is not there yet would be made.
fn unwritable(cache: &Path) -> Option<(PathBuf, Errno)> {
    let mut written = Vec::new();
    for name in ["documents", "embeddings", "model-hashes", "responses"] {
        let folder = cache.join(name);
        if !folder.exists() {
            written.push(cache.to_owned());
            continue;
        }
        written.push(folder.clone());
        // These are written again, and not replaced.
        let is_kept = |path: &PathBuf| {
            path.ends_with("documents/lock") || path.extension().is_some_and(|ext| ext == "redb")
        };
        let files = folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
        written.extend(files.filter(is_kept));
    }
    written.into_iter().find_map(|path| {
        let wanted =
            if path.is_dir() { Access::WRITE_OK | Access::EXEC_OK } else { Access::WRITE_OK };
        access(&path, wanted).err().map(|error| (path, error))
    })
}

fn rendering(world: &WorldArgs, view: &Path, stop: &AtomicBool) -> anyhow::Result<String> {
    // Another process, because this one must notice when it is asked to stop.
    let mut command = Command::new(sibling("memtransfer")?);
    match world.other.command() {
        Some(other) => {
            let folder = view.with_extension("");
            let described = world.program()?.describe(&[])?;
            let case = described.cases.first().context("the world has no cases")?;
            command
                .args(["render", "--world-cmd", other, "--case", &case.id, "--out"])
                .arg(&folder);
            succeed(command, stop)?;
            std::fs::rename(folder.join("000.png"), view)?;
        }
        None => {
            command.args(["render", "--pose", &a_pose(world)?, "--out"]).arg(view);
            succeed(with_assets(command, world), stop)?;
        }
    }
    Ok("a view was rendered".to_owned())
}

fn encoder(world: &WorldArgs, view: &Path, stop: &AtomicBool) -> anyhow::Result<String> {
    ensure!(view.exists(), "not checked, because no view could be rendered");
    let mut command = Command::new(sibling("memory-proc")?);
    command.arg("embed").arg(view);
    succeed(with_assets(command, world), stop)?;
    Ok("the view was embedded".to_owned())
}

/// How many runs that have ended hold shared memory.
fn left_by(runs: usize) -> String {
    match runs {
        1 => "1 run that has ended holds shared memory".to_owned(),
        _ => format!("{runs} runs that have ended hold shared memory"),
    }
}

fn leftovers() -> anyhow::Result<String> {
    let runs = registry::list(&registry::default_base())?;
    let dead = runs.iter().filter(|run| !run.alive).count();
    ensure!(dead == 0, "{}: `memtransfer clean` removes what is left", left_by(dead));
    let folders = scratch::abandoned_folders().context("cannot search for temporary folders")?;
    let count = folders.len();
    let noun = if count == 1 { "folder" } else { "folders" };
    ensure!(count == 0, "{count} temporary {noun}: `memtransfer clean` removes what is left");
    Ok("none".to_owned())
}

/// The settings of a run with `model`, as the environment has them.
fn settings(model: &str) -> anyhow::Result<RunSettings> {
    let flags = Layer::flags([("policy", "openai"), ("model", model)])?;
    Ok(resolve([Layer::environment(std::env::vars_os())?, flags])?.settings)
}

/// The servers that a run would ask.
fn servers(args: &DoctorArgs) -> anyhow::Result<Servers> {
    let of_variable = variable("base-url")?;
    let of_variable = of_variable.as_ref().and_then(Value::as_str);
    let given = args.base_url.as_deref().map(|url| (url, Source::CommandLine));
    let given = given.or(of_variable.map(|url| (url, Source::Environment)));
    let servers = Servers::from_environment(given, Path::new("."))?;
    let model = args.model.as_deref().map(settings).transpose()?.and_then(|it| it.model);
    Ok(servers.with_headers(&model.map(|model| model.header).unwrap_or_default(), false)?)
}

/// What one of the `servers` of a model can do. The whole report is the data of the first finding.
fn endpoint(
    model: &str,
    server: &Endpoint,
    servers: &Servers,
    stop: &AtomicBool,
) -> anyhow::Result<Vec<DoctorFinding>> {
    let mut command = Command::new(sibling("policy-proc")?);
    command.args(["probe", "--json", "--model", model, "--base-url", &server.base()]);
    command.args(["--base-url-from", servers.source.word()]);
    let settings = settings(model)?;
    let documents = RunDocuments::of(&settings, &SelectedCases::of(&settings)?.books, false);
    command.args(request_size(&settings, &documents));
    let output = supervise::output(&mut command, stop)?.context(STOPPED)?;
    if output.stdout.is_empty() {
        bail!("{}", String::from_utf8_lossy(&output.stderr).trim());
    }
    let report: Value = serde_json::from_slice(&output.stdout).context("cannot read the probe")?;
    // What is wrong with the cache folder is another finding.
    let kept = cache_folder().map_err(anyhow::Error::from);
    if let Err(error) = kept.and_then(|cache| keep_report(&cache, model, server, &report)) {
        tracing::warn!("the report is not kept for runs: {error:#}");
    }
    let Probed { endpoint, model, findings, differences } = Probed::deserialize(&report)?;
    let whole = DoctorFinding {
        data: Some(report),
        ..DoctorFinding::of(ENDPOINT, Ok(format!("{model} at {endpoint} ({})", servers.places())))
    };
    let parts = findings.into_iter().map(|ProbedFinding { what, mark, about }| DoctorFinding {
        what: format!("{ENDPOINT}, {what}").into(),
        ok: mark != ProbedMark::Bad,
        doubtful: mark == ProbedMark::Doubtful,
        about,
        data: None,
    });
    let too_small = size_without(&documents.missing(), documents.builds_missing()).into_iter();
    let compared = differences.map(|mut differences| {
        differences.extend(other_documents(&settings));
        DoctorFinding::of("endpoint, against the paper", Ok(table(&differences)))
    });
    Ok(std::iter::once(whole).chain(parts).chain(too_small).chain(compared).collect())
}

/// The file in the cache folder of the last report about `model` at a server.
fn report_file(cache: &Path, model: &str, server: &Endpoint) -> PathBuf {
    let plain = |c: char| if c.is_ascii_alphanumeric() || c == '.' { c } else { '-' };
    let name = format!("{model} {}", server.base());
    let name: String = name.chars().take(LONGEST_NAME).map(plain).collect();
    cache.join("doctor").join(format!("{name}.json"))
}

/// Characters of a report's file name, which a model's name may exceed.
const LONGEST_NAME: usize = 200;

fn keep_report(cache: &Path, model: &str, server: &Endpoint, report: &Value) -> anyhow::Result<()> {
    let path = report_file(cache, model, server);
    create_private_folder(&cache.join("doctor"))?;
    let checked = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?.as_secs();
    let kept = json!({"checked": checked, "report": report});
    Ok(durable::output::write(&path, serde_json::to_vec(&kept)?)?)
}

/// Copies the last reports about the servers of `model` into the folder `out` of a run, each with the time in seconds since
/// 1970 at which it was made.
pub(super) fn copy_reports(
    cache: &Path,
    model: &str,
    servers: &Servers,
    out: &Path,
) -> anyhow::Result<()> {
    let read = |server| {
        let kept = durable::input::read(&report_file(cache, model, server)).ok()?;
        serde_json::from_slice::<Value>(&kept).ok()
    };
    let reports: Vec<Value> = servers.all().filter_map(read).collect();
    if reports.is_empty() {
        return Ok(());
    }
    let path = out.join(DOCTOR_FILE);
    let written = durable::output::write(&path, serde_json::to_vec_pretty(&reports)?);
    written.with_context(|| format!("cannot write {}", path.display()))
}

/// What a run does differently from the paper, one setting a line.
fn table(differences: &[ProbedDifference]) -> String {
    if differences.is_empty() {
        return "a run with this server does nothing differently, as far as these checks show"
            .to_owned();
    }
    let row = |ProbedDifference { setting, paper, here }: &ProbedDifference| {
        format!("\n  {setting:20} {here} (paper: {paper})")
    };
    let rows: String = differences.iter().map(row).collect();
    format!("what a run with this server does differently{rows}")
}

/// That documents are not by the model that decides, where a run with these settings has such.
fn other_documents(settings: &RunSettings) -> Option<ProbedDifference> {
    let model = settings.model.as_ref().map(|model| &model.model);
    let here = match &settings.documents {
        DocumentSource::Model(None) => return None,
        DocumentSource::Model(name) if name.as_ref() == model => return None,
        DocumentSource::Model(Some(name)) => format!("by {name}"),
        DocumentSource::Extractive => "by a script (--documents extractive)".to_owned(),
        DocumentSource::Folder(path) => format!("those in {}", path.display()),
    };
    Some(ProbedDifference {
        setting: "documents".to_owned(),
        paper: "by the model that decides".to_owned(),
        here,
    })
}

/// That the request of the run's size had no documents, if they are not built yet. `are_built`: by the run.
fn size_without(missing: &[DocumentName], are_built: bool) -> Option<DoctorFinding> {
    let when = match are_built {
        true => "a run builds them before its first episode",
        false => "`memtransfer memory build` builds them",
    };
    (!missing.is_empty()).then(|| DoctorFinding {
        doubtful: true,
        ..DoctorFinding::of(
            "endpoint, documents",
            Ok(format!(
                "the request of the run's size was without {}, which are not built yet: {when}; then check again",
                listed(missing)
            )),
        )
    })
}

/// The probe's flags about the largest requests of a run with these settings and documents, one for each memory that no other
/// exceeds in views and in documents.
fn request_size(settings: &RunSettings, documents: &RunDocuments) -> Vec<String> {
    let window = settings.groups.iter().flat_map(|group| &group.window).max();
    let sizes = documents.sizes();
    let size = |condition| needed([condition]).iter().filter_map(|name| sizes.get(name)).sum();
    let conditions = settings.conditions();
    let mut memories: Vec<(String, u32, u64)> = Vec::new();
    for condition in &conditions {
        let views = settings.memory_images_of(condition.memory);
        let one = (condition.memory.to_string(), views, size(condition));
        if !memories.iter().any(|other| other.1 >= one.1 && other.2 >= one.2) {
            memories.retain(|other| other.1 > one.1 || other.2 > one.2);
            memories.push(one);
        }
    }
    let memories = memories
        .into_iter()
        .map(|(name, views, characters)| ("--memory-size", format!("{name}:{views}:{characters}")));
    let mut flags = Vec::from_iter(memories);
    flags.extend([
        ("--frame-size", settings.frame_size.to_string()),
        ("--window", window.copied().unwrap_or(0).to_string()),
    ]);
    if let Some(model) = &settings.model {
        flags.extend(model.extra_body.clone().map(|body| ("--extra-body", body)));
        let prompt = model.prompt.iter().map(|path| ("--prompt", path.display().to_string()));
        flags.extend(prompt);
        flags.extend([
            ("--answer-tokens", model.answer_tokens.to_string()),
            ("--reasoning", model.reasoning.to_string()),
            ("--system-role", model.system_role.to_string()),
            ("--image-budget", model.image_budget.to_string()),
            ("--image-format", model.image_format.to_string()),
            ("--request-timeout", model.request_timeout.to_string()),
        ]);
    }
    flags.into_iter().flat_map(|(flag, value)| [flag.to_owned(), value]).collect()
}

/// A pose in the warehouse.
fn a_pose(world: &WorldArgs) -> anyhow::Result<String> {
    let world = world.program()?.describe(&world.flags())?;
    let begin = world.cases.first().and_then(|case| Some(case.references.first()?.begin));
    let begin = begin.context("the world has no case that begins anywhere")?;
    Ok(Pose::try_from(begin)?.to_string())
}

fn with_assets(mut command: Command, world: &WorldArgs) -> Command {
    if let Some(assets) = &world.assets {
        command.arg("--assets").arg(assets);
    }
    command
}

/// Runs `command`; what it prints on stderr is the error.
fn succeed(mut command: Command, stop: &AtomicBool) -> anyhow::Result<()> {
    let output =
        supervise::output(supervise::without_keys(&mut command), stop)?.context(STOPPED)?;
    let message = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{}", message.trim());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The request that the probe sends and times has the size of the run's.
    #[test]
    fn a_probe_has_the_size_of_the_run_and_says_what_it_lacks() {
        let empty = tempfile::tempdir().unwrap();
        let environment = Layer::flags([
            ("frame-size", "128"),
            ("image-budget", "12"),
            ("window", "3,9"),
            ("request-timeout", "77"),
            ("memory", "working,hybrid"),
            ("demos", "original"),
            ("documents", empty.path().to_str().unwrap()),
        ]);
        let flags = Layer::flags([("policy", "openai"), ("model", "m")]);
        let settings = resolve([environment.unwrap(), flags.unwrap()]).unwrap().settings;
        let documents = RunDocuments::of(&settings, &crate::estimate::tests::books(), false);
        insta::assert_snapshot!(
            request_size(&settings, &documents).join(" "),
            @"--memory-size working:0:0 --frame-size 128 --window 9 --answer-tokens 30 --reasoning off --system-role system --image-budget 12 --image-format png --request-timeout 77"
        );
        let about = |are_built| {
            let finding = size_without(&documents.missing(), are_built).unwrap();
            assert!(finding.ok && finding.doubtful);
            finding.about
        };
        insta::assert_snapshot!(about(documents.builds_missing()), @"the request of the run's size was without summary/original, semantic/original, which are not built yet: `memtransfer memory build` builds them; then check again");
        assert!(
            about(true).ends_with("a run builds them before its first episode; then check again")
        );
        assert!(size_without(&[], true).is_none());
    }

    #[test]
    fn documents_that_are_not_the_model_s_differ_from_the_paper() {
        let of = |documents: Option<&str>| {
            let flags = [("policy", "openai"), ("model", "m")].into_iter();
            let given = documents.map(|documents| ("documents", documents));
            let settings = resolve([Layer::flags(flags.chain(given)).unwrap()]).unwrap().settings;
            other_documents(&settings).map(|one| table(&[one]))
        };
        for own in [None, Some("model"), Some("model:m")] {
            assert_eq!(of(own), None);
        }
        insta::assert_snapshot!(of(Some("extractive")).unwrap(), @"
        what a run with this server does differently
          documents            by a script (--documents extractive) (paper: by the model that decides)
        ");
        assert!(of(Some("model:n")).unwrap().contains("  by n (paper: "));
        assert!(of(Some("./mine")).unwrap().contains("  those in ./mine (paper: "));
    }

    #[test]
    fn the_last_report_about_a_server_is_kept_with_its_runs() {
        let (cache, out) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let given = Some(("http://a/v1,http://b/v1", Source::CommandLine));
        let servers = Servers::from_environment(given, cache.path()).unwrap();
        let copy = |model| copy_reports(cache.path(), model, &servers, out.path()).unwrap();
        for report in [json!({"findings": 1}), json!({"findings": 2})] {
            keep_report(cache.path(), "org/m", &servers.first, &report).unwrap();
        }
        copy("other");
        assert!(!out.path().join(DOCTOR_FILE).exists());
        copy("org/m");
        let copied = std::fs::read(out.path().join(DOCTOR_FILE)).unwrap();
        let copied: Value = serde_json::from_slice(&copied).unwrap();
        assert_eq!(copied.as_array().map(Vec::len), Some(1));
        assert_eq!(copied[0]["report"]["findings"], 2);
        assert!(copied[0]["checked"].as_u64() > Some(1_700_000_000));
    }

    #[test]
    fn too_few_open_files_are_reported_with_the_command_that_raises_them() {
        assert!(enough_files(256, None).is_ok() && enough_files(256, Some(256)).is_ok());
        let error = enough_files(272, Some(128)).unwrap_err().to_string();
        assert!(
            error.contains("may open 128 files") && error.contains("`ulimit -n 272`"),
            "{error}"
        );
    }
}
