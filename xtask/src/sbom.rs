//! `sbom`: the software bill of materials, in CycloneDX 1.5: every package that is linked into the programs or needed to
//! build them, and every Python package that set-up or an example installs. It has no time stamp: the same lock file
//! gives the same text.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::Context;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::licences::{Package, packages_built_for};
use crate::pins::Pins;
use crate::workspace::Workspace;

/// Writes `target/sbom/memtransfer.cdx.json`.
pub(crate) fn write(pins: &Pins, workspace: &Workspace) -> anyhow::Result<()> {
    let sums = sums(&workspace.root().join("Cargo.lock"))?;
    let packages = packages_built_for(workspace, "normal,build")?;
    let version = packages.iter().find(|package| package.name == "memtransfer");
    let version = version.map_or("0", |package| package.version.as_str());
    let linked = packages.iter().filter(|package| package.source.is_some());
    let components = linked.map(|package| component(package, &sums));
    let mut components: Vec<Value> = components.collect();
    components.extend(wheels(pins));
    components.extend(requirements(pins, workspace.root())?);
    components.sort_by_key(|component| component["bom-ref"].to_string());
    let listed: Vec<&Value> = components.iter().map(|component| &component["bom-ref"]).collect();
    let bom = json!({
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": "memtransfer",
                "name": "memtransfer",
                "version": version,
                "licenses": [{ "expression": "MIT OR Apache-2.0" }],
            },
        },
        "dependencies": [{ "ref": "memtransfer", "dependsOn": listed }],
        "components": components,
    });
    let out = workspace.root().join("target/sbom/memtransfer.cdx.json");
    let folder = out.parent().context("a file without a folder")?;
    let written =
        std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&out, format!("{bom:#}\n")));
    written.with_context(|| format!("cannot write {}", out.display()))?;
    println!("{}: {} components", out.display(), listed.len());
    Ok(())
}

fn component(package: &Package, sums: &BTreeMap<(String, String), String>) -> Value {
    let Package { name, version, license, .. } = package;
    let address = format!("pkg:cargo/{name}@{version}");
    let mut component = json!({
        "type": "library", "bom-ref": address, "name": name, "version": version, "purl": address,
    });
    if let Some(license) = license {
        // Older packages write `MIT/Apache-2.0`.
        component["licenses"] = json!([{ "expression": license.replace('/', " OR ") }]);
    }
    if let Some(sum) = sums.get(&(name.clone(), version.clone())) {
        component["hashes"] = json!([{ "alg": "SHA-256", "content": sum }]);
    }
    component
}

/// The checksums in `Cargo.lock`, by name and version.
fn sums(lock: &Path) -> anyhow::Result<BTreeMap<(String, String), String>> {
    #[derive(Deserialize)]
    struct Lock {
        package: Vec<Locked>,
    }
    #[derive(Deserialize)]
    struct Locked {
        name: String,
        version: String,
        checksum: Option<String>,
    }
    let text =
        std::fs::read_to_string(lock).with_context(|| format!("cannot read {}", lock.display()))?;
    let lock: Lock = toml::from_str(&text).context("cannot use Cargo.lock")?;
    let sum = |locked: Locked| Some(((locked.name, locked.version), locked.checksum?));
    Ok(lock.package.into_iter().filter_map(sum).collect())
}

/// The wheels that files in the cache folder are taken from.
fn wheels(pins: &Pins) -> impl Iterator<Item = Value> {
    let platforms =
        pins.file.iter().flat_map(|file| file.platform.values().map(move |of| (file, of)));
    platforms.filter_map(|(file, of)| {
        let wheel = of.wheel.as_ref()?;
        let (name, version) = wheel.package.split_once("==")?;
        let sum = wheel.sha256.to_string();
        Some(json!({
            "type": "file",
            "bom-ref": format!("file:{}", wheel.file),
            "name": name,
            "version": version,
            "purl": python_address(name, version),
            "description": file.why,
            "hashes": [{ "alg": "SHA-256", "content": sum }],
        }))
    })
}

fn python_address(name: &str, version: &str) -> String {
    format!("pkg:pypi/{}@{version}", name.to_lowercase().replace('_', "-"))
}

/// The Python packages of the environments, with the files that pin them by hash. None is part of the programs.
fn requirements(pins: &Pins, root: &Path) -> anyhow::Result<Vec<Value>> {
    let mut files: BTreeMap<(String, String), BTreeSet<String>> = BTreeMap::new();
    for environment in &pins.environment {
        let file = environment.requirements.display().to_string();
        let text = std::fs::read_to_string(root.join(&environment.requirements))
            .with_context(|| format!("cannot read {file}"))?;
        for package in text.lines().filter_map(requirement) {
            files.entry(package).or_default().insert(file.clone());
        }
    }
    let component = |((name, version), files): ((String, String), BTreeSet<String>)| {
        let pinned = |file| json!({ "name": "memtransfer:pinned-in", "value": file });
        let address = python_address(&name, &version);
        json!({
            "type": "library", "bom-ref": address, "name": name, "version": version, "purl": address,
            "scope": "excluded",
            "properties": files.into_iter().map(pinned).collect::<Vec<Value>>(),
        })
    };
    Ok(files.into_iter().map(component).collect())
}

/// The package in a line `name==version ; condition \` of a requirements file.
fn requirement(line: &str) -> Option<(String, String)> {
    let (name, rest) = line.split_once("==").filter(|_| !line.starts_with([' ', '#']))?;
    let name = name.split('[').next()?;
    let version = rest.split([' ', ';', '\\']).next()?;
    Some((name.to_owned(), version.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_are_read_from_requirements() {
        let found = |name: &str, version: &str| Some((name.to_owned(), version.to_owned()));
        assert_eq!(requirement("httpx==0.28.1 \\"), found("httpx", "0.28.1"));
        assert_eq!(requirement("a[b]==2 ; python_version < '3.11' \\"), found("a", "2"));
        assert_eq!(requirement("    # via httpx==0.1"), None);
        assert_eq!(requirement("    --hash=sha256:00"), None);
        assert_eq!(python_address("Typing_Extensions", "4"), "pkg:pypi/typing-extensions@4");
    }
}
