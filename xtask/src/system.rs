//! System packages: whether the machine already meets a [`SystemNeed`], and their installation by root.

use std::ffi::OsStr;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use serde::Deserialize;

use crate::pins::{Probe, SystemNeed};
use crate::python;

impl Probe {
    /// Where it was found, for display; `None` when it is missing.
    pub(crate) fn look(&self) -> Option<String> {
        match self {
            Self::PythonModule(module) => python::module_version(module),
            Self::Program(names) => find_program(names).map(|path| path.display().to_string()),
            Self::Library(name) => find_library(name).map(|path| path.display().to_string()),
            Self::VulkanManifests(folders) => {
                find_vulkan_driver(folders).map(|path| path.display().to_string())
            }
        }
    }
}

/// Installs the packages of all needs with apt-get, then looks for what they bring.
///
/// # Errors
/// When this process is not root (the message has the command line to run), the machine has no apt-get, or apt-get
/// fails.
pub(crate) fn install(needs: &[&SystemNeed]) -> anyhow::Result<()> {
    let mut packages: Vec<&str> =
        needs.iter().flat_map(|need| &need.packages).map(String::as_str).collect();
    packages.sort_unstable();
    packages.dedup();
    if !std::fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0) {
        bail!(
            "system packages are missing. On Debian or Ubuntu run this line, elsewhere install the same packages \
             with the system's package manager; then run the same command again:\n\n    \
             sudo apt-get update && sudo apt-get install --yes --no-install-recommends {}\n",
            packages.join(" ")
        );
    }
    apt_get(&["update"])?;
    apt_get(&[&["install", "--yes", "--no-install-recommends"], &*packages].concat())?;
    for need in needs {
        if need.probe.look().is_none() {
            bail!(
                "{} is still not found after its packages were installed: {}",
                need.name,
                need.packages.join(" ")
            );
        }
    }
    Ok(())
}

fn apt_get(arguments: &[&str]) -> anyhow::Result<()> {
    let line = format!("apt-get {}", arguments.join(" "));
    eprintln!("set-up: {line}");
    let status = Command::new("apt-get")
        .args(["--quiet=2", "--option", "DPkg::Lock::Timeout=120"])
        .args(arguments)
        .env("DEBIAN_FRONTEND", "noninteractive")
        .stdin(Stdio::null())
        // stdout carries data; set-up has none.
        .stdout(std::io::stderr())
        .status()
        .with_context(|| format!("cannot start {line}"))?;
    if !status.success() {
        bail!("{line} failed ({status}); its messages are above. Is there a network?");
    }
    Ok(())
}

fn find_program(names: &[String]) -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&path)
        .flat_map(|folder| names.iter().map(move |name| folder.join(name)))
        .find(|program| program.is_file())
}

/// Where the dynamic linker would find a library: its environment variable first, then the folders of Debian, Fedora and
/// Arch.
fn find_library(name: &str) -> Option<PathBuf> {
    let arch = std::env::consts::ARCH;
    let listed = std::env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
    let usual = [
        format!("/usr/lib/{arch}-linux-gnu"),
        format!("/lib/{arch}-linux-gnu"),
        "/usr/lib64".to_owned(),
        "/usr/lib".to_owned(),
        "/usr/local/lib".to_owned(),
    ];
    std::env::split_paths(&listed)
        .chain(usual.into_iter().map(PathBuf::from))
        .map(|folder| folder.join(name))
        .find(|path| path.is_file())
}

/// The first driver manifest whose library exists. Like the Vulkan loader, reads `VK_DRIVER_FILES` or the older
/// `VK_ICD_FILENAMES` instead of the folders when one of them is set.
fn find_vulkan_driver(folders: &[PathBuf]) -> Option<PathBuf> {
    let chosen = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].into_iter().find_map(std::env::var_os);
    let mut manifests = match chosen {
        Some(list) => std::env::split_paths(&list).collect(),
        None => folders.iter().flat_map(|folder| json_files(folder)).collect::<Vec<_>>(),
    };
    // lavapipe first, then by name, so that the output does not depend on directory order.
    manifests.sort_by_key(|path| (!path.to_string_lossy().contains("lvp"), path.clone()));
    manifests.into_iter().find(|path| driver_library(path).is_some())
}

fn json_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| entry.path())
        .filter(|path| path.extension() == Some(OsStr::new("json")))
        .collect()
}

/// The library that a manifest names, if it exists: a bare name is looked up, a path is relative to the manifest.
fn driver_library(manifest: &Path) -> Option<PathBuf> {
    #[derive(Deserialize)]
    struct LibraryManifest {
        #[serde(rename = "ICD")]
        icd: Icd,
    }
    #[derive(Deserialize)]
    struct Icd {
        library_path: String,
    }
    let text = std::fs::read_to_string(manifest).ok()?;
    let LibraryManifest { icd: Icd { library_path } } = serde_json::from_str(&text).ok()?;
    if library_path.contains('/') {
        Some(manifest.parent()?.join(library_path)).filter(|path| path.is_file())
    } else {
        find_library(&library_path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_driver_counts_only_if_its_library_exists() {
        let folder = tempfile::tempdir().unwrap();
        let manifest = folder.path().join("x_icd.json");
        let check = |library: &str, expected: bool| {
            let text =
                format!(r#"{{"ICD": {{"library_path": "{library}", "api_version": "1.3"}}}}"#);
            std::fs::write(&manifest, text).unwrap();
            assert_eq!(driver_library(&manifest).is_some(), expected, "{library}");
        };
        std::fs::write(folder.path().join("libx.so"), "").unwrap();
        check("./libx.so", true);
        check(folder.path().join("libx.so").to_str().unwrap(), true);
        check("./liby.so", false);
        check("libno-such-driver.so", false);
        std::fs::write(&manifest, "not json").unwrap();
        assert_eq!(driver_library(&manifest), None);
    }

    #[test]
    fn a_missing_folder_of_manifests_holds_no_driver() {
        assert_eq!(json_files(Path::new("/no/such/folder")), Vec::<PathBuf>::new());
    }
}
