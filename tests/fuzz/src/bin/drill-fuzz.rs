//! The fuzz targets behind libFuzzer: `MEMTRANSFER_FUZZ_TARGET` names the target, and the arguments are libFuzzer's.
//! `cargo xtask drill fuzz` builds and runs it.
#![no_main]

use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;
use memtransfer_fuzz::{TARGETS, Target};

/// The variable that names the target.
const VARIABLE: &str = "MEMTRANSFER_FUZZ_TARGET";

fn target() -> &'static Target {
    static TARGET: OnceLock<&'static Target> = OnceLock::new();
    TARGET.get_or_init(|| {
        let name = std::env::var(VARIABLE).unwrap_or_default();
        let found = TARGETS.iter().find(|target| target.name == name);
        found.unwrap_or_else(|| {
            eprintln!("{VARIABLE}={name:?} names no target");
            TARGETS.iter().for_each(|target| eprintln!("  {}", target.name));
            std::process::exit(2)
        })
    })
}

fuzz_target!(|input: &[u8]| (target().run)(input));
