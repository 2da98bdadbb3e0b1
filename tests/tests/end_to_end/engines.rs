//! The script of `memtransfer plan` for Slurm does what it says.

use std::fs;
use std::process::Command;

use memtransfer_tests::{Bench, Ended, program, sorted_log, words};

/// Twenty episodes.
const RUN: &str =
    "--policy random --limit 10 --starts original,new --max-steps 5 --frame-size 64 --seed 3";

#[test]
fn the_slurm_script_executes_all_units_and_merges_them() {
    let bench = Bench::new();
    bench.run(&words(&format!("run --out whole {RUN}"))).expect(0);
    let plan = format!("plan --out plan.json --slurm {RUN} --unit-episodes 4 --workers 2");
    let text = bench.run(&words(&plan)).expect(0).stdout;
    fs::write(bench.out("script"), &text).unwrap();
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
