//! `drill`: runs the drills, each of which writes what it found as JSON into `target/drill`.

use std::fs;

use anyhow::{Context, ensure};
use clap::Args;

use crate::workspace::{Workspace, succeeds};

/// The crate of the programs.
const PROGRAMS: &str = "memtransfer-tests";

/// A kind of drill.
struct Drill {
    name: &'static str,
    /// The program, and its first arguments.
    program: (&'static str, &'static [&'static str]),
    /// Further arguments of a quick drill.
    quick: &'static [&'static str],
}

/// All drills, in the order in which they run. `cargo test` has executed the first seeds of `sim`.
const DRILLS: [Drill; 5] = [
    Drill {
        name: "sim",
        program: ("drill-sim", &[]),
        quick: &["--first-seed", "8", "--seeds", "32"],
    },
    Drill { name: "grid", program: ("drill-processes", &["grid"]), quick: &["--quick"] },
    Drill { name: "kills", program: ("drill-processes", &["kills"]), quick: &["--quick"] },
    Drill { name: "disk", program: ("drill-processes", &["disk"]), quick: &["--quick"] },
    Drill { name: "soak", program: ("drill-processes", &["soak"]), quick: &["--quick"] },
];

#[derive(Args, Default)]
pub(crate) struct DrillArguments {
    /// The drills to run [default: all]
    #[arg(value_parser = clap::builder::PossibleValuesParser::new(DRILLS.map(|drill| drill.name)))]
    drills: Vec<String>,
    /// A small part of each drill
    #[arg(long)]
    quick: bool,
    /// Further flags for the program of one drill, for example `-- --minutes 30`
    #[arg(last = true)]
    flags: Vec<String>,
}

impl DrillArguments {
    /// What CI runs.
    pub(crate) fn of_ci() -> Self {
        Self { quick: true, ..Self::default() }
    }

    fn chooses(&self, drill: &Drill) -> bool {
        self.drills.is_empty() || self.drills.iter().any(|name| name == drill.name)
    }
}

/// Runs the drills. Returns whether none found a violation.
pub(crate) fn run(arguments: &DrillArguments, workspace: &Workspace) -> anyhow::Result<bool> {
    let folder = workspace.target_folder()?.join("drill");
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let chosen: Vec<&Drill> = DRILLS.iter().filter(|drill| arguments.chooses(drill)).collect();
    ensure!(
        arguments.flags.is_empty() || chosen.len() == 1,
        "flags after `--` are those of one drill: name it"
    );
    let mut failed = Vec::new();
    for Drill { name, program: (program, first), quick } in chosen {
        eprintln!("drill {name}");
        let json = folder.join(name).with_extension("json");
        if !workspace.build_programs(&[PROGRAMS])? {
            return Ok(false);
        }
        let mut command = workspace.at_root(&workspace.program(program)?, first);
        command.args(if arguments.quick { *quick } else { &[] });
        command.args(&arguments.flags).arg("--json").arg(json);
        if !succeeds(&mut command)? {
            failed.push(*name);
        }
    }
    match failed.is_empty() {
        true => eprintln!("drill: no violation; what was found is in {}", folder.display()),
        false => eprintln!("drill: violations or errors in {}; they are above", failed.join(", ")),
    }
    Ok(failed.is_empty())
}
