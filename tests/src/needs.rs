//! Where set-up put what tests need. A test that needs something missing fails and names the command that
//! installs it.

use std::path::PathBuf;

use memory_proc::paths::CacheFolder;

/// The Python with the packages of `xtask/python/requirements-tests.txt`. Run their programs as modules:
/// `python -m pytest`.
pub fn python() -> PathBuf {
    installed("python-tests/bin/python")
}

/// The Python with the packages that the wheel depends on for embeddings: those of `xtask/python/requirements-wheel.txt`.
pub fn wheel_python() -> PathBuf {
    installed("python-wheel/bin/python")
}

/// The Python with Inspect: the packages of `xtask/python/requirements-inspect.txt`.
pub fn inspect_python() -> PathBuf {
    installed("python-inspect/bin/python")
}

/// The Python with the readers of exports: the packages of `xtask/python/requirements-exports.txt`.
pub fn exports_python() -> PathBuf {
    installed("python-exports/bin/python")
}

/// The Python with the readers of data sets: the packages of `xtask/python/requirements-datasets.txt`.
pub fn datasets_python() -> PathBuf {
    installed("python-datasets/bin/python")
}

/// The Python with LeRobot: the packages of `xtask/python/requirements-lerobot.txt`, which `cargo xtask setup --lerobot` installs.
pub fn lerobot_python() -> PathBuf {
    installed("python-lerobot/bin/python")
}

/// The Python with Ray: the packages of `xtask/python/requirements-ray.txt`.
pub fn ray_python() -> PathBuf {
    installed("python-ray/bin/python")
}

/// The Python with the packages of the example memory in `examples/memories/NAME`.
pub fn memory_python(name: &str) -> PathBuf {
    installed(&format!("python-memories/{name}/bin/python"))
}

/// The Python with the packages of the example world in `examples/worlds/NAME`.
pub fn world_python(name: &str) -> PathBuf {
    installed(&format!("python-worlds/{name}/bin/python"))
}

/// The model of the default encoder.
pub fn encoder_model() -> PathBuf {
    installed("models/dinov2-s14.onnx")
}

/// A small text-only language model in llama.cpp's format.
pub fn language_model() -> PathBuf {
    installed("language-models/smollm2-135m-instruct-q4_1.gguf")
}

/// The first layers of [`language_model`], with the names of tokens around images.
pub fn short_language_model() -> PathBuf {
    installed("language-models/smollm2-2-layers.gguf")
}

/// An encoder with which [`short_language_model`] sees the colours of images, as llama.cpp's mmproj file.
pub fn vision_encoder() -> PathBuf {
    installed("language-models/colours-mmproj.gguf")
}

/// Chromium, or a browser of its family.
pub fn chromium() -> PathBuf {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let found = std::env::split_paths(&path)
        .flat_map(|folder| names.map(|name| folder.join(name)))
        .find(|program| program.is_file());
    found.expect(
        "no Chromium: run `cargo xtask setup --tests`, or the tests with `cargo xtask test`",
    )
}

fn installed(place: &str) -> PathBuf {
    let path = CacheFolder::from_environment().expect("a cache folder").root().join(place);
    assert!(
        path.is_file(),
        "{} is missing: run `cargo xtask setup --tests`, or the tests with `cargo xtask test`",
        path.display()
    );
    path
}
