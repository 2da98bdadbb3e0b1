//! Files in a folder that may come from elsewhere. Its author can put symbolic links into it, which lead anywhere.

use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::fd::AsFd;
use std::path::{Component, Path};

use rustix::fs::{AtFlags, CWD, FileType, Mode, OFlags};
use rustix::io::Errno;

use crate::input::regular;

/// Opens `path` for reading, a regular file below `folder`. The way to `folder` may have symbolic links, the way from there
/// must not.
///
/// # Errors
/// When the way leads through a symbolic link or out of `folder`, when the file is something else, when the system refuses.
pub fn open_beneath(folder: &Path, path: &Path) -> io::Result<File> {
    let outside = || {
        let problem = format!("it is not below {}", folder.display());
        io::Error::new(ErrorKind::InvalidInput, problem)
    };
    let way = path.strip_prefix(folder).map_err(|_| outside())?;
    let on_the_way = OFlags::PATH | OFlags::DIRECTORY;
    let flags = on_the_way | OFlags::CLOEXEC;
    let mut parent = File::from(rustix::fs::openat(CWD, folder, flags, Mode::empty())?);
    let mut names = way.components().peekable();
    while let Some(Component::Normal(name)) = names.next() {
        if names.peek().is_none() {
            return regular(open_at(&parent, Path::new(name), OFlags::RDONLY)?);
        }
        parent = open_at(&parent, Path::new(name), on_the_way)?;
    }
    Err(outside())
}

/// Opens `path`, seen from `parent`. Its last component must not be a symbolic link. Never waits for a pipe's other end.
pub(crate) fn open_at(parent: impl AsFd, path: &Path, flags: OFlags) -> io::Result<File> {
    let flags = flags | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let mode = Mode::from_raw_mode(0o666);
    let opened = rustix::io::retry_on_intr(|| rustix::fs::openat(&parent, path, flags, mode));
    opened.map(File::from).map_err(|errno| {
        let is_link = || {
            let found = rustix::fs::statat(&parent, path, AtFlags::SYMLINK_NOFOLLOW);
            found.is_ok_and(|found| FileType::from_raw_mode(found.st_mode) == FileType::Symlink)
        };
        match errno {
            Errno::LOOP | Errno::NOTDIR if is_link() => link_error(),
            errno => refusal(errno),
        }
    })
}

/// Checks that there is no symbolic link in `folder` or any folder below it, before something is written there by name.
///
/// # Errors
/// Names the first link; when the system refuses.
pub fn check_no_links(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let kind = entry.file_type()?;
        if kind.is_symlink() {
            let problem = format!("{}: {}", entry.path().display(), link_error());
            return Err(io::Error::new(ErrorKind::InvalidInput, problem));
        }
        if kind.is_dir() {
            check_no_links(&entry.path())?;
        }
    }
    Ok(())
}

/// The error of opening something for writing.
pub(crate) fn refusal(errno: Errno) -> io::Error {
    match errno {
        Errno::NXIO => {
            let problem = "it is a pipe or a socket and not a regular file";
            io::Error::new(ErrorKind::InvalidInput, problem)
        }
        errno => errno.into(),
    }
}

fn link_error() -> io::Error {
    let problem = "it is a symbolic link, and those in a run folder are not followed";
    io::Error::new(ErrorKind::InvalidInput, problem)
}

#[cfg(test)]
mod tests {
    use std::io::Read;
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn no_way_leads_out_of_a_folder() {
        let base = tempfile::tempdir().unwrap();
        let folder = base.path().join("run");
        fs::create_dir_all(folder.join("prompts/texts")).unwrap();
        fs::write(folder.join("prompts/texts/a"), "inside").unwrap();
        fs::write(base.path().join("secret"), "secret").unwrap();
        symlink("../../../secret", folder.join("prompts/texts/b")).unwrap();
        symlink("..", folder.join("up")).unwrap();
        symlink("run", base.path().join("run-link")).unwrap();
        let read = |folder: &Path, path: &str| {
            let mut text = String::new();
            open_beneath(folder, &folder.join(path))?.read_to_string(&mut text).map(|_| text)
        };
        assert_eq!(read(&folder, "prompts/texts/a").unwrap(), "inside");
        assert_eq!(read(&base.path().join("run-link"), "prompts/texts/a").unwrap(), "inside");
        for link in ["prompts/texts/b", "up/secret", "up"] {
            let problem = read(&folder, link).unwrap_err().to_string();
            assert!(problem.starts_with("it is a symbolic link"), "{link}: {problem}");
        }
        for outside in ["../secret", "/etc/passwd", "", "prompts"] {
            assert!(read(&folder, outside).is_err(), "{outside}");
        }
        assert_eq!(read(&folder, "prompts/none").unwrap_err().kind(), ErrorKind::NotFound);

        let problem = check_no_links(&folder).unwrap_err().to_string();
        assert!(problem.contains("it is a symbolic link"), "{problem}");
        fs::remove_file(folder.join("up")).unwrap();
        assert!(check_no_links(&folder).is_err());
        fs::remove_file(folder.join("prompts/texts/b")).unwrap();
        check_no_links(&folder).unwrap();
    }

    #[test]
    fn nothing_is_written_through_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::write(path("mine"), "mine").unwrap();
        symlink("mine", path("link")).unwrap();
        for outcome in [
            crate::read(&path("link")).map(drop),
            crate::append(&path("link")).map(drop),
            crate::write_file(&path("link"), b"x"),
            crate::replace(&path("file"), &path("link"), b"x"),
        ] {
            assert!(outcome.unwrap_err().to_string().starts_with("it is a symbolic link"));
        }
        assert_eq!(fs::read(path("mine")).unwrap(), b"mine");
        // A link is replaced, and not what it points to.
        crate::replace(&path("link"), &path("draft"), b"new").unwrap();
        assert_eq!(fs::read(path("link")).unwrap(), b"new");
        assert_eq!(fs::read(path("mine")).unwrap(), b"mine");
    }
}
