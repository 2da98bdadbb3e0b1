//! Which of the workspace's crates each of them may link: the table "Who knows what" of ARCHITECTURE.md,
//! checked against the manifests.
//!
//! Leaves out what tests link: they may look at anything. Only our own crates count, since no crate from
//! elsewhere can depend on one of them.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context, bail};
use serde::Deserialize;

use crate::workspace::Workspace;

/// Each crate, and those that it may link, itself or through others. That policy-proc does not link the
/// warehouse is what keeps the map from a policy.
const MAY_LINK: [(&str, &[&str]); 9] = [
    ("shm-types", &[]),
    ("warehouse", &["shm-types"]),
    ("sim-proc", &["shm-types", "warehouse"]),
    ("memory-proc", &["shm-types", "warehouse"]),
    ("policy-proc", &["shm-types"]),
    ("orchestrator", &["shm-types", "warehouse"]),
    ("memtransfer-tests", &["memory-proc", "policy-proc", "shm-types", "warehouse"]),
    // It measures them all, and iceoryx2 itself beside shm-types: outside shm-types, nobody else uses it.
    (
        "benches",
        &["memory-proc", "orchestrator", "policy-proc", "shm-types", "sim-proc", "warehouse"],
    ),
    ("xtask", &[]),
];

/// Checks every crate of the workspace; prints what is linked and may not be.
pub(crate) fn are_kept(workspace: &Workspace) -> anyhow::Result<bool> {
    let objections = objections(&packages(workspace)?);
    for objection in &objections {
        eprintln!("{objection}");
    }
    Ok(objections.is_empty())
}

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    dependencies: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    name: String,
    /// `None` is linked; others are "dev" and "build".
    kind: Option<String>,
}

/// The crates of the workspace.
fn packages(workspace: &Workspace) -> anyhow::Result<Vec<Package>> {
    let output = workspace
        .cargo(&["metadata", "--format-version", "1", "--no-deps"])
        .output()
        .context("cannot start cargo metadata")?;
    if !output.status.success() {
        bail!("cargo metadata failed: {}", String::from_utf8_lossy(&output.stderr));
    }
    let metadata: Metadata =
        serde_json::from_slice(&output.stdout).context("cannot read cargo metadata's answer")?;
    Ok(metadata.packages)
}

/// What is wrong, in words.
fn objections(packages: &[Package]) -> Vec<String> {
    let ours: BTreeSet<&str> = packages.iter().map(|package| package.name.as_str()).collect();
    let direct = |package: &Package| -> Vec<String> {
        let linked = package.dependencies.iter().filter(|d| d.kind.as_deref() != Some("dev"));
        let names = linked.map(|dependency| dependency.name.clone());
        names.filter(|name| ours.contains(name.as_str())).collect()
    };
    let links: BTreeMap<&str, Vec<String>> =
        packages.iter().map(|package| (package.name.as_str(), direct(package))).collect();
    let mut objections = Vec::new();
    for name in ours {
        let Some((_, allowed)) = MAY_LINK.iter().find(|(crate_name, _)| *crate_name == name) else {
            objections.push(format!("{name}: say in xtask/src/boundaries.rs what it may link"));
            continue;
        };
        let mut linked = BTreeSet::new();
        let mut open = vec![name];
        while let Some(next) = open.pop() {
            for dependency in links.get(next).into_iter().flatten() {
                if linked.insert(dependency.as_str()) {
                    open.push(dependency);
                }
            }
        }
        let wrong = linked.into_iter().filter(|dependency| !allowed.contains(dependency));
        objections
            .extend(wrong.map(|dependency| format!("{name} links {dependency} and must not")));
    }
    objections
}

#[cfg(test)]
mod tests {
    use super::*;

    fn package(name: &str, links: &[&str], dev: &[&str]) -> Package {
        let of = |kind: Option<&str>| {
            let kind = kind.map(str::to_owned);
            move |name: &&str| Dependency { name: (*name).to_owned(), kind: kind.clone() }
        };
        let linked = links.iter().map(of(None));
        let dependencies = linked.chain(dev.iter().map(of(Some("dev")))).collect();
        Package { name: name.to_owned(), dependencies }
    }

    #[test]
    fn what_may_not_be_linked_is_found_also_through_others() {
        let whole = |policy: Package, types: Package| {
            objections(&[types, package("warehouse", &["shm-types", "serde"], &[]), policy])
        };
        let plain = || package("shm-types", &["serde"], &[]);
        let good = package("policy-proc", &["shm-types", "serde"], &["warehouse"]);
        assert_eq!(whole(good, plain()), [""; 0]);
        let direct = package("policy-proc", &["shm-types", "warehouse"], &[]);
        assert_eq!(whole(direct, plain()), ["policy-proc links warehouse and must not"]);
        let around = package("shm-types", &["warehouse"], &[]);
        let found = whole(package("policy-proc", &["shm-types"], &[]), around).join("; ");
        assert!(found.contains("policy-proc links warehouse and must not"), "{found}");
        let new = package("referee", &[], &[]);
        assert!(objections(&[new])[0].starts_with("referee: say in xtask/src/boundaries.rs"));
    }
}
