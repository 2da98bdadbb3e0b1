//! The Python package: its own tests, its types, its installation.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use memtransfer_tests::{Bench, Ended, needs};

fn package() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../python").canonicalize().unwrap()
}

/// Runs the tests' Python in the package's folder.
fn python(args: &[&str], variables: &[(&str, &str)]) -> Ended {
    let mut command = Command::new(needs::python());
    command
        .args(args)
        .current_dir(package())
        .envs(variables.iter().copied())
        // Leave no bytecode in the tree.
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    Ended::of(command.spawn().unwrap())
}

#[test]
fn the_package_passes_its_own_tests() {
    let _bench = Bench::new();
    python(&["-m", "pytest"], &[]).expect(0);
}

#[test]
fn the_package_is_typed() {
    let bench = Bench::new();
    let cache = bench.out("mypy");
    let cache = cache.to_str().unwrap();
    python(&["-m", "mypy", "--cache-dir", cache, "memtransfer"], &[]).expect(0);
}

/// As `pip install ./python` does it, but with what is on this machine.
#[test]
fn the_package_can_be_installed_from_the_checkout() {
    let bench = Bench::new();
    let place = bench.out("installed");
    let mut args = vec!["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
    args.extend(["--no-index", "--no-deps", "--no-build-isolation", "--no-compile", "--target"]);
    args.extend([place.to_str().unwrap(), "."]);
    python(&args, &[]).expect(0);
    assert!(place.join("memtransfer/py.typed").is_file());
    let look = "import memtransfer, pathlib; print(pathlib.Path(memtransfer.__file__).parent)";
    let ended = python(&["-P", "-c", look], &[("PYTHONPATH", place.to_str().unwrap())]).expect(0);
    assert_eq!(ended.stdout.trim(), place.join("memtransfer").to_str().unwrap());
}
