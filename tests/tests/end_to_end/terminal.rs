//! What the program prints to a terminal.

use std::process::Command;

use memtransfer_tests::{Bench, Ended, needs, program};

/// Starts a command in a pseudo-terminal, and prints what it prints there.
const IN_TERMINAL: &str = "import os, pty, sys\n\
                           sys.exit(os.waitstatus_to_exitcode(pty.spawn(sys.argv[1:])))";

/// What a short run prints to a terminal, with these variables.
fn printed(variables: &[(&str, &str)]) -> String {
    let bench = Bench::new();
    let mut command = Command::new(needs::python());
    command.args(["-c", IN_TERMINAL]).arg(program("memtransfer"));
    command.args(["run", "--limit", "1", "--memory", "working", "--frame-size", "64"]);
    command.args(["--policy", "random", "--max-steps", "5", "--out", "run"]);
    command.current_dir(bench.folder.path()).env("MEMTRANSFER_RUN_DIR", bench.registry.path());
    for variable in ["NO_COLOR", "RUST_LOG"] {
        command.env_remove(variable);
    }
    command.envs(variables.iter().copied());
    Ended::run(&mut command).expect(0).stdout
}

#[test]
fn a_terminal_without_a_cursor_gets_lines_of_progress() {
    const ERASED: &str = "\r\x1b[2K";
    let bar = printed(&[("TERM", "xterm")]);
    assert!(bar.contains(ERASED), "{bar:?}");
    let lines = printed(&[("TERM", "dumb"), ("RUST_LOG", "debug")]);
    assert!(!lines.contains('\x1b'), "{lines:?}");
    assert!(lines.contains("starting the processes\r\n"), "{lines:?}");
    assert!(lines.contains(" DEBUG "), "{lines:?}");
}

#[test]
fn log_lines_have_colours_unless_no_color_is_set() {
    const COLOUR: &str = "\x1b[2m";
    let logged =
        |no_color| printed(&[("TERM", "xterm"), ("RUST_LOG", "debug"), ("NO_COLOR", no_color)]);
    // An empty variable counts as not set.
    let coloured = logged("");
    assert!(coloured.contains(COLOUR), "{coloured:?}");
    let plain = logged("1");
    assert!(plain.contains(" DEBUG ") && !plain.contains(COLOUR), "{plain:?}");
    let sequences = plain.matches('\x1b').count();
    assert_eq!(sequences, plain.matches("\r\x1b[2K").count(), "{plain:?}");
}
