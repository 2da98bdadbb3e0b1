//! The lock of a run folder on other file systems. Apart from other tests, because a process that a test starts has the locks of the others
//! for a moment.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on fails")]

use std::fs::{self, File};

use rigs::records::manifest;
use run_log::{LogError, RunFolder};

/// A preloaded `flock` as that of file systems that lock only files opened for writing, as NFS, or nothing at all.
const FLOCK: &str = r#"
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
int flock(int fd, int operation) {
    int (*real)(int, int) = (int (*)(int, int))dlsym(RTLD_NEXT, "flock");
    const char *none = getenv("FLOCK_ERRNO");
    int writable = (fcntl(fd, F_GETFL) & O_ACCMODE) != O_RDONLY;
    if (none && *none) { errno = atoi(none); return -1; }
    if (!writable) { errno = EBADF; return -1; }
    return real(fd, operation);
}
"#;

/// Runs the test `name` again in a process with that `flock`, which fails with `errno` if that is given. Returns `true` in
/// the process.
fn with_other_flock(name: &str, errno: &str) -> bool {
    if std::env::var_os("FLOCK_ERRNO").is_some() {
        return true;
    }
    let folder = tempfile::tempdir().unwrap();
    let [source, library] = ["flock.c", "flock.so"].map(|file| folder.path().join(file));
    fs::write(&source, FLOCK).unwrap();
    // The compiler that links Rust programs.
    let mut compiler = std::process::Command::new("cc");
    compiler.args(["-shared", "-fPIC", "-o"]).args([&library, &source]).arg("-ldl");
    assert!(compiler.status().unwrap().success());
    let mut again = std::process::Command::new(std::env::current_exe().unwrap());
    again.args([name, "--exact"]);
    let output = again.env("LD_PRELOAD", library).env("FLOCK_ERRNO", errno).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && printed.contains("1 passed"), "{printed}");
    false
}

#[test]
fn a_run_is_locked_where_folders_cannot_be() {
    if !with_other_flock("a_run_is_locked_where_folders_cannot_be", "") {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    assert!(File::open(dir.path()).unwrap().try_lock().is_err(), "the other flock is used");
    let open = || RunFolder::open(dir.path(), manifest(), true);
    let held = open().unwrap();
    assert!(matches!(open(), Err(LogError::Locked(_))));
    drop(held);
    open().unwrap();
}

#[test]
fn a_file_system_without_locks_is_refused() {
    let errno = rustix::io::Errno::NOLCK.raw_os_error();
    if !with_other_flock("a_file_system_without_locks_is_refused", &errno.to_string()) {
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let error = RunFolder::open(dir.path(), manifest(), false).unwrap_err().to_string();
    let error = error.replace(&dir.path().display().to_string(), "DIR");
    insta::assert_snapshot!(error, @"the file system of DIR has no locks (No locks available (os error 37)), without which two runs could write to it: choose an --out elsewhere, or mount this one with locks (NFS: with `rpc.statd`)");
}
