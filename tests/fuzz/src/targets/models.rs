//! What models and servers answer, images, documents and embeddings.

use std::fs;
use std::sync::{Arc, OnceLock};

use case_book::WorldDeclaration;
use documents::DocumentFile;
use domain::{Action, Feedback, Heading, Pose, Representation, SegmentContent};
use llm::fuzzing;
use memory_proc::bank::MemoryBank;
use memory_proc::embedding_cache::{EmbeddingCache, stored};
use memory_proc::representation::{MemorySettings, built_in};
use peer::memory::{Query, Step};
use png_file::{Channels, RgbaImage, encode};
use prompt::read_answer;

use crate::files::{with_files, with_folder};

fn world() -> &'static WorldDeclaration {
    static WORLD: OnceLock<WorldDeclaration> = OnceLock::new();
    WORLD.get_or_init(warehouse::declaration)
}

/// A reply that is read is stored and read back equal; a server's message is one short line.
pub(crate) fn reply(input: &[u8]) {
    let message = fuzzing::error_message(input, str::to_owned);
    assert!(!message.is_empty() && message.chars().count() <= 403);
    assert!(!message.chars().any(char::is_control), "{message:?}");
    let Ok(reply) = fuzzing::reply(input) else { return };
    let _ = read_answer(world(), reply.text());
    let text = serde_json::to_string(&reply).unwrap();
    assert_eq!(serde_json::from_str::<llm::ChatReply>(&text).unwrap().judged(), Ok(reply));
}

/// An answer is one action or none; a name of an action alone is that action.
pub(crate) fn answer(input: &[u8]) {
    let Ok(text) = str::from_utf8(input) else { return };
    let world = world();
    if let Ok(action) = read_answer(world, text) {
        assert_eq!(world.action(action.0), Some(action));
    }
    for action in world.action_codes() {
        assert_eq!(read_answer(world, world.action_words(action)), Ok(action));
    }
}

/// An image that is read is written and read back equal.
pub(crate) fn png(input: &[u8]) {
    let Ok(image) = RgbaImage::decode(input) else { return };
    assert_eq!(image.pixels().len() as u64, u64::from(image.width()) * u64::from(image.height()));
    if image.as_bytes().len() > 1 << 20 {
        return;
    }
    let bytes = encode(image.width(), image.height(), Channels::Rgba, image.as_bytes()).unwrap();
    assert_eq!(RgbaImage::decode(&bytes).unwrap(), image);
}

/// A damaged database is set aside, and the cache works.
pub(crate) fn embedding_cache(input: &[u8]) {
    const FINGERPRINT: [u8; 32] = [7; 32];
    with_folder(|folder| {
        // The first byte says where the rest goes into a database that the cache has written.
        let made = database();
        let (&place, rest) = input.split_first().unwrap_or((&255, &[]));
        let at = usize::from(place) * 256 % made.len();
        let content = match place {
            255 => rest.to_vec(),
            _ => {
                let mut content = made.clone();
                for (to, from) in content[at..].iter_mut().zip(rest) {
                    *to ^= from;
                }
                content
            }
        };
        let name = FINGERPRINT.map(|byte| format!("{byte:02x}")).concat();
        fs::write(folder.join(name).with_extension("redb"), content).unwrap();
        let _ = stored(folder, 2);
        let Ok(mut cache) = EmbeddingCache::open(folder, &FINGERPRINT, 2) else { return };
        let embedding = memory_proc::fuzzing::embedding(&[3.0, 4.0]);
        cache.insert([9; 16], embedding.clone()).unwrap();
        assert_eq!(cache.get(&[9; 16]), Some(&embedding));
        let _ = cache.flush();
    });
}

fn database() -> &'static Vec<u8> {
    static DATABASE: OnceLock<Vec<u8>> = OnceLock::new();
    DATABASE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut cache = EmbeddingCache::open(folder.path(), &[7; 32], 2).unwrap();
        for seed in 1..40_u8 {
            let embedding = memory_proc::fuzzing::embedding(&[seed.into(), 1.0]);
            cache.insert([seed; 16], embedding).unwrap();
        }
        cache.flush().unwrap();
        drop(cache);
        let file = fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
        fs::read(file).unwrap()
    })
}

/// A document that is read is written and read back equal.
pub(crate) fn document(input: &[u8]) {
    let Ok(text) = str::from_utf8(input) else { return };
    let Ok(document) = DocumentFile::parse(text) else { return };
    assert!(!document.text.trim().is_empty());
    let text = serde_json::to_string_pretty(&document).unwrap();
    assert_eq!(DocumentFile::parse(&text).unwrap(), document);
}

/// A snapshot is refused, or the memory goes on from it: it saves what it has loaded, and answers.
pub(crate) fn snapshot(input: &[u8]) {
    with_files(&[], &["adaptive.json", "views.f32", "experience.json"], input, |folder| {
        if let Ok(text) = fs::read(folder.join("experience.json")) {
            let lived = memory_proc::fuzzing::experiences(&text);
            for demonstration in lived.into_iter().flatten() {
                assert_eq!(demonstration.states.len(), demonstration.actions.len() + 1);
                let _ = MemoryBank::new([demonstration]);
            }
        }
        let settings = MemorySettings {
            horizon: 6,
            segment: SegmentContent::Actions,
            hits: 1,
            keyframes: 40,
            turns: world().action_codes().filter(|code| world().is_turn(*code)).collect(),
            embeddings: Arc::default(),
            documents: Vec::new(),
        };
        let mut memory = built_in(Representation::Adaptive, &settings);
        memory.build(&[]).unwrap();
        if memory.load(folder).is_err() {
            return;
        }
        let again = folder.join("again");
        fs::create_dir(&again).unwrap();
        memory.save(&again).unwrap();
        let mut loaded = built_in(Representation::Adaptive, &settings);
        loaded.build(&[]).unwrap();
        loaded.load(&again).unwrap();
        let now = Step {
            lane: 0,
            episode: 9,
            step: 1,
            state: Pose::new(3, 1, Heading::N).into(),
            last_action: Some(Action::Forward.into()),
            feedback: Feedback::Moved.into(),
            frame: None,
            embedding: Some(&[0.6, 0.8]),
            pinned: None,
        };
        let query = Query {
            now,
            instruction: "Find a cone.",
            window: &[],
            image_budget: 40,
            text_budget: 100,
        };
        assert_eq!(memory.recall(&query), loaded.recall(&query));
    });
}
