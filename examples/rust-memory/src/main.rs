//! A memory of your own in Rust. Build it, and let MemTransfer start it:
//!
//! ```sh
//! cargo build --release
//! memtransfer run --memory working,episodic \
//!     --memory-cmd examples/rust-memory/target/release/rust-memory
//! ```

use peer::memory::{
    Demonstration, MemoryItem, Memory, MemoryDescription, MemoryError, Method, Query, Source, Views,
    serve_from_environment,
};

/// Steps of a segment.
const STEPS: u32 = 6;

/// Supplies how the most similar remembered view goes on, and which task it is from.
#[derive(Default)]
struct Nearest {
    demonstrations: Vec<Remembered>,
}

struct Remembered {
    instruction: String,
    /// An embedding for each step.
    embeddings: Vec<Vec<f32>>,
}

impl Memory for Nearest {
    // Called once, with the demonstrations that the episodes of this bank remember.
    fn build(&mut self, demonstrations: &[Demonstration<'_>]) -> Result<(), MemoryError> {
        let remembered = demonstrations.iter().map(|demonstration| Remembered {
            instruction: demonstration.instruction.to_owned(),
            embeddings: (0..demonstration.steps.len())
                .filter_map(|step| demonstration.embedding(step).map(<[f32]>::to_vec))
                .collect(),
        });
        self.demonstrations = remembered.collect();
        Ok(())
    }

    // Called at every step. Items name steps by number: the run looks up their views and actions.
    fn recall(&mut self, query: &Query<'_>) -> Result<Vec<MemoryItem>, MemoryError> {
        let now = query.now.embedding.ok_or_else(|| MemoryError::new("no embedding"))?;
        let views = self.demonstrations.iter().zip(0..).flat_map(|(remembered, number)| {
            remembered.embeddings.iter().zip(0..).map(move |(view, step)| {
                let similarity: f32 = view.iter().zip(now).map(|(a, b)| a * b).sum();
                (1.0 - similarity, number, step)
            })
        });
        // Equal distances: the first one, so that the same query gets the same answer.
        let Some((distance, number, first)) = views.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return Ok(Vec::new());
        };
        let Remembered { instruction, embeddings } = &self.demonstrations[number as usize];
        let left = embeddings.len() as u32 - first;
        let source = Source { demonstration: number, first, count: left.min(STEPS) };
        // What does not fit into a budget is dropped whole, so the views are left out instead.
        let views = match source.count <= query.image_budget {
            true => Views::All,
            false => Views::None,
        };
        let mut items = vec![MemoryItem::Steps { source, views, actions: true, distance: Some(distance) }];
        let text = format!("From a demonstration of: {instruction}");
        if text.len() <= query.text_budget as usize {
            items.push(MemoryItem::Text { text: text.into(), sources: vec![source] });
        }
        Ok(items)
    }

    fn store_bytes(&self) -> Option<u64> {
        let numbers = self.demonstrations.iter().flat_map(|remembered| &remembered.embeddings);
        Some(numbers.map(|embedding| 4 * embedding.len() as u64).sum())
    }
}

fn main() {
    let description = MemoryDescription {
        name: "nearest".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        embeddings: true,
        deterministic: true,
        ..MemoryDescription::default()
    };
    // Describes itself in $MEMTRANSFER_ATTACH, joins the run, and answers until it is over.
    if let Err(error) = serve_from_environment(&Method::new(description, Nearest::default)) {
        eprintln!("rust-memory: {error}");
        std::process::exit(2);
    }
}
