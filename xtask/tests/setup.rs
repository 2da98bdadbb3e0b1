//! `cargo xtask setup` with scripted replacements of pip, uv and apt-get in front of the real ones. No network.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::process::{Command, Output};

use tempfile::TempDir;

/// SHA-256 of "made of: the wheel\n".
const MADE_SUM: &str = "c282999a28b35bda2a92e70dd93c8bebf67f5971d5182e19b9c4adbb16aa1b47";

/// A machine in a temporary folder: programs, a cache, a list of what to install, and a log of what was called.
struct Machine {
    folder: TempDir,
}

impl Machine {
    /// An empty cache, a list with a library, a file and, for tests, an environment; pip and uv work.
    fn new() -> Self {
        let machine = Self { folder: tempfile::tempdir().unwrap() };
        for name in ["bin", "lib"] {
            fs::create_dir(machine.path(name)).unwrap();
        }
        machine.write("make.sh", "printf 'made of: ' > \"$2\"; cat \"$1\" >> \"$2\"");
        machine.write("requirements.txt", "one==1\n");
        machine.write("kind", "cpython-311\n");
        machine.list(MADE_SUM);
        machine.program(
            "python3",
            r#"
            if [ "$1" = -B ]; then shift; exec sh "$@"; fi
            if [ "$1" = -c ]; then exec cat "${LOG%/*}/kind"; fi
            while [ "$1" != --target ]; do shift; done
            echo pip >> "$LOG"; mkdir -p "$2/bin"; cp "${LOG%/*}/bin/uv" "$2/bin/uv"
            "#,
        );
        machine.uv("echo 'the wheel' > \"$target/thing.bin\"");
        machine
    }

    /// The same with the library.
    fn with_library() -> Self {
        let machine = Self::new();
        machine.write("lib/libthing-of-a-test.so", "");
        machine
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn read(&self, name: &str) -> String {
        fs::read_to_string(self.path(name)).unwrap_or_default()
    }

    fn write(&self, name: &str, content: &str) {
        fs::write(self.path(name), content).unwrap();
    }

    fn list(&self, made_sum: &str) {
        let folder = self.folder.path().display();
        let text = format!(
            r#"
            [[system]]
            name = "Thing library"
            why = "a test"
            probe = {{ library = "libthing-of-a-test.so" }}
            packages = ["libthing"]

            [[file]]
            place = "things/thing.bin"
            why = "a test"
            sha256 = ["{made_sum}"]
            wheel = "thing==1.0 --hash=sha256:00"
            source = "thing.bin"
            script = "{folder}/make.sh"

            [[environment]]
            place = "packages"
            why = "a test"
            requirements = "{folder}/requirements.txt"
            wanted = "for-tests"
            "#
        );
        self.write("setup.toml", &text);
    }

    /// A `uv` that makes environments, and does `install` in the shell for the wheel, with `$target` set.
    fn uv(&self, install: &str) {
        let body = format!(
            r#"
            shift 2
            for last in "$@"; do :; done
            case "$1 $2" in
            venv*) mkdir -p "$last/bin"; touch "$last/bin/python";;
            "pip sync") echo "sync $(cat "$last")" >> "$LOG";;
            "pip install")
                echo "install $(cat "$last")" >> "$LOG"
                while [ "$1" != --target ]; do shift; done
                target=$2; mkdir -p "$target"
                {install};;
            esac
            "#
        );
        self.program("uv", &body);
    }

    /// An `apt-get` that installs by doing `install` in the shell.
    fn apt_get(&self, install: &str) {
        let body =
            format!("echo \"apt-get $*\" >> \"$LOG\"\ncase \"$*\" in *install*) {install};; esac");
        self.program("apt-get", &body);
    }

    fn program(&self, name: &str, body: &str) {
        let path = self.path("bin").join(name);
        // By another process: what this one has open for writing is open for a moment in every process that another test starts, and
        // cannot be executed meanwhile.
        let mut shell = Command::new("/bin/sh");
        shell.args(["-c", "printf '%s' \"$1\" > \"$0\" && chmod 755 \"$0\""]);
        shell.arg(path).arg(format!("#!/bin/sh\n{body}\n"));
        assert!(shell.status().unwrap().success());
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
        let messages = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(status), "{messages}");
        assert_eq!(String::from_utf8(output.stdout).unwrap(), "", "stdout is for data");
        messages
    }

    fn has(&self, place: &str) -> bool {
        self.path("cache").join(place).exists()
    }
}

#[test]
fn what_is_missing_is_installed_once() {
    let machine = Machine::with_library();
    let messages = machine.expect(0);
    assert!(messages.contains("missing  things/thing.bin"), "{messages}");
    assert_eq!(machine.read("cache/things/thing.bin"), "made of: the wheel\n");
    assert!(!machine.has("packages"), "only for tests");
    assert!(!machine.has("tmp"), "nothing unfinished is left");
    let messages = machine.expect(0);
    assert!(messages.contains("there    things/thing.bin"), "{messages}");
    assert!(messages.contains("nothing to do"), "{messages}");

    let messages = machine.expect_for_tests(0);
    assert!(messages.contains("missing  packages"), "{messages}");
    assert!(machine.expect_for_tests(0).contains("nothing to do"));
    let expected = "pip\ninstall thing==1.0 --hash=sha256:00\nsync one==1\n";
    assert_eq!(machine.read("log"), expected);
}

#[test]
fn a_file_that_is_not_the_pinned_one_is_replaced() {
    let machine = Machine::with_library();
    machine.expect(0);
    machine.write("cache/things/thing.bin", "made of: something else\n");
    let messages = machine.expect(0);
    assert!(messages.contains("changed  things/thing.bin"), "{messages}");
    assert_eq!(machine.read("cache/things/thing.bin"), "made of: the wheel\n");
}

#[test]
fn a_made_file_with_another_sum_is_refused() {
    let machine = Machine::with_library();
    machine.list(&"0".repeat(64));
    let messages = machine.expect(2);
    assert!(messages.contains("nothing was put into place"), "{messages}");
    assert!(!machine.has("things"));
}

#[test]
fn an_interrupted_installation_leaves_nothing_that_counts() {
    let machine = Machine::with_library();
    machine.uv("echo 'the wh' > \"$target/thing.bin\"; kill -9 $PPID; exit 1");
    assert!(!machine.setup(&[]).status.success());
    assert!(!machine.has("things"));

    fs::remove_dir_all(machine.path("cache/uv")).unwrap();
    machine.uv("echo 'the wheel' > \"$target/thing.bin\"");
    machine.expect(0);
    assert!(machine.has("things/thing.bin") && !machine.has("tmp"));
}

#[test]
fn without_a_network_set_up_says_what_to_provide() {
    let machine = Machine::with_library();
    machine.uv("echo 'no network' >&2; exit 1");
    let messages = machine.expect(2);
    for part in ["no network", "thing==1.0", "PIP_FIND_LINKS"] {
        assert!(messages.contains(part), "no {part:?} in: {messages}");
    }
}

#[test]
fn an_environment_is_made_again_if_its_list_or_python_changed() {
    let machine = Machine::with_library();
    machine.expect_for_tests(0);
    machine.write("requirements.txt", "one==2\n");
    assert!(machine.expect_for_tests(0).contains("changed  packages"));
    assert!(machine.read("log").ends_with("sync one==2\n"));
    machine.write("kind", "cpython-312\n");
    assert!(machine.expect_for_tests(0).contains("changed  packages"));
    fs::remove_file(machine.path("cache/packages/bin/python")).unwrap();
    assert!(machine.expect_for_tests(0).contains("changed  packages"));
    assert!(machine.expect_for_tests(0).contains("nothing to do"));
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
    let machine = Machine::new();
    machine.apt_get(&format!("touch {}", machine.path("lib/libthing-of-a-test.so").display()));
    let messages = machine.expect(0);
    assert!(messages.contains("missing  Thing library"), "{messages}");
    let log = machine.read("log");
    assert!(log.contains("install --yes --no-install-recommends libthing\n"), "{log}");
    assert!(machine.expect(0).contains("nothing to do"));
}

#[test]
fn packages_that_cannot_be_installed_are_an_error_before_anything_is_downloaded() {
    let machine = Machine::new();
    machine.apt_get("exit 100");
    let messages = machine.expect(2);
    // Root's apt-get fails; other users get the line to run.
    let line = "apt-get install --yes --no-install-recommends libthing";
    assert!(messages.contains(line), "{messages}");
    assert!(!machine.has("uv") && !machine.has("things"));
}

#[test]
fn a_library_still_missing_after_installation_is_an_error() {
    if !is_root() {
        return;
    }
    let machine = Machine::new();
    machine.apt_get(":");
    let messages = machine.expect(2);
    assert!(messages.contains("still not found"), "{messages}");
}

#[test]
fn a_broken_list_is_named() {
    let machine = Machine::new();
    machine.write("setup.toml", "[[file]]\nname = 'x'\n");
    let messages = machine.expect(2);
    assert!(messages.contains("setup.toml") && messages.contains("unknown field"), "{messages}");
}
