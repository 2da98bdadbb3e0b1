//! That packages which are built alone share their dependencies with the programs: with other features these would be
//! built twice.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, bail};

use crate::workspace::{PROGRAMS, Workspace};

/// Packages that are built without the programs: this one, the wheel's extension, and what every crate's tests link.
const ALONE: [&str; 3] = ["xtask", "memtransfer-python", "same-features"];

/// Compares the features of dependencies and prints where they differ.
pub(crate) fn check(workspace: &Workspace) -> anyhow::Result<bool> {
    let programs = Features::of(&PROGRAMS, workspace)?;
    let mut differences = 0;
    for package in ALONE {
        for difference in Features::of(&[package], workspace)?.differences(&programs) {
            eprintln!("{package}: {difference}");
            differences += 1;
        }
    }
    if differences > 0 {
        eprintln!("name the features in crates/same-features/Cargo.toml");
    }
    Ok(differences == 0)
}

/// The features of each dependency, by name and version.
#[derive(Default)]
struct Features {
    /// Of what is linked.
    linked: BTreeMap<String, String>,
    /// Of that, and of what build scripts and macros use, which may be the same package with others.
    all: BTreeMap<String, BTreeSet<String>>,
}

impl Features {
    /// Those of `packages` when they are built together.
    fn of(packages: &[&str], workspace: &Workspace) -> anyhow::Result<Self> {
        let tree = |edges: &str| {
            let mut command = workspace.cargo(&["tree", "--prefix", "none"]);
            command.args(["--format", "{p} [{f}]", "--edges", edges]);
            for package in packages {
                command.args(["--package", package]);
            }
            let output = command.output().context("cannot start cargo tree")?;
            if !output.status.success() {
                bail!("cargo tree failed: {}", String::from_utf8_lossy(&output.stderr));
            }
            Ok(String::from_utf8_lossy(&output.stdout).into_owned())
        };
        let linked = dependencies(&tree("normal,no-proc-macro")?).collect();
        let mut all: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (name, features) in dependencies(&tree("normal,build")?) {
            all.entry(name).or_default().insert(features);
        }
        Ok(Self { linked, all })
    }

    /// Dependencies that these packages build with other features than `programs`.
    fn differences(&self, programs: &Self) -> Vec<String> {
        let linked = self.linked.iter().filter_map(|(name, features)| {
            let theirs = programs.linked.get(name)?;
            (features != theirs)
                .then(|| format!("{name} has the features {features}, in the programs {theirs}"))
        });
        let others = self.all.iter().filter_map(|(name, features)| {
            let theirs = programs.all.get(name)?;
            (!features.is_subset(theirs)).then(|| {
                format!("{name} has the features {features:?} for build scripts, in the programs {theirs:?}")
            })
        });
        linked.chain(others).collect()
    }
}

/// Name and version, and features, of every line of `cargo tree` about a package from elsewhere.
fn dependencies(tree: &str) -> impl Iterator<Item = (String, String)> {
    let lines = tree.lines().filter(|line| !line.contains(" (/"));
    lines.filter_map(|line| {
        let (package, features) = line.strip_suffix(']')?.rsplit_once(" [")?;
        Some((package.to_owned(), features.to_owned()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_named_and_packages_of_one_side_are_none() {
        let features = |linked: &str, all: &str| {
            let mut features =
                Features { linked: dependencies(linked).collect(), ..Features::default() };
            for (name, of) in dependencies(all) {
                features.all.entry(name).or_default().insert(of);
            }
            features
        };
        let programs = "serde v1 [std]\nlibc v0.2 []\ndomain v0.1.0 (/home/domain) [x]\n";
        let programs = features(programs, "serde v1 [std]\nsyn v3 [full]\nsyn v3 [derive]\n");
        let same =
            features("serde v1 [std]\ndomain v0.1.0 (/home/domain) []\n", "syn v3 [derive]\n");
        assert_eq!(same.differences(&programs), [""; 0]);
        let other = features("libc v0.2 [std]\nrand v1 [std]\n", "syn v3 []\n");
        let expected = [
            "libc v0.2 has the features std, in the programs ",
            r#"syn v3 has the features {""} for build scripts, in the programs {"derive", "full"}"#,
        ];
        assert_eq!(other.differences(&programs), expected);
    }
}
