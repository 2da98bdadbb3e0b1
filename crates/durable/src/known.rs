//! Which files in a folder are this program's: those with names that it gives. Only these are ever removed.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use regex_lite::Regex;

/// The names of the files and folders that a program writes below a folder.
#[derive(Debug, Clone)]
pub struct KnownNames(Regex);

/// What [`KnownNames::remove_in`] did.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Removal {
    /// The entries of the folder of which all or a part was removed.
    pub removed: BTreeSet<PathBuf>,
    /// What was left, because its name is none of the known ones: paths below the folder.
    pub left: Vec<PathBuf>,
}

impl KnownNames {
    /// The names that one of the regular expressions matches as a whole. A name is a path below the folder; that of a folder
    /// ends with a slash.
    ///
    /// # Errors
    /// When one of them is no regular expression.
    pub fn new<'a>(patterns: impl IntoIterator<Item = &'a str>) -> io::Result<Self> {
        let patterns: Vec<&str> = patterns.into_iter().collect();
        let all = match &patterns[..] {
            // An empty alternative would be the empty name.
            [] => Regex::new("^/$"),
            _ => Regex::new(&format!("^(?:{})$", patterns.join("|"))),
        };
        all.map(Self).map_err(|error| io::Error::new(ErrorKind::InvalidInput, error))
    }

    /// Whether `file`, a path below the folder, is a known file.
    pub fn has(&self, file: &Path) -> bool {
        file.to_str().is_some_and(|name| self.0.is_match(name))
    }

    /// Removes the known files in `folder`, and the known folders that are empty then. Follows no symbolic link.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn remove_in(&self, folder: &Path) -> io::Result<Removal> {
        let mut removal = Removal::default();
        let mut keep = Vec::new();
        self.visit(folder, Path::new(""), &mut |path, is_known| {
            let full = folder.join(path);
            if !is_known {
                keep.push(path.to_owned());
                return Ok(());
            }
            let outcome = match fs::symlink_metadata(&full)?.is_dir() {
                true => fs::remove_dir(&full),
                false => fs::remove_file(&full),
            };
            match outcome {
                // Something unknown is in it.
                Err(error) if error.kind() == ErrorKind::DirectoryNotEmpty => return Ok(()),
                outcome => outcome?,
            }
            removal.removed.extend(path.iter().next().map(PathBuf::from));
            Ok(())
        })?;
        removal.left = keep;
        Ok(removal)
    }

    /// What is in `folder` and has none of the known names: paths below it. A folder with an unknown name stands for
    /// everything in it.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn others_in(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        let mut others = Vec::new();
        self.visit(folder, Path::new(""), &mut |path, is_known| {
            others.extend((!is_known).then(|| path.to_owned()));
            Ok(())
        })?;
        Ok(others)
    }

    /// Calls `see` with every path in `folder/below`, and whether it is known: in the order of names, what is in a known
    /// folder before it, and nothing in an unknown one.
    fn visit(
        &self,
        folder: &Path,
        below: &Path,
        see: &mut dyn FnMut(&Path, bool) -> io::Result<()>,
    ) -> io::Result<()> {
        let entries: Vec<fs::DirEntry> =
            fs::read_dir(folder.join(below))?.collect::<io::Result<_>>()?;
        let mut names: Vec<_> = entries.iter().map(fs::DirEntry::file_name).collect();
        names.sort();
        for name in names {
            let path = below.join(name);
            let is_folder = fs::symlink_metadata(folder.join(&path))?.is_dir();
            // A folder's name ends with a slash.
            let is_known = self.has(&if is_folder { path.join("") } else { path.clone() });
            if is_known && is_folder {
                self.visit(folder, &path, see)?;
            }
            see(&path, is_known)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn only_what_has_a_known_name_is_removed_at_every_depth() {
        let base = tempfile::tempdir().unwrap();
        let path = |name: &str| base.path().join(name);
        for folder in ["pages/figures", "pages/mine/figures", "pages/tables", "pages/page.html2"] {
            fs::create_dir_all(path(folder)).unwrap();
        }
        let ours = ["page.html", "figures/a-1.svg", "tables/t.csv"];
        let mine =
            ["figures/mine.svg", "figures/a-1.svg.bak", "mine/figures/a-1.svg", "page.htmlx"];
        for name in ours.into_iter().chain(mine) {
            fs::write(path("pages").join(name), name).unwrap();
        }
        fs::write(path("secret"), "secret").unwrap();
        // A link with the name of a file is that file; one with the name of a folder is no folder.
        symlink(path("secret"), path("pages/figures/a-2.svg")).unwrap();
        symlink(base.path(), path("pages/more")).unwrap();
        let patterns =
            [r"page\.html", "(figures|more)/", r"figures/a-[0-9]+\.svg", r"tables/(t\.csv)?"];
        let names = KnownNames::new(patterns).unwrap();
        let others =
            ["figures/a-1.svg.bak", "figures/mine.svg", "mine", "more", "page.html2", "page.htmlx"];
        let others: Vec<PathBuf> = others.into_iter().map(PathBuf::from).collect();
        assert_eq!(names.others_in(&path("pages")).unwrap(), others);
        let removal = names.remove_in(&path("pages")).unwrap();
        assert_eq!(removal.left, others);
        let removed: Vec<_> = removal.removed.iter().map(|path| path.to_str().unwrap()).collect();
        assert_eq!(removed, ["figures", "page.html", "tables"]);
        for name in mine {
            assert_eq!(fs::read_to_string(path("pages").join(name)).unwrap(), name);
        }
        for name in ours {
            assert!(!path("pages").join(name).exists(), "{name}");
        }
        assert!(!path("pages/tables").exists() && path("secret").exists());
        assert!(KnownNames::new(["("]).is_err());
    }
}
