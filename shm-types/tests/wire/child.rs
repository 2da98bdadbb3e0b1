//! Child processes for tests: this test binary, started again in another part.

use std::env;
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::thread;

use shm_types::message::Role;
use shm_types::process::die_with_parent;
use shm_types::{Attach, FramePublisher, RunDir};

use crate::common::{LONG, attach, bus};

const PLAY: &str = "MEMTRANSFER_TEST_PLAY";
const DIR: &str = "MEMTRANSFER_TEST_DIR";

/// A child process that has printed its word and sleeps. Dropping it kills it, as `kill -9` does.
pub(crate) struct Sleeper {
    pub(crate) child: Child,
    pub(crate) word: String,
}

impl Drop for Sleeper {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

/// Starts `play` in `dir` and waits until it has printed its word.
pub(crate) fn sleeper(play: &str, dir: &std::path::Path) -> Sleeper {
    let mut child = Command::new(env::current_exe().unwrap())
        .args(["--exact", "child::plays", "--nocapture", "--test-threads=1"])
        .envs([(PLAY, play.as_ref()), (DIR, dir.as_os_str())])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let word =
        lines.map(Result::unwrap).find_map(|l| l.split_once("word: ").map(|w| w.1.to_owned()));
    Sleeper { child, word: word.expect("the child prints its word") }
}

/// Not a test: the main function of a child process.
#[test]
fn plays() {
    let Ok(play) = env::var(PLAY) else { return };
    let dir = PathBuf::from(env::var_os(DIR).unwrap());
    match play.as_str() {
        // A whole run: its owner, two consumers, and published frames.
        "run" => {
            let dir = RunDir::create(&dir).unwrap();
            let attach = attach(&dir);
            let _orchestrator = bus(&attach, Role::Orchestrator);
            publish_and_sleep(&attach, dir.path().to_str().unwrap());
        }
        // A simulator in an existing run.
        "sim" => publish_and_sleep(&Attach::read(&dir).unwrap(), "ready"),
        // A process with a child that ends with it.
        "parent" => {
            let child = sleeper("orphan", &dir);
            say(&format!("{}", child.child.id()));
            sleep();
        }
        "orphan" => {
            die_with_parent(std::os::unix::process::parent_id()).unwrap();
            assert!(die_with_parent(u32::MAX).is_err());
            say("ready");
            sleep();
        }
        _ => panic!("no play {play}"),
    }
}

fn publish_and_sleep(attach: &Attach, word: &str) -> ! {
    let (memory, policy) = (bus(attach, Role::Memory), bus(attach, Role::Policy));
    let _stores = (
        shm_types::FrameStore::new(&memory).unwrap(),
        shm_types::FrameStore::new(&policy).unwrap(),
    );
    let sim = bus(attach, Role::Sim);
    let mut publisher = FramePublisher::new(&sim).unwrap();
    for _ in 0..8 {
        let mut slot = publisher.loan().unwrap();
        slot.pixels_mut().fill(7);
        publisher.publish(slot, [7; 16]).unwrap();
    }
    say(word);
    sleep();
}

fn say(word: &str) {
    println!("word: {word}");
    std::io::stdout().flush().unwrap();
}

fn sleep() -> ! {
    thread::sleep(2 * LONG);
    std::process::exit(1);
}
