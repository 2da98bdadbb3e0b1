//! A bounded cache of what was derived from values that never change.

use std::hash::Hash;
use std::sync::Arc;

use rustc_hash::FxHashMap;

/// Keeps up to `LIMIT` values, then starts again. A lost value costs time and changes no decision.
#[derive(Debug)]
pub(super) struct BoundedCache<K, V, const LIMIT: usize>(FxHashMap<K, Arc<V>>);

impl<K, V, const LIMIT: usize> Default for BoundedCache<K, V, LIMIT> {
    fn default() -> Self {
        Self(FxHashMap::default())
    }
}

impl<K: Eq + Hash, V, const LIMIT: usize> BoundedCache<K, V, LIMIT> {
    /// The value for `key`, which `derive` computes if it is not there.
    pub(super) fn get(&mut self, key: K, derive: impl FnOnce() -> V) -> Arc<V> {
        if self.0.len() >= LIMIT && !self.0.contains_key(&key) {
            self.0.clear();
        }
        Arc::clone(self.0.entry(key).or_insert_with(|| Arc::new(derive())))
    }
}
