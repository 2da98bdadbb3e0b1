//! The scripts of `memtransfer plan` for engines do what they say.

use std::fs;
use std::process::Command;

use memtransfer_tests::{Bench, Ended, needs, program, sorted_log, words};

/// Twenty episodes.
const RUN: &str =
    "--policy random --limit 10 --starts original,new --max-steps 5 --frame-size 64 --seed 3";

/// The script for an engine that executes them in five units by two workers.
fn script(bench: &Bench, engine: &str) -> String {
    let plan = format!("plan --out plan.json {engine} {RUN} --unit-episodes 4 --workers 2");
    let text = bench.run(&words(&plan)).expect(0).stdout;
    fs::write(bench.out("script"), &text).unwrap();
    text
}

#[test]
fn the_slurm_script_executes_all_units_and_merges_them() {
    let bench = Bench::new();
    bench.run(&words(&format!("run --out whole {RUN}"))).expect(0);
    let text = script(&bench, "--slurm");
    assert!(text.contains("#SBATCH --array=0-1\n"), "{text}");
    let programs = program("memtransfer");
    let path =
        format!("{}:{}", programs.parent().unwrap().display(), std::env::var("PATH").unwrap());
    // As Slurm starts it: once for each index of the array, and for the second job.
    let bash = |args: &[&str], index: &str| {
        let mut command = Command::new("bash");
        command.args(args).current_dir(bench.folder.path()).env("PATH", &path);
        command.env("MEMTRANSFER_RUN_DIR", bench.registry.path());
        command.env("SLURM_ARRAY_TASK_ID", index).env("SLURM_ARRAY_TASK_COUNT", "2");
        Ended::run(&mut command)
    };
    bash(&["-n", "script"], "0").expect(0);
    let missing = bash(&["script", "merge"], "0").expect(3);
    assert_eq!(missing.stdout, "0\n1\n2\n3\n4\n");
    for index in ["1", "0", "0"] {
        bash(&["script"], index).expect(0);
    }
    bash(&["script", "merge"], "0").expect(0);
    assert_eq!(sorted_log(&bench.out("merged")), sorted_log(&bench.out("whole")));
}

#[test]
fn the_kubernetes_manifest_fits_the_schema() {
    let bench = Bench::new();
    let text = script(&bench, "--kubernetes");
    assert!(text.contains("completions: 2\n"), "{text}");
    // Its schemas are part of the package.
    let code = "import sys, yaml, kubernetes_validate\n\
                manifest = yaml.safe_load(open(sys.argv[1]))\n\
                kubernetes_validate.validate(manifest, '1.33', strict=True)\n\
                print(manifest['spec']['template']['spec']['containers'][0]['command'][2])\n";
    let mut command = Command::new(needs::ray_python());
    let ended = Ended::run(command.args(["-c", code]).arg(bench.out("script"))).expect(0);
    let status = Command::new("bash").args(["-n", "-c", &ended.stdout]).status().unwrap();
    assert!(status.success(), "{}", ended.stdout);
}
