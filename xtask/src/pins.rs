//! `setup.toml` as typed values: everything that set-up may install.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use serde::Deserialize;

use crate::sha256::Sum;

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
    /// What needs the item of this name, and nothing else.
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

/// A file in the cache folder, made by a script.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FilePin {
    pub(crate) name: String,
    pub(crate) why: String,
    /// Relative to the cache folder.
    pub(crate) place: PathBuf,
    /// Relative to the workspace; called as `python3 SCRIPT [WHEEL] [FROM] OUTPUT ARGUMENTS...`.
    pub(crate) script: PathBuf,
    /// An earlier file of the list that it is made from, relative to the cache folder.
    pub(crate) from: Option<PathBuf>,
    #[serde(default)]
    pub(crate) arguments: Vec<String>,
    #[serde(default)]
    pub(crate) wanted: Wanted,
    /// By platform (`linux-x86_64`), or `any`.
    pub(crate) platform: BTreeMap<String, PlatformPin>,
}

/// A [`FilePin`] on one platform.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PlatformPin {
    /// Hash of the finished file.
    pub(crate) sha256: Sum,
    /// The wheel it is made from; absent when the script needs none.
    pub(crate) wheel: Option<WheelPin>,
}

/// One particular wheel.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct WheelPin {
    /// `name==version`, as pip reads it.
    pub(crate) package: String,
    /// The wheel's file name.
    pub(crate) file: String,
    pub(crate) sha256: Sum,
    /// Flags with which pip selects this wheel on any Python version.
    #[serde(default)]
    pub(crate) pip: Vec<String>,
}

/// A Python environment, created by a script.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct EnvironmentPin {
    pub(crate) name: String,
    pub(crate) why: String,
    /// A folder, relative to the cache folder.
    pub(crate) place: PathBuf,
    /// Relative to the workspace; called as `python3 SCRIPT OUTPUT REQUIREMENTS WHEELS`.
    pub(crate) script: PathBuf,
    /// Requirements file with versions and hashes; relative to the workspace.
    pub(crate) requirements: PathBuf,
    #[serde(default)]
    pub(crate) wanted: Wanted,
}

impl Wanted {
    /// Whether a set-up for `purpose` installs the item `name`, which has this entry.
    pub(crate) fn now(self, purpose: Purpose, name: &str) -> bool {
        if let Purpose::Only(only) = purpose {
            return name == only;
        }
        match self {
            Self::Always => true,
            Self::ForTests => purpose == Purpose::Tests,
            Self::ForBenches => purpose == Purpose::Benches,
            Self::OnDemand => false,
        }
    }
}

impl Pins {
    /// The environment of this name.
    pub(crate) fn environment(&self, name: &str) -> anyhow::Result<&EnvironmentPin> {
        self.environment
            .iter()
            .find(|environment| environment.name == name)
            .with_context(|| format!("xtask/setup.toml has no environment {name:?}"))
    }

    /// Reads the file; an unknown key is an error.
    pub(crate) fn load(path: &Path) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        toml::from_str(&text).with_context(|| format!("cannot use {}", path.display()))
    }
}

impl FilePin {
    /// The pin for this machine.
    pub(crate) fn here(&self) -> anyhow::Result<&PlatformPin> {
        self.on(&format!("{}-{}", std::env::consts::OS, std::env::consts::ARCH))
    }

    fn on(&self, platform: &str) -> anyhow::Result<&PlatformPin> {
        match self.platform.get("any").or_else(|| self.platform.get(platform)) {
            Some(pin) => Ok(pin),
            None => bail!(
                "{} is not pinned for {platform} (only for {}); add [file.platform.{platform}] to \
                 xtask/setup.toml, whose head says how",
                self.name,
                self.platform.keys().map(String::as_str).collect::<Vec<_>>().join(", "),
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shipped() -> Pins {
        Pins::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("setup.toml")).unwrap()
    }

    #[test]
    fn every_shipped_file_is_pinned_for_linux() {
        for file in shipped().file {
            assert!(file.on("linux-x86_64").is_ok(), "{}", file.name);
        }
    }

    #[test]
    fn the_error_for_an_unpinned_platform_names_how_to_add_a_pin() {
        let pins = shipped();
        let runtime = pins.file.iter().find(|file| file.name.starts_with("ONNX Runtime")).unwrap();
        let Err(error) = runtime.on("plan9-mips") else { panic!("there is no such wheel") };
        let message = error.to_string();
        assert!(
            message.contains("plan9-mips") && message.contains("xtask/setup.toml"),
            "{message}"
        );
    }

    #[test]
    fn only_tests_need_vulkan_and_a_browser() {
        let pins = shipped();
        let wanted = |purpose| -> Vec<&str> {
            let needs = pins.system.iter().filter(|need| need.wanted.now(purpose, &need.name));
            needs.map(|need| need.name.as_str()).collect()
        };
        for purpose in [Purpose::Use, Purpose::Benches] {
            assert_eq!(wanted(purpose), ["Python 3 with pip"], "{purpose:?}");
        }
        let of_tests =
            ["Python 3 with pip", "Vulkan loader", "Vulkan driver", "Chromium", "ffmpeg"];
        assert_eq!(wanted(Purpose::Tests), of_tests);
        assert_eq!(wanted(Purpose::Only("Chromium")), ["Chromium"]);
    }

    #[test]
    fn scripts_of_the_list_exist() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        let pins = shipped();
        let of_files = pins.file.iter().map(|file| &file.script);
        let of_environments = pins.environment.iter().flat_map(|it| [&it.script, &it.requirements]);
        for script in of_files.chain(of_environments) {
            assert!(root.join(script).is_file(), "{}", script.display());
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
        let expected: Vec<_> = manifest["model"]
            .as_array()
            .unwrap()
            .iter()
            .filter_map(|model| {
                Some((format!("models/{}", text(model, "file")?), text(model, "sha256").unwrap()))
            })
            .collect();
        let pinned: Vec<_> = shipped()
            .file
            .iter()
            .filter(|file| file.place.starts_with("models"))
            .map(|file| {
                (
                    file.place.display().to_string(),
                    file.on("linux-x86_64").unwrap().sha256.to_string(),
                )
            })
            .collect();
        assert_eq!(pinned, expected);
    }

    #[test]
    fn an_unknown_key_is_refused() {
        let result = toml::from_str::<Pins>(
            "[[system]]\nname = 'x'\nwhy = 'y'\nprobe = { library = 'z' }\npackage = []",
        );
        assert!(result.is_err());
    }
}
