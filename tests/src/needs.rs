//! What tests need from outside: where set-up put it. A test whose need is missing fails, and says
//! which command brings it.

use std::path::PathBuf;

use memory_proc::paths::Cache;

/// The Python that has the packages of `xtask/python/requirements-tests.txt`. Programs of packages are
/// run as modules: `python -m pytest`.
pub fn python() -> PathBuf {
    brought("python-tests/bin/python")
}

/// A small language model, text only, as llama.cpp reads it.
pub fn language_model() -> PathBuf {
    brought("language-models/smollm2-135m-instruct-q4_1.gguf")
}

fn brought(place: &str) -> PathBuf {
    let path = Cache::from_environment().expect("a cache folder").root().join(place);
    assert!(
        path.is_file(),
        "{} is missing: run `cargo xtask setup --tests`, or the tests with `cargo xtask test`",
        path.display()
    );
    path
}
