//! Which crate may link which: the rules of ARCHITECTURE.md, checked against the resolved dependencies. Dependencies of
//! tests and build scripts are exempt.

use std::collections::{BTreeMap, BTreeSet};

use serde::Deserialize;

use crate::workspace::Workspace;

/// Crates that must not link another, directly or through others.
const MUST_NOT_LINK: &[(&[&str], &[&str], &str)] = &[
    (
        &[
            "conditions",
            "documents",
            "domain",
            "export",
            "memory-proc",
            "memtransfer",
            "orchestrator",
            "peer",
            "plates",
            "policy-proc",
            "report",
            "run-log",
            "scores",
            "settings",
            "viewer",
            "world-client",
        ],
        &["warehouse"],
        "only the world knows the world: others have the case book that it writes or ask it, and a policy has its requests",
    ),
    (
        &[
            "conditions",
            "domain",
            "export",
            "report",
            "run-log",
            "scores",
            "search",
            "viewer",
            "warehouse",
            "world-client",
        ],
        &["iceoryx2"],
        "reading a run folder and computing the world must not need shared memory",
    ),
    (
        &["memory-proc", "policy-proc", "sim-proc"],
        &["memory-proc", "orchestrator", "policy-proc", "run-log", "sim-proc"],
        "processes share the wire, not each other's code",
    ),
    (
        &["conditions", "orchestrator", "run-log"],
        &["export", "report", "scores", "viewer"],
        "a run is recorded before it is scored, and what records it knows nothing of scores",
    ),
    (
        &["scores"],
        &["export", "report", "viewer"],
        "scores are computed before a report is rendered, and know nothing of it",
    ),
    (
        &["conditions", "export", "report", "run-log", "scores", "viewer", "world-client"],
        &["memory-proc", "orchestrator", "policy-proc", "sim-proc", "supervise"],
        "a run is scored and rendered from its folder alone, not by what executes it",
    ),
];

/// Packages from elsewhere, and the only crates that may name them in their dependencies.
const ONLY_IN: &[(&str, &[&str])] = &[
    ("iceoryx2", &["benches", "shm-types"]),
    ("ort", &["memory-proc"]),
    ("pyo3", &["memtransfer-python"]),
    ("ureq", &["llm"]),
    ("wgpu", &["sim-proc"]),
];

/// Checks every crate of the workspace and prints what breaks a rule.
pub(crate) fn check(workspace: &Workspace) -> anyhow::Result<bool> {
    let objections = objections(&links(workspace)?);
    for objection in &objections {
        eprintln!("{objection}");
    }
    Ok(objections.is_empty())
}

/// What each package links directly, by name.
type Links = BTreeMap<String, BTreeSet<String>>;

#[derive(Deserialize)]
struct LinkedPackage {
    name: String,
    dependencies: Vec<Dependency>,
}

#[derive(Deserialize)]
struct Dependency {
    name: String,
    /// `None` for a normal dependency; "dev" and "build" otherwise.
    kind: Option<String>,
}

/// The workspace's crates with the dependencies in their manifests. A package from elsewhere cannot depend on one of
/// ours, so following ours is enough.
fn links(workspace: &Workspace) -> anyhow::Result<Links> {
    let packages: Vec<LinkedPackage> = workspace.packages(&["--no-deps"])?;
    let linked = |package: LinkedPackage| {
        let names = package.dependencies.into_iter().filter(|it| it.kind.is_none());
        (package.name, names.map(|dependency| dependency.name).collect())
    };
    Ok(packages.into_iter().map(linked).collect())
}

/// Every broken rule, as a sentence.
fn objections(links: &Links) -> Vec<String> {
    let mut objections = Vec::new();
    for &(crates, forbidden, reason) in MUST_NOT_LINK {
        for &name in crates {
            let reached = reached_from(name, links);
            for other in
                forbidden.iter().filter(|other| **other != name && reached.contains(*other))
            {
                objections.push(format!("{name} links {other} and must not: {reason}"));
            }
        }
    }
    for &(package, allowed) in ONLY_IN {
        for (name, _) in links.iter().filter(|(_, direct)| direct.contains(package)) {
            if !allowed.contains(&name.as_str()) {
                objections.push(format!(
                    "{name} depends on {package}, which only {} may use",
                    allowed.join(" and ")
                ));
            }
        }
    }
    objections
}

/// What `name` links, directly or through other crates of the workspace.
fn reached_from<'a>(name: &str, links: &'a Links) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&str> = vec![name];
    while let Some(next) = open.pop() {
        for dependency in links.get(next).into_iter().flatten() {
            if reached.insert(dependency.as_str()) {
                open.push(dependency);
            }
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::*;

    fn links_of(crates: &[(&str, &[&str])]) -> Links {
        let owned = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
        crates.iter().map(|(name, direct)| ((*name).to_owned(), owned(direct))).collect()
    }

    #[test]
    fn a_forbidden_link_is_found_also_through_others() {
        let check = |crates: &[(&str, &[&str])], expected: &[&str]| {
            let found = objections(&links_of(crates));
            assert_eq!(found.len(), expected.len(), "{found:?}");
            for (found, expected) in found.iter().zip(expected) {
                assert!(found.starts_with(expected), "{found}");
            }
        };
        check(&[("policy-proc", &["peer", "serde"]), ("peer", &["domain"])], &[]);
        check(&[("policy-proc", &["warehouse"])], &["policy-proc links warehouse and must not"]);
        check(
            &[("policy-proc", &["helper"]), ("helper", &["warehouse"])],
            &["policy-proc links warehouse and must not"],
        );
        check(
            &[("run-log", &["shm-types"]), ("shm-types", &["iceoryx2"])],
            &["run-log links iceoryx2"],
        );
        check(
            &[("orchestrator", &["run-log", "report"])],
            &["orchestrator links report and must not"],
        );
        check(&[("orchestrator", &["ureq"])], &["orchestrator depends on ureq, which only llm"]);
    }

    #[test]
    fn the_rules_name_crates_that_exist() {
        let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
        let ours = MUST_NOT_LINK.iter().flat_map(|(crates, _, _)| *crates);
        for name in ours {
            let folders = [format!("{root}/{name}"), format!("{root}/crates/{name}")];
            let is_there = |folder: &String| std::path::Path::new(folder).is_dir();
            assert!(folders.iter().any(is_there), "{name}");
        }
    }
}
