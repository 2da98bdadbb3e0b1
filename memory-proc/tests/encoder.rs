//! The default encoder. Needs the files that `cargo xtask setup` fetches.

#![expect(clippy::unwrap_used, reason = "test helpers fail loudly")]

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use domain::RUNTIME_VARIABLE;
use memory_proc::encoder::{
    Encoder, Image, ImageSource, ModelFile, PreparedEncoder, Provider, SessionOpening,
};
use memory_proc::manifest::{EncoderManifest, Model};
use memory_proc::paths::CacheFolder;
use search::{Embedding, distance};

const SIDE: u32 = 256;

#[derive(Clone)]
struct Drawn(Arc<Vec<u8>>);

impl ImageSource for Drawn {
    fn image(&self) -> Image<'_> {
        Image { width: SIDE, height: SIDE, rgba: &self.0 }
    }
}

/// An image from a function of column and row.
fn draw(pixel: impl Fn(u32, u32) -> [u8; 3]) -> Drawn {
    let at = |i: u32| pixel(i % SIDE, i / SIDE);
    Drawn(Arc::new((0..SIDE * SIDE).flat_map(|i| [at(i)[0], at(i)[1], at(i)[2], 255]).collect()))
}

/// A lit floor, a wall and a barrel, seen from `shift` pixels further left.
fn scene(shift: u32) -> Drawn {
    draw(move |x, y| {
        let x = x + shift;
        let (dx, dy) = (x.abs_diff(140), y.abs_diff(150));
        match (dx, dy) {
            (..28, ..45) => [40, 60, (200 - 3 * dx) as u8],
            _ if y > 170 => [(y / 2) as u8, (y / 2) as u8, (x / 4) as u8],
            _ => [180, 170, (100 + x / 4) as u8],
        }
    })
}

fn noise(seed: u32) -> Drawn {
    draw(move |x, y| {
        let mut n = (x * SIDE + y).wrapping_mul(0x9E37_79B9) ^ seed;
        n = (n ^ n >> 15).wrapping_mul(0x85EB_CA6B);
        [(n >> 8) as u8, (n >> 16) as u8, (n >> 24) as u8]
    })
}

fn cache() -> CacheFolder {
    CacheFolder::from_environment().unwrap()
}

fn default_model() -> Model {
    let manifest = EncoderManifest::shipped().unwrap();
    manifest.model(&manifest.default).unwrap().clone()
}

fn start(file: ModelFile, threads: usize) -> anyhow::Result<Encoder> {
    let threads = NonZeroUsize::new(threads).unwrap();
    let prepared = PreparedEncoder::new(file, &cache().runtime(), threads, Provider::Cpu)?;
    prepared.start(SessionOpening::OnDemand, || {})
}

/// The default encoder.
fn encoder(threads: usize) -> Encoder {
    let file = ModelFile::read(&default_model(), None, &cache());
    file.and_then(|file| start(file, threads)).unwrap_or_else(|error| panic!("{error}"))
}

/// The error of embedding an image with this file, if there is one.
fn refusal(file: ModelFile) -> Option<String> {
    let mut encoder = start(file, 1).unwrap();
    encoder.embed_all([scene(0)]).err().map(|error| error.to_string())
}

fn bits(embedding: &Embedding) -> Vec<u32> {
    embedding.as_slice().iter().map(|value| value.to_bits()).collect()
}

#[test]
fn similar_images_have_near_embeddings() {
    let mut encoder = encoder(2);
    let images = [scene(0), scene(4), scene(60), noise(1), noise(2)];
    let embedded = encoder.embed_all(images).unwrap();
    let apart = |a: usize, b: usize| distance(embedded[a].as_slice(), embedded[b].as_slice());
    for (near, far) in [((0, 1), (0, 3)), ((0, 2), (0, 3)), ((1, 2), (1, 4)), ((3, 4), (3, 0))] {
        let (d, e) = (apart(near.0, near.1), apart(far.0, far.1));
        assert!(0.0 < d && d < e, "{near:?} are {d} apart and {far:?} {e}");
    }
    let facts = encoder.facts();
    assert!(facts.trained && facts.model == "dinov2-s14" && embedded[0].as_slice().len() == 384);
}

#[test]
fn an_embedding_does_not_depend_on_other_images() {
    let images: Vec<Drawn> = (0..4).map(|i| scene(9 * i)).chain([noise(1), noise(2)]).collect();
    let mut alone = encoder(1);
    let mut expected = Vec::new();
    for picture in &images {
        expected.push(bits(&alone.embed_all([picture.clone()]).unwrap()[0]));
    }
    let mut together = encoder(3);
    // Fewer images than workers, as many, and more than two for each.
    for (batch, offset) in [(2, 5), (3, 1), (7, 2)] {
        let order: Vec<usize> = (0..batch).map(|i| (5 * i + offset) % images.len()).collect();
        let batch = order.iter().map(|&index| images[index].clone());
        for (&index, embedding) in order.iter().zip(together.embed_all(batch).unwrap()) {
            assert!(bits(&embedding) == expected[index], "image {index} in {order:?}");
        }
    }
}

/// Setup fetches a runtime for the processor.
#[test]
fn a_provider_that_the_runtime_lacks_is_refused_with_those_that_it_has() {
    let file = ModelFile::read(&default_model(), None, &cache()).unwrap();
    let (runtime, one) = (cache().runtime(), NonZeroUsize::MIN);
    let Err(error) = PreparedEncoder::new(file, &runtime, one, Provider::Cuda) else {
        panic!("the runtime has CUDA")
    };
    let error = error.to_string();
    let expected = format!(
        "ONNX Runtime at {} has no execution provider `cuda`; it offers cpu",
        runtime.path().display()
    );
    assert!(error.starts_with(&expected) && error.contains("--provider"), "{error}");
    assert_eq!(encoder(1).facts().provider, Provider::Cpu);
}

#[test]
fn a_broken_image_is_an_error_and_the_encoder_continues() {
    struct Short;
    impl ImageSource for Short {
        fn image(&self) -> Image<'_> {
            Image { width: 9, height: 9, rgba: &[0; 9] }
        }
    }
    let mut encoder = encoder(1);
    let error = encoder.embed_all([Short]).unwrap_err().to_string();
    assert_eq!(error, "an image of 9 x 9 pixels has 9 bytes");
    assert!(encoder.embed_all([scene(0)]).is_ok());
}

#[test]
fn errors_about_missing_files_name_the_command_that_fetches_them() {
    let empty = tempfile::tempdir().unwrap();
    let nowhere = CacheFolder::at(empty.path());
    let manifest = EncoderManifest::shipped().unwrap();
    let said = |model: &Model, file: Option<&Path>, cache: &CacheFolder| {
        ModelFile::read(model, file, cache).unwrap_err().to_string()
    };
    let model = default_model();
    let path = nowhere.model("dinov2-s14.onnx");
    let expected = format!(
        "the encoder dinov2-s14 needs {}, which is not there; run `cargo xtask setup`",
        path.display()
    );
    assert_eq!(said(&model, None, &nowhere), expected);
    let untrained = manifest.model("vit-b16-untrained").unwrap();
    assert!(said(untrained, None, &nowhere).contains("run `cargo xtask vit-b16-untrained`"));
    let users = manifest.model("vit-b16").unwrap();
    assert!(said(users, None, &nowhere).contains("--encoder-file"));
    assert!(said(users, Some(&path), &nowhere).starts_with("cannot read the model file "));

    let file = ModelFile::read(&model, None, &cache()).unwrap_or_else(|error| panic!("{error}"));
    let Err(error) =
        PreparedEncoder::new(file, &nowhere.runtime(), NonZeroUsize::MIN, Provider::Cpu)
    else {
        panic!("there is no runtime")
    };
    assert_eq!(
        error.to_string(),
        format!(
            "ONNX Runtime is not at {}; run `cargo xtask setup`",
            nowhere.runtime().path().display()
        )
    );
}

#[test]
fn a_model_that_does_not_match_the_manifest_is_refused_with_a_reason() {
    let folder = tempfile::tempdir().unwrap();
    let model = default_model();
    let whole = std::fs::read(cache().model("dinov2-s14.onnx"))
        .unwrap_or_else(|error| panic!("{error}: run `cargo xtask setup`"));
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    let truncated = write("truncated.onnx", &whole[..whole.len() / 2]);
    let garbage = write("garbage.onnx", &[0x5a; 4096]);
    let empty = write("empty.onnx", &[]);

    let error = ModelFile::read(&model, Some(&truncated), &cache()).unwrap_err().to_string();
    assert!(error.contains("its SHA-256 is") && error.contains("give the right file"), "{error}");

    let refused = |model: &Model, path: Option<&PathBuf>| {
        let unpinned = Model { sha256: None, ..model.clone() };
        let file = ModelFile::read(&unpinned, path.map(PathBuf::as_path), &cache()).unwrap();
        refusal(file).unwrap_or_else(|| panic!("{path:?} was accepted"))
    };
    for path in [&truncated, &garbage, &empty] {
        let error = refused(&model, Some(path));
        let expected = format!("ONNX Runtime rejects the model file {}", path.display());
        assert!(error.starts_with(&expected), "{error}");
    }
    for (wrong, expected) in [
        (
            Model { output: "tokens".into(), ..model.clone() },
            "has no output tensor tokens; it has /backbone",
        ),
        (
            Model { input: "pixels".into(), ..model.clone() },
            "has no input tensor pixels; it has input_image",
        ),
        (Model { dimension: 768, ..model.clone() }, "not float [1, -1, 768] or [1, 768]"),
        (Model { input_size: 256, ..model.clone() }, "not float [1, 3, 256, 256]"),
    ] {
        let error = refused(&wrong, None);
        assert!(error.contains(expected) && error.contains("models.toml"), "{error}");
    }
}

/// In processes of their own: a process loads ONNX Runtime once.
#[test]
fn only_a_known_library_in_the_cache_folder_is_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let planted = CacheFolder::at(folder.path());
    let (model, runtime) = (planted.model("dinov2-s14.onnx"), planted.runtime());
    let (model, runtime) = (&*model, runtime.path());
    for path in [model, runtime] {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    }
    std::os::unix::fs::symlink(cache().model("dinov2-s14.onnx"), model).unwrap();
    let known = std::fs::read(cache().runtime().path()).unwrap();
    let picture = folder.path().join("view.png");
    png_file::RgbaImage::filled(8, 8, [0; 4]).write(&picture).unwrap();
    let embed = |picture: &Path, own: Option<&Path>| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_memory-proc"));
        command.arg("embed").arg(picture).arg("--cache").arg(folder.path());
        command.env_remove(RUNTIME_VARIABLE).envs(own.map(|path| (RUNTIME_VARIABLE, path)));
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let refused = |own: Option<&Path>| {
        let (status, error) = embed(&picture, own);
        assert_eq!(status, Some(2), "{error}");
        let path = own.unwrap_or(runtime);
        let expected = format!("memory-proc: ONNX Runtime at {} cannot be used", path.display());
        assert!(error.starts_with(&expected), "{error}");
        error
    };
    // Works as the known one does, has one byte more, and is not loaded.
    let longer = [&known[..], b"\0"].concat();
    for bytes in [b"no library", &longer[..]] {
        std::fs::write(runtime, bytes).unwrap();
        let error = refused(None);
        for part in ["is not the library", "was not loaded", RUNTIME_VARIABLE, "cargo xtask setup"]
        {
            assert!(error.contains(part), "{part}: {error}");
        }
    }
    // The user's own is not compared: it is loaded, and the loader says what is wrong with it.
    let own = folder.path().join("own.so");
    std::fs::write(&own, &longer).unwrap();
    let (status, error) = embed(&picture, Some(&own));
    assert_eq!(status, Some(0), "{error}");
    std::fs::write(&own, "no library").unwrap();
    let error = refused(Some(&own));
    assert!(!error.contains("was not loaded") && error.contains(RUNTIME_VARIABLE), "{error}");
    let (_, error) = embed(&folder.path().join("none.png"), None);
    assert!(error.contains("cannot read ") && error.contains("none.png"), "{error}");
}

/// The script writes the file that the manifest describes, of a ViT-B/16's size.
#[test]
fn the_untrained_vit_b16_is_written_and_runs_under_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("vit.onnx");
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../xtask/python/vit_b16_untrained.py");
    let written = Command::new("python3").arg("-B").arg(script).arg(&path).status().unwrap();
    assert!(written.success());
    let manifest = EncoderManifest::shipped().unwrap();
    let model = manifest.model("vit-b16-untrained").unwrap();
    let file = ModelFile::read(model, Some(&path), &cache()).unwrap();
    let mut encoder = start(file, 1).unwrap();
    let embedded = encoder.embed_all([scene(0), scene(0), noise(1)]).unwrap();
    assert_eq!(embedded[0], embedded[1]);
    assert!(distance(embedded[0].as_slice(), embedded[2].as_slice()) > 0.0);
    let facts = encoder.facts();
    assert!(!facts.trained && facts.model.contains("untrained") && facts.dimension == 768);

    // The same file under the name of a trained model has the right shape and is refused.
    let users = manifest.model("vit-b16").unwrap();
    let file = ModelFile::read(users, Some(&path), &cache()).unwrap();
    assert!(refusal(file).unwrap_or_default().contains("untrained"));
}
