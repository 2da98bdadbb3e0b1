//! Settings: small text files and words.

use std::fs;
use std::path::Path;

use conditions::cost::{ModelPrices, Money};
use conditions::key::EpisodeKey;
use conditions::settings::{CaseSelector, RunSettings};
use conditions::{Condition, Demonstrations};
use domain::events::Visit;
use domain::{Action, ExternalName, MemoryKind, Pose};
use memory_proc::manifest::EncoderManifest;
use orchestrator::plan::plan;
use report::Published;
use rigs::records::{log, record, under};
use settings::{Layer, resolve};
use shm_types::description::DESCRIPTION_FILE;
use shm_types::{Attach, MemoryDescription};

use super::folders::is_harmless;
use crate::files::{with_files, with_folder};

/// What is read is valid, and is written and read back equal.
pub(crate) fn attach(input: &[u8]) {
    const ATTACH_FILE: &str = "attach.json";
    with_files(&[], &[ATTACH_FILE, DESCRIPTION_FILE], input, |folder| {
        if let Ok(attach) = Attach::read(folder) {
            attach.check().unwrap();
            assert!(attach.batch_len() >= 1 && attach.frame.bytes() <= 4096 * 4096 * 4);
            assert!(attach.shared_memory_bytes() > 0);
            attach.write(folder).unwrap();
            assert_eq!(Attach::read(folder).unwrap(), attach);
        }
        if let Ok(description) = MemoryDescription::read(folder) {
            description.write(folder).unwrap();
            assert_eq!(MemoryDescription::read(folder).unwrap(), description);
        }
    });
}

/// A word that is read is written as a word that is read as the same.
pub(crate) fn names(input: &[u8]) {
    fn round_trip<T: std::str::FromStr + ToString + PartialEq + std::fmt::Debug>(text: &str) {
        if let Ok(value) = text.parse::<T>() {
            assert_eq!(value.to_string().parse().ok(), Some(value), "{text:?}");
        }
    }
    let Ok(text) = str::from_utf8(input) else { return };
    round_trip::<Condition>(text);
    round_trip::<Demonstrations>(text);
    round_trip::<MemoryKind>(text);
    round_trip::<ExternalName>(text);
    round_trip::<CaseSelector>(text);
    round_trip::<Pose>(text);
    round_trip::<Visit>(text);
    round_trip::<Money>(text);
    round_trip::<documents::DocumentName>(text);
    if let Some(key) = EpisodeKey::read(text) {
        assert_eq!(EpisodeKey::read(&key.to_string()), Some(key));
    }
    let _ = text.parse::<world_client::Selection>();
    let _ = text.parse::<viewer::Address>();
    let _ = text.parse::<export::HubDataset>();
    let _ =
        world_client::frames::of_file_name(text).map(|view| world_client::frames::file_name(&view));
    let _ = text.chars().filter_map(Action::from_letter).count();
}

/// A suite is refused, or resolved to settings that are read back equal and plan episodes.
pub(crate) fn suite(input: &[u8]) {
    with_folder(|folder| {
        let file = folder.join("suite.toml");
        fs::write(&file, input).unwrap();
        let layer = Layer::flags([("suite", file.to_str().unwrap())]).unwrap();
        let Ok(resolved) = resolve([layer]) else { return };
        let text = serde_json::to_string(&resolved.settings).unwrap();
        let again: RunSettings = serde_json::from_str(&text).unwrap();
        assert_eq!(again, resolved.settings);
        let runs = again.runs();
        assert_eq!(
            plan(&runs, &[0], &["t01-01"], again.seed).take(100).count() > 0,
            !runs.is_empty()
        );
    });
}

/// Published figures that are read are shown beside a run's.
pub(crate) fn published(input: &[u8]) {
    with_folder(|folder| {
        let file = folder.join("figures.toml");
        fs::write(&file, input).unwrap();
        let Ok(published) = Published::read(&file) else { return };
        let conditions = ["working/new/unchanged/none", "episodic/new/unchanged/4"];
        let episode = |name: &str, case| under(name.parse().unwrap(), record(case, true));
        let episodes = conditions.map(|name| ["t01-01", "t03-02"].map(|case| episode(name, case)));
        let logs = [log(episodes.into_iter().flatten().collect())];
        let options = report::Options { against: Some(&published), latex: true };
        let page = report::write(&logs, &folder.join("report"), options).unwrap();
        is_harmless(&fs::read_to_string(page).unwrap());
        Published::read(&folder.join("report/published.toml")).unwrap();
    });
}

pub(crate) fn encoders(input: &[u8]) {
    let Ok(text) = str::from_utf8(input) else { return };
    if let Ok(manifest) = EncoderManifest::parse(text, Path::new("models.toml")) {
        manifest.model(&manifest.default).unwrap();
    }
}

/// The variables of a file are words of it.
pub(crate) fn env_file(input: &[u8]) {
    with_folder(|folder| {
        let file = folder.join(".env");
        fs::write(&file, input).unwrap();
        let Ok(variables) = llm::fuzzing::env_file(&file) else { return };
        let text = str::from_utf8(input).unwrap();
        for (name, value) in variables {
            assert!(!name.is_empty() && text.contains(&name) && text.contains(&value));
        }
    });
}

pub(crate) fn prices(input: &[u8]) {
    let Ok(text) = str::from_utf8(input) else { return };
    if let Ok(prices) = ModelPrices::parse(text, "m") {
        let text = serde_json::to_string(&prices).unwrap();
        assert_eq!(serde_json::from_str::<ModelPrices>(&text).unwrap(), prices);
    }
}
