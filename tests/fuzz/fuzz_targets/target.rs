//! The target that the variable `TARGET` names, behind libFuzzer.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use memtransfer_fuzz::{TARGETS, Target, run};

static CHOSEN: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("TARGET").unwrap_or_default();
    TARGETS.iter().find(|(known, _)| *known == name).unwrap_or_else(|| {
        let known: Vec<&str> = TARGETS.iter().map(|(name, _)| *name).collect();
        eprintln!("TARGET={name:?} names no target (known: {})", known.join(", "));
        std::process::exit(2)
    })
});

fuzz_target!(|input: &[u8]| run(*CHOSEN, input));
