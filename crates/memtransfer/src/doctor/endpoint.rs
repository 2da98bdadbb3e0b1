//! What the server of a model can do, as `policy-proc probe` finds out by asking it. The last report about each server is kept
//! for the runs that ask it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;
use std::time::SystemTime;

use anyhow::{Context, bail};
use conditions::settings::{DocumentSource, RunSettings};
use documents::DocumentName;
use domain::{cache_folder, create_private_folder};
use llm::{Endpoint, Servers, Source};
use orchestrator::documents::needed;
use orchestrator::run_documents::{RunDocuments, listed};
use orchestrator::selection::SelectedCases;
use run_log::DOCTOR_FILE;
use serde::Deserialize;
use serde_json::{Value, json};
use settings::{Layer, resolve, variable};
use supervise::sibling;

use super::{DoctorFinding, STOPPED};

/// The name of findings about a model's server.
const ENDPOINT: &str = "endpoint";

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

/// The settings of a run with `model`, as the environment has them.
fn settings(model: &str) -> anyhow::Result<RunSettings> {
    let flags = Layer::flags([("policy", "openai"), ("model", model)])?;
    Ok(resolve([Layer::environment(std::env::vars_os())?, flags])?.settings)
}

/// The servers that a run with `model` would ask; `base_url` is the flag's.
fn servers(model: &str, base_url: Option<&str>) -> anyhow::Result<Servers> {
    let of_variable = variable("base-url")?;
    let of_variable = of_variable.as_ref().and_then(Value::as_str);
    let given = base_url.map(|url| (url, Source::CommandLine));
    let given = given.or(of_variable.map(|url| (url, Source::Environment)));
    let servers = Servers::from_environment(given, Path::new("."))?;
    let headers = settings(model)?.model.map(|model| model.header).unwrap_or_default();
    Ok(servers.with_headers(&headers, false)?)
}

/// The most connections that a run with `model` keeps open to its servers.
pub(super) fn connections(model: &str, base_url: Option<&str>) -> anyhow::Result<u64> {
    let connections = settings(model)?.model.map_or(0, |model| model.max_connections);
    // A server that cannot be asked is another finding.
    let servers = servers(model, base_url).map_or(1, |servers| servers.all().count());
    Ok(u64::from(connections) * servers as u64)
}

/// The findings about each server that a run with `model` would ask.
pub(super) fn check(model: &str, base_url: Option<&str>, stop: &AtomicBool) -> Vec<DoctorFinding> {
    let failed = |error| vec![DoctorFinding::of(ENDPOINT, Err(error))];
    let servers = match servers(model, base_url) {
        Ok(servers) => servers,
        Err(error) => return failed(error),
    };
    let found = |server| check_server(model, server, &servers, stop).unwrap_or_else(failed);
    servers.all().flat_map(found).collect()
}

/// What one of the `servers` of a model can do. The whole report is the data of the first finding.
fn check_server(
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
    command.args(request_size(&settings, &documents.sizes()));
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
pub(crate) fn copy_reports(
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

/// The probe's flags about the largest requests of a run with these settings and characters of documents, one for each memory
/// that no other exceeds in views and in documents.
fn request_size(settings: &RunSettings, sizes: &BTreeMap<DocumentName, u64>) -> Vec<String> {
    let window = settings.groups.iter().flat_map(|group| &group.window).max();
    let size =
        |condition| needed(settings, [condition]).iter().filter_map(|name| sizes.get(name)).sum();
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
            request_size(&settings, &documents.sizes()).join(" "),
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

    /// A prompt has the views and documents of one memory, so no request has those of two.
    #[test]
    fn each_memory_has_a_largest_request_of_its_own_unless_another_exceeds_it() {
        let sizes = [("summary/original", 9000), ("semantic/original", 400), ("summary/4", 9900)];
        let sizes = sizes.map(|(name, bytes)| (name.parse().unwrap(), bytes)).into();
        for (memory, demos, expected) in [
            (
                "working,full-context,summary,semantic",
                "original",
                "full-context:40:0 summary:0:9000",
            ),
            ("episodic,full-context,hybrid,summary", "original", "full-context:40:0 hybrid:0:9400"),
            ("episodic,semantic", "original", "episodic:7:0 semantic:0:400"),
            ("summary", "original,4", "summary:0:9900"),
        ] {
            let given =
                [("policy", "openai"), ("model", "m"), ("memory", memory), ("demos", demos)];
            let settings = resolve([Layer::flags(given).unwrap()]).unwrap().settings;
            let flags = request_size(&settings, &sizes);
            let memories = flags.chunks(2).filter(|flag| flag[0] == "--memory-size");
            let memories: Vec<&str> = memories.map(|flag| &*flag[1]).collect();
            assert_eq!(memories.join(" "), expected, "{memory}");
        }
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
}
