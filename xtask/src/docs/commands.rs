//! Commands for cargo in the documents: each names a package of the workspace, and an example that the package has.

use serde::Deserialize;

use super::links::{Documents, Fault};

/// Where commands are of the past.
const HISTORY: &str = "CHANGELOG.md";

/// A package of the workspace, as `cargo metadata` has it.
#[derive(Deserialize)]
pub(super) struct Package {
    name: String,
    targets: Vec<Target>,
}

/// Something that cargo builds of a package.
#[derive(Deserialize)]
struct Target {
    name: String,
    kind: Vec<String>,
}

/// Every command that cargo would refuse. A name in capitals stands for any.
pub(super) fn refused(documents: &Documents, packages: &[Package]) -> Vec<Fault> {
    let mut faults = Vec::new();
    for (path, page) in documents.pages().filter(|(path, _)| !path.ends_with(HISTORY)) {
        for (at, line) in page.text.lines().enumerate() {
            if let Some(message) = refusal(line, packages) {
                faults.push(Fault { path: path.to_owned(), line: at + 1, message });
            }
        }
    }
    faults
}

/// Why cargo would refuse the command in this line; `None` if there is none or it is right.
fn refusal(line: &str, packages: &[Package]) -> Option<String> {
    let (_, arguments) = line.split_once("cargo ")?;
    let is_between = |c: char| c.is_whitespace() || matches!(c, '`' | ',' | ';' | '(' | ')');
    let words: Vec<&str> = arguments.split(is_between).filter(|word| !word.is_empty()).collect();
    let value_of = |flags: &[&str]| {
        let found = words.windows(2).find(|pair| flags.contains(&pair[0]));
        found.map(|pair| pair[1]).filter(|value| value.chars().any(char::is_lowercase))
    };
    let name = value_of(&["-p", "--package"])?;
    let Some(package) = packages.iter().find(|package| package.name == name) else {
        return Some(format!("cargo has no package {name}"));
    };
    let example = value_of(&["--example"])?;
    let is_there = package
        .targets
        .iter()
        .any(|target| target.name == example && target.kind.iter().any(|kind| kind == "example"));
    (!is_there).then(|| format!("package {name} has no example {example}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_and_examples_that_are_not_there_are_named() {
        let target = Target { name: "intervals".to_owned(), kind: vec!["example".to_owned()] };
        let packages = [Package { name: "scores".to_owned(), targets: vec![target] }];
        let check = |line: &str, expected: Option<&str>| {
            assert_eq!(refusal(line, &packages).as_deref(), expected, "{line}");
        };
        check("    cargo run --release -p scores --example intervals", None);
        check("(`cargo test -p scores`), or `cargo test -p CRATE`", None);
        check("mkdir -p folder, then cargo build", None);
        check("(`cargo run -p results --example x`)", Some("cargo has no package results"));
        check(
            "cargo run --package scores --example other -- 1",
            Some("package scores has no example other"),
        );
    }
}
