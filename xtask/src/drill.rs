//! `drill`: runs the drills, each of which writes what it found as JSON, and puts that into `docs/reliability.md`.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use clap::Args;
use serde::Deserialize;

use crate::workspace::{Workspace, succeeds};

/// How a drill is run.
#[derive(Clone, Copy)]
enum DrillKind {
    /// By the program `drill-sim`.
    Simulation,
    /// By the program `drill-processes`.
    Processes,
}

/// The crate of the programs.
const PROGRAMS: &str = "memtransfer-tests";

/// All drills, in the order in which they run.
const DRILLS: &[(&str, DrillKind)] = &[
    ("sim", DrillKind::Simulation),
    ("grid", DrillKind::Processes),
    ("kills", DrillKind::Processes),
    ("disk", DrillKind::Processes),
    ("soak", DrillKind::Processes),
];

/// Further flags of a quick simulation, of some 20 seconds: `cargo test` has executed the first seeds.
const QUICK_SIMULATION: [&str; 4] = ["--first-seed", "8", "--seeds", "32"];

/// The page, and the lines in it between which the results stand.
const PAGE: &str = "docs/reliability.md";
const BEGIN: &str = "<!-- results: begin -->";
const END: &str = "<!-- results: end -->";

#[derive(Args, Default)]
pub(crate) struct DrillArguments {
    /// The drills to run [default: all]
    #[arg(value_parser = names())]
    drills: Vec<String>,
    /// A small part of each drill
    #[arg(long)]
    quick: bool,
    /// Write the results into docs/reliability.md, also those of drills that ran before
    #[arg(long)]
    write: bool,
    /// Run no drill: only `--write`
    #[arg(long, requires = "write")]
    only_write: bool,
    /// Further flags for the program of one drill, for example `-- --minutes 30`
    #[arg(last = true)]
    flags: Vec<String>,
}

impl DrillArguments {
    /// What CI runs.
    pub(crate) fn of_ci() -> Self {
        Self { quick: true, ..Self::default() }
    }
}

fn names() -> Vec<&'static str> {
    DRILLS.iter().map(|(name, _)| *name).collect()
}

/// What a drill found.
#[derive(Deserialize)]
struct DrillResults {
    title: String,
    command: String,
    text: String,
    faults: BTreeMap<String, u64>,
    figures: BTreeMap<String, f64>,
    violations: Vec<String>,
}

/// Runs the drills. Returns whether none found a violation.
pub(crate) fn run(arguments: &DrillArguments, workspace: &Workspace) -> anyhow::Result<bool> {
    let folder = results_folder(workspace)?;
    let mut passed = true;
    if !arguments.only_write {
        passed = run_drills(arguments, workspace, &folder)?;
    }
    if arguments.write {
        let page = workspace.root().join(PAGE);
        let text = fs::read_to_string(&page).with_context(|| page.display().to_string())?;
        let text = with_results(&text, &results(&folder)?)?;
        fs::write(&page, text).with_context(|| format!("cannot write {}", page.display()))?;
        eprintln!("wrote {PAGE}");
    }
    Ok(passed)
}

fn run_drills(
    arguments: &DrillArguments,
    workspace: &Workspace,
    folder: &Path,
) -> anyhow::Result<bool> {
    let chosen: Vec<_> = DRILLS
        .iter()
        .filter(|(name, _)| match &*arguments.drills {
            [] => true,
            names => names.iter().any(|chosen| chosen == name),
        })
        .collect();
    ensure!(
        arguments.flags.is_empty() || chosen.len() == 1,
        "flags after `--` are those of one drill: name it"
    );
    let mut failed = Vec::new();
    for (name, kind) in chosen {
        eprintln!("drill {name}");
        let json = folder.join(name).with_extension("json");
        if !workspace.build_programs(&[PROGRAMS])? {
            return Ok(false);
        }
        let (program, first, quick): (_, &[&str], &[&str]) = match kind {
            DrillKind::Simulation => ("drill-sim", &[], &QUICK_SIMULATION),
            DrillKind::Processes => ("drill-processes", &[*name], &["--quick"]),
        };
        let mut command = workspace.at_root(&workspace.program(program)?, first);
        command.args(if arguments.quick { quick } else { &[] });
        command.args(&arguments.flags).arg("--json").arg(json);
        if !succeeds(&mut command)? {
            failed.push(*name);
        }
    }
    match failed.is_empty() {
        true => eprintln!("drill: no violation"),
        false => eprintln!("drill: violations or errors in {}; they are above", failed.join(", ")),
    }
    Ok(failed.is_empty())
}

/// The folder of the drills' results, which exists afterwards.
fn results_folder(workspace: &Workspace) -> anyhow::Result<PathBuf> {
    let folder = workspace.target_folder()?.join("drill");
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    Ok(folder)
}

/// The results in `folder`, in the order of the drills.
fn results(folder: &Path) -> anyhow::Result<Vec<DrillResults>> {
    let mut all = Vec::new();
    for (name, _) in DRILLS {
        let path = folder.join(name).with_extension("json");
        match fs::read_to_string(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            text => {
                let results = text
                    .map_err(anyhow::Error::from)
                    .and_then(|text| serde_json::from_str(&text).map_err(anyhow::Error::from));
                all.push(results.with_context(|| path.display().to_string())?);
            }
        }
    }
    ensure!(!all.is_empty(), "no drill has run: `cargo xtask drill`");
    Ok(all)
}

/// The page with these results, each in place of the earlier one of its drill; those of other drills stay.
fn with_results(page: &str, results: &[DrillResults]) -> anyhow::Result<String> {
    let parts = page
        .split_once(BEGIN)
        .and_then(|(before, rest)| rest.split_once(END).map(|(old, after)| (before, old, after)));
    let (before, earlier, after) =
        parts.with_context(|| format!("{PAGE} has no lines {BEGIN} and {END}"))?;
    let earlier = earlier.split("\n### ").skip(1);
    let earlier = earlier.map(|section| format!("### {}\n\n", section.trim_end_matches('\n')));
    let mut sections: Vec<String> = earlier.collect();
    for result in results {
        let mut text = String::new();
        write_result(&mut text, result)?;
        let heading = format!("### {}\n", result.title);
        match sections.iter_mut().find(|section| section.starts_with(&heading)) {
            Some(section) => *section = text,
            None => sections.push(text),
        }
    }
    Ok(format!("{before}{BEGIN}\n\n{}{END}{after}", sections.concat()))
}

fn write_result(text: &mut String, result: &DrillResults) -> std::fmt::Result {
    let DrillResults { title, command, text: about, faults, figures, violations } = result;
    writeln!(text, "### {title}\n\n{about}\n\n    {command}\n")?;
    writeln!(text, "| figure | |\n|---|---:|")?;
    for (name, value) in figures {
        writeln!(text, "| {name} | {} |", number(*value))?;
    }
    if !faults.is_empty() {
        writeln!(text, "\n| fault | times |\n|---|---:|")?;
        for (class, count) in faults {
            writeln!(text, "| {class} | {} |", number(*count as f64))?;
        }
    }
    match violations.as_slice() {
        [] => writeln!(text, "\nViolations: none.\n"),
        violations => {
            writeln!(text, "\nViolations:\n")?;
            for violation in violations {
                writeln!(text, "- {}", violation.lines().next().unwrap_or_default())?;
            }
            writeln!(text)
        }
    }
}

/// A number with commas between thousands, and one decimal if it needs it.
fn number(value: f64) -> String {
    let text = if value.fract() == 0.0 { format!("{value:.0}") } else { format!("{value:.1}") };
    let (whole, rest) = text.split_once('.').map_or((&*text, None), |(a, b)| (a, Some(b)));
    let mut grouped = String::new();
    for (index, digit) in whole.chars().enumerate() {
        if index > 0 && (whole.len() - index).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    rest.map_or(grouped.clone(), |rest| format!("{grouped}.{rest}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_replace_those_between_the_marks() {
        let json = r#"{"title": "Kills", "command": "cargo xtask drill kills", "text": "Runs.",
            "faults": {"memory killed": 12}, "figures": {"runs": 3000, "minutes": 2.5}, "violations": []}"#;
        let results: DrillResults = serde_json::from_str(json).unwrap();
        let disk = "### Disk\n\nStays.\n\n";
        let page = format!("# Page\n{BEGIN}\n\n{disk}### Kills\n\nold\n\n{END}\nend\n");
        let page = with_results(&page, &[results]).unwrap();
        let expected = format!(
            "# Page\n{BEGIN}\n\n{disk}### Kills\n\nRuns.\n\n    cargo xtask drill kills\n\n| figure | |\n|---|---:|\n\
             | minutes | 2.5 |\n| runs | 3,000 |\n\n| fault | times |\n|---|---:|\n| memory killed | 12 |\n\n\
             Violations: none.\n\n{END}\nend\n"
        );
        assert_eq!(page, expected);
        assert!(with_results("no marks", &[]).is_err());
    }

    #[test]
    fn the_page_has_the_marks() {
        let page = include_str!("../../docs/reliability.md");
        assert!(with_results(page, &[]).unwrap() == page);
    }
}
