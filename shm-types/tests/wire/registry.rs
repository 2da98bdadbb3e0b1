//! Runs that end in every way: they leave nothing behind, and live runs are not touched.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use bytemuck::Zeroable;
use shm_types::message::{Role, StepCommand};
use shm_types::process::SHARED_MEMORY;
use shm_types::registry::{RegistryError, clean, list};
use shm_types::{Attach, Bus, FramePublisher, FrameStore, RunDir};

use crate::child::sleeper;
use crate::common::{Run, bus, run, shared_memory};

#[test]
fn a_run_that_ends_well_leaves_nothing() {
    let Run { attach, dir, base, .. } = run();
    let (path, prefix) = (dir.path().to_owned(), dir.prefix());
    {
        let roles = [Role::Orchestrator, Role::Sim, Role::Memory, Role::Policy];
        let buses = roles.map(|role| bus(&attach, role));
        let _stores = (FrameStore::new(&buses[2]).unwrap(), FrameStore::new(&buses[3]).unwrap());
        let mut publisher = FramePublisher::new(&buses[1]).unwrap();
        let slot = publisher.loan().unwrap();
        publisher.publish(slot, [0; 16]).unwrap();
        assert!(shared_memory(&prefix).1 > 0);
    }
    drop(dir);
    assert!(!path.exists());
    assert_eq!(shared_memory(&prefix), (0, 0));
    assert_eq!(list(base.path()).unwrap(), []);
}

/// Another user who may write to a segment can stop the run.
#[test]
fn no_other_user_may_open_what_a_run_has_in_shared_memory() {
    let Run { attach, dir, .. } = &run();
    let roles = [Role::Orchestrator, Role::Sim, Role::Memory, Role::Policy];
    let buses = roles.map(|role| bus(attach, role));
    let _store = FrameStore::new(&buses[2]).unwrap();
    let _publisher = FramePublisher::new(&buses[1]).unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!(mode(dir.path()), 0o700);
    let names: Vec<_> = fs::read_dir(SHARED_MEMORY)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.file_name().unwrap().to_str().unwrap().starts_with(&dir.prefix()))
        .collect();
    assert!(names.len() > roles.len());
    for name in &names {
        assert_eq!(mode(name), 0o600, "{}", name.display());
    }
    // iceoryx2 uses the counter that the run's owner has made, and has made no other.
    let is_counter = |name: &&PathBuf| name.extension().is_some_and(|it| it == "global_mgmt");
    let counters: Vec<_> = names.iter().filter(is_counter).collect();
    assert_eq!(counters.len(), 1);
    let counted = fs::read(counters[0]).unwrap();
    assert_eq!((counted.len(), usize::from(counted[8])), (16, roles.len()));
}

#[test]
fn clean_removes_what_a_killed_run_left_and_nothing_that_lives() {
    let Run { attach, dir, base, .. } = &run();
    let (orchestrator, sim) = (bus(attach, Role::Orchestrator), bus(attach, Role::Sim));
    let commands = sim.receiver::<StepCommand>().unwrap();
    let sender = orchestrator.sender::<StepCommand>().unwrap();

    let child = sleeper("run", base.path());
    let killed = PathBuf::from(&child.word);
    let prefix = format!("mt{}_", killed.file_name().unwrap().to_str().unwrap());
    // A folder that is not a run, and a run that died before it had a lock.
    let (foreign, unborn) = (base.path().join("notes"), base.path().join("0123abcd"));
    fs::create_dir(&foreign).unwrap();
    fs::create_dir(&unborn).unwrap();

    // One that cannot be removed does not keep the others.
    let stuck = base.path().join("0000000a");
    fs::create_dir_all(stuck.join("lock")).unwrap();

    let living = clean(base.path()).unwrap();
    assert_eq!(living.failed.len(), 1, "{living:?}");
    fs::remove_dir_all(stuck).unwrap();
    assert_eq!(living.removed, [unborn]);
    assert_eq!(living.alive.len(), 2);
    assert!(list(base.path()).unwrap().iter().all(|run| run.alive));

    drop(child);
    assert!(shared_memory(&prefix).0 > 0 && killed.exists());
    let cleaned = clean(base.path()).unwrap();
    assert_eq!(cleaned.removed, std::slice::from_ref(&killed));
    assert_eq!((cleaned.alive, cleaned.failed.len()), (vec![dir.path().to_owned()], 0));
    assert_eq!(shared_memory(&prefix), (0, 0));
    assert!(!killed.exists() && foreign.exists());

    sender.send(&Zeroable::zeroed()).unwrap();
    assert!(commands.next().unwrap().is_some());
    assert_eq!(clean(base.path()).unwrap().removed, [] as [PathBuf; 0]);
}

#[test]
fn a_new_generation_gets_the_memory_of_a_killed_process_back() {
    let Run { attach, dir, .. } = &run();
    attach.write(dir.path()).unwrap();
    let orchestrator = bus(attach, Role::Orchestrator);
    let (empty, _) = shared_memory(&dir.prefix());
    let child = sleeper("sim", dir.path());
    let frames = 8 * attach.frame.bytes() as u64;
    assert!(shared_memory(&dir.prefix()).0 >= empty + frames);
    drop(child);
    drop(orchestrator);
    let next = Attach { generation: 2, ..attach.clone() };
    let _orchestrator = bus(&next, Role::Orchestrator);
    assert!(shared_memory(&dir.prefix()).0 < empty + frames);
}

/// A process that is killed between the two calls that create a segment leaves one without a size.
#[test]
fn a_segment_without_a_size_is_removed() {
    let Run { base, dir, .. } = &run();
    let child = sleeper("run", base.path());
    let killed = PathBuf::from(&child.word);
    drop(child);
    let prefix = format!("mt{}_", killed.file_name().unwrap().to_str().unwrap());
    for entry in fs::read_dir(SHARED_MEMORY).unwrap().flatten() {
        if entry.file_name().to_string_lossy().starts_with(&prefix) {
            fs::File::create(entry.path()).unwrap();
        }
    }
    assert_eq!(clean(base.path()).unwrap().removed, [killed]);
    assert_eq!(shared_memory(&prefix), (0, 0));

    // In a run that goes on, a segment with a size stays, and one that a process is still creating.
    let segment = |name| Path::new(SHARED_MEMORY).join(format!("{}{name}", dir.prefix()));
    let [left, sized, created] = ["left", "sized", "created"].map(segment);
    fs::write(&left, "").unwrap();
    fs::write(&sized, "x").unwrap();
    let creator = fs::File::create(&created).unwrap();
    wait_until(|| !left.exists());
    assert!(sized.exists() && created.exists());
    drop(creator);
    wait_until(|| !created.exists());
    assert!(sized.exists());
}

/// iceoryx2 waits for a size without end.
#[test]
fn a_policy_that_outlives_the_owner_of_its_run_removes_segments_without_a_size() {
    let Run { base, .. } = &run();
    let child = sleeper("run", base.path());
    let root = PathBuf::from(&child.word);
    let attach = Attach { orchestrator_pid: child.child.id(), ..Attach::new(&root) };
    let prefix = attach.prefix.clone();
    drop(child);
    let segments = || {
        let entries = fs::read_dir(SHARED_MEMORY).unwrap().flatten();
        let ours = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix));
        ours.map(|entry| entry.path()).collect::<Vec<_>>()
    };
    for segment in segments() {
        fs::File::create(segment).unwrap();
    }
    // It may fail, but returns.
    let policy = Bus::join(attach, Role::Policy);
    let has_size = |segment: &PathBuf| fs::metadata(segment).is_ok_and(|about| about.len() > 0);
    wait_until(|| policy.is_err() || segments().iter().all(has_size));
    drop(policy);
    // Not at once: a process that another test is starting holds the locks of this one for a moment.
    wait_until(|| clean(base.path()).unwrap().removed == [root.clone()]);
    assert_eq!(shared_memory(&prefix), (0, 0));
}

/// Waits for what others do in their own time; the watchdog is the limit.
fn wait_until(is_true: impl Fn() -> bool) {
    while !is_true() {
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_socket_that_cannot_be_removed_is_left_behind_without_a_panic() {
    let Run { attach, dir, .. } = &run();
    let sim = bus(attach, Role::Sim);
    let sockets = fs::read_dir(dir.path()).unwrap().map(|entry| entry.unwrap().path());
    let sockets: Vec<PathBuf> =
        sockets.filter(|path| path.to_string_lossy().ends_with(".event")).collect();
    assert_eq!(sockets.len(), 1);
    fs::remove_file(&sockets[0]).unwrap();
    fs::create_dir_all(sockets[0].join("in the way")).unwrap();
    drop(sim);
    assert!(sockets[0].is_dir());
}

#[test]
fn a_run_outlives_its_owner_while_a_process_of_it_lives() {
    let Run { attach, dir, base, .. } = run();
    let path = dir.path().to_owned();
    let sim = bus(&attach, Role::Sim);
    drop(dir);
    assert_eq!(clean(base.path()).unwrap().alive, std::slice::from_ref(&path));
    drop(sim);
    // Not at once: a process that another test is starting holds the locks of this one for a moment.
    while clean(base.path()).unwrap().removed != [path.clone()] {
        assert!(path.exists());
        thread::yield_now();
    }
}

#[test]
fn a_base_that_others_write_to_or_that_is_too_long_is_refused() {
    let base = tempfile::Builder::new().prefix("mt").tempdir_in("/dev/shm").unwrap();
    fs::set_permissions(base.path(), fs::Permissions::from_mode(0o777)).unwrap();
    assert!(matches!(RunDir::create(base.path()), Err(RegistryError::OthersWrite { .. })));
    let file = base.path().join("file");
    fs::write(&file, "").unwrap();
    let error = RunDir::create(&file).unwrap_err().to_string();
    assert!(error.contains("is no folder") && error.contains("MEMTRANSFER_RUN_DIR="), "{error}");
    let long = Path::new("/tmp").join("x".repeat(40));
    let error = RunDir::create(&long).unwrap_err().to_string();
    assert!(error.contains("under 39 bytes"), "{error}");
    assert!(!long.exists());
    assert_eq!(list(&base.path().join("none")).unwrap(), []);
}

#[test]
fn a_child_dies_with_its_parent() {
    let Run { base, .. } = &run();
    let parent = sleeper("parent", base.path());
    let child = Path::new("/proc").join(&parent.word);
    assert!(child.exists());
    drop(parent);
    // A zombie until init collects it; the watchdog is the limit.
    let gone = |path: &Path| {
        fs::read_to_string(path.join("stat")).map_or(true, |stat| stat.contains(") Z "))
    };
    while !gone(&child) {
        thread::yield_now();
    }
}
