//! The files that the command of an external program names, with their hashes: changed code is known by them.
//!
//! A program counts, found as the system finds it, and so does every word that names an existing file: a script, its
//! configuration. A word with blanks, such as what `sh -c` is given, is a command of its own. Interpreters and the system's own
//! programs do not count: they change with the system. What a program loads beside these files is its SDK's to tell.

use std::collections::BTreeMap;
use std::env;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// Programs that start others: what matters is what they are given.
const INTERPRETERS: [&str; 24] = [
    "bash", "bun", "conda", "dash", "deno", "docker", "env", "java", "julia", "nice", "node",
    "perl", "php", "pixi", "podman", "poetry", "pypy", "python", "Rscript", "ruby", "sh",
    "timeout", "uv", "zsh",
];

/// Where the system has its own programs.
const SYSTEM_FOLDERS: [&str; 4] = ["/bin", "/sbin", "/usr/bin", "/usr/sbin"];

/// The files that `command` names, by the words that name them, with their BLAKE3 hashes. Empty for a command that cannot be
/// split into words, which does not start.
///
/// # Errors
/// When a file cannot be read.
pub(crate) fn command_files(command: &str) -> Result<BTreeMap<String, String>> {
    let mut files = BTreeMap::new();
    for (number, word) in shlex::split(command).unwrap_or_default().into_iter().enumerate() {
        if word.contains(char::is_whitespace) && !Path::new(&word).is_file() {
            files.extend(command_files(&word)?);
            continue;
        }
        // `--config=FILE` names a file, too.
        let named = match word.split_once('=') {
            Some((flag, value)) if flag.starts_with('-') => value,
            _ => word.as_str(),
        };
        // What a shell is given can end a command with these.
        let named = named.trim_end_matches([';', '&']);
        let path = match number {
            0 => program(named),
            _ => Some(PathBuf::from(named)).filter(|path| path.is_file()),
        };
        if let Some(path) = path.filter(|path| !is_of_system(path)) {
            let hash = hash(&path).with_context(|| format!("cannot read {}", path.display()))?;
            files.insert(named.to_owned(), hash);
        }
    }
    Ok(files)
}

/// The file of the program called `name`: a path, or a name in `PATH`.
fn program(name: &str) -> Option<PathBuf> {
    if name.contains('/') {
        return Some(PathBuf::from(name)).filter(|path| path.is_file());
    }
    let path = env::var_os("PATH")?;
    env::split_paths(&path).map(|folder| folder.join(name)).find(|path| path.is_file())
}

/// Whether the program at `path` is the system's own, or its name that of an interpreter, with or without its version.
fn is_of_system(path: &Path) -> bool {
    if path.parent().is_some_and(|folder| SYSTEM_FOLDERS.iter().any(|of| folder == Path::new(of))) {
        return true;
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.trim_end_matches(|c: char| c.is_ascii_digit() || ".-".contains(c));
    INTERPRETERS.contains(&name)
}

fn hash(path: &Path) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(durable::input::open(path)?)?;
    Ok(hasher.finalize().to_hex().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scripts_programs_and_configurations_count_and_interpreters_do_not() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name).display().to_string();
        for name in ["memory.py", "my-memory", "settings.toml", "python3.12"] {
            std::fs::write(at(name), name).unwrap();
        }
        let named = |command: &str| -> Vec<String> {
            let files = command_files(command).unwrap();
            files.keys().map(|file| file.rsplit('/').next().unwrap().to_owned()).collect()
        };
        let (script, program) = (at("memory.py"), at("my-memory"));
        assert_eq!(named(&format!("{} {script} --top 3", at("python3.12"))), ["memory.py"]);
        assert_eq!(named(&format!("env A=1 python3 -u {script}")), ["memory.py"]);
        let settings = at("settings.toml");
        let both = ["my-memory", "settings.toml"];
        assert_eq!(named(&format!("{program} --config={settings}")), both);
        assert_eq!(named(&format!("{program} {settings} no-such-file")), both);
        assert_eq!(named(&format!("sh -c 'sleep 1 & {program}; exit $?'")), ["my-memory"]);
        assert_eq!(named("python -m package.module"), Vec::<String>::new());
        let before = command_files(&script).unwrap();
        std::fs::write(&script, "changed").unwrap();
        assert_ne!(command_files(&script).unwrap(), before);
    }
}
