//! `setup.toml` as typed values: everything that set-up may install.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Deserialize;

/// The file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Pins {
    /// System packages, in installation order.
    #[serde(default)]
    pub(crate) system: Vec<SystemNeed>,
    /// Files in the cache folder.
    #[serde(default)]
    pub(crate) file: Vec<FilePin>,
    /// Python environments in the cache folder.
    #[serde(default)]
    pub(crate) environment: Vec<EnvironmentPin>,
}

/// When something is installed.
#[derive(Deserialize, Default, Clone, Copy, PartialEq, Eq, Debug)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Wanted {
    /// By every set-up.
    #[default]
    Always,
    /// By a set-up for tests.
    ForTests,
    /// By a set-up for benches.
    ForBenches,
    /// Only by a verb of its own.
    OnDemand,
}

/// Purpose of a set-up.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Purpose {
    /// Running the program.
    Use,
    /// Running it and its tests.
    Tests,
    /// Running it and its benches.
    Benches,
    /// What needs the file or environment at this place, and nothing else.
    Only(&'static str),
}

/// A system requirement.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SystemNeed {
    pub(crate) name: String,
    pub(crate) why: String,
    pub(crate) probe: Probe,
    /// Debian package names.
    pub(crate) packages: Vec<String>,
    #[serde(default)]
    pub(crate) wanted: Wanted,
}

/// How to detect that a [`SystemNeed`] is met without a package manager.
#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Probe {
    /// `python3 -m MODULE --version` works.
    PythonModule(String),
    /// A program with one of these names is in PATH.
    Program(Vec<String>),
    /// A shared library of this name is in one of the usual folders.
    Library(String),
    /// One of these folders has a Vulkan driver's manifest whose library is there.
    VulkanManifests(Vec<PathBuf>),
}

/// A file in the cache folder.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FilePin {
    /// Relative to the cache folder.
    pub(crate) place: PathBuf,
    pub(crate) why: String,
    /// SHA-256 of the file, one for each platform that has its own.
    pub(crate) sha256: Vec<String>,
    /// The wheel that it is in, as a line of a requirements file with hashes.
    pub(crate) wheel: Option<String>,
    /// What it is copied or made from, relative to the unpacked wheel or, without one, to the cache folder.
    pub(crate) source: Option<PathBuf>,
    /// What makes it, relative to the workspace; called as `python3 SCRIPT [SOURCE] OUTPUT ARGUMENTS...`.
    pub(crate) script: Option<PathBuf>,
    #[serde(default)]
    pub(crate) arguments: Vec<String>,
    #[serde(default)]
    pub(crate) wanted: Wanted,
}

/// A Python environment.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct EnvironmentPin {
    /// A folder, relative to the cache folder.
    pub(crate) place: PathBuf,
    pub(crate) why: String,
    /// Requirements file with versions and hashes; relative to the workspace.
    pub(crate) requirements: PathBuf,
    #[serde(default)]
    pub(crate) wanted: Wanted,
}

impl Wanted {
    /// Whether a set-up for `purpose` installs the item at `place`, which has this entry.
    pub(crate) fn now(self, purpose: Purpose, place: &Path) -> bool {
        match (purpose, self) {
            (Purpose::Only(only), _) => place == Path::new(only),
            (_, Self::Always)
            | (Purpose::Tests, Self::ForTests)
            | (Purpose::Benches, Self::ForBenches) => true,
            _ => false,
        }
    }
}

impl Pins {
    /// Reads the file; an unknown key is an error.
    pub(crate) fn load(path: &Path) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        toml::from_str(&text).with_context(|| format!("cannot use {}", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> Pins {
        Pins::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("setup.toml")).unwrap()
    }

    #[test]
    fn only_tests_need_vulkan_and_a_browser() {
        let pins = shipped();
        let wanted = |purpose| -> Vec<&str> {
            let needs =
                pins.system.iter().filter(|need| need.wanted.now(purpose, need.name.as_ref()));
            needs.map(|need| need.name.as_str()).collect()
        };
        for purpose in [Purpose::Use, Purpose::Benches] {
            assert_eq!(wanted(purpose), ["Python 3 with pip"], "{purpose:?}");
        }
        let of_tests = [
            "Python 3 with pip",
            "Vulkan loader",
            "Vulkan driver",
            "Chromium",
            "ffmpeg",
            "Mesa's EGL",
        ];
        assert_eq!(wanted(Purpose::Tests), of_tests);
    }

    #[test]
    fn scripts_and_lock_files_exist_and_have_hashes() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let pins = shipped();
        for script in pins.file.iter().filter_map(|file| file.script.as_ref()) {
            assert!(root.join(script).is_file(), "{}", script.display());
        }
        for requirements in pins.environment.iter().map(|environment| &environment.requirements) {
            let text = std::fs::read_to_string(root.join(requirements)).unwrap();
            assert!(text.contains("--hash=sha256:"), "{}", requirements.display());
        }
        for wheel in pins.file.iter().filter_map(|file| file.wheel.as_ref()) {
            assert!(wheel.contains(" --hash=sha256:"), "{wheel}");
        }
    }

    #[test]
    fn models_match_the_encoder_manifest() {
        let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("../assets/models.toml");
        let manifest: toml::Table =
            toml::from_str(&std::fs::read_to_string(manifest).unwrap()).unwrap();
        let text = |model: &toml::Value, key: &str| {
            model.get(key).and_then(toml::Value::as_str).map(str::to_owned)
        };
        let models = manifest["model"].as_array().unwrap().iter();
        let expected: Vec<_> = models
            .filter_map(|model| {
                Some((format!("models/{}", text(model, "file")?), vec![text(model, "sha256")?]))
            })
            .collect();
        let files = shipped().file.into_iter().filter(|file| file.place.starts_with("models"));
        let pinned: Vec<_> =
            files.map(|file| (file.place.display().to_string(), file.sha256)).collect();
        assert_eq!(pinned, expected);
    }
}
