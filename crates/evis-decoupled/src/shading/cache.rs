//! What is kept of surfaces from block to block, as long as it is asked for.

use std::collections::HashMap;
use std::hash::{BuildHasher, Hash};
use std::sync::{Arc, Mutex, PoisonError};

use crate::hash::Words;

/// Maps that share the work of a lock.
const SHARDS: usize = 64;
/// Blocks after which what nobody has asked for is forgotten: what a camera passes would fill all memory.
const IDLE_BLOCKS: u64 = 8;

/// Values that many threads ask for.
pub struct Cache<K, T> {
    shards: Vec<Mutex<HashMap<K, Kept<T>, Words>>>,
}

struct Kept<T> {
    value: Arc<T>,
    /// The block in which it was asked for last.
    block: u64,
}

impl<K, T> Default for Cache<K, T> {
    fn default() -> Self {
        Self { shards: (0..SHARDS).map(|_| Mutex::default()).collect() }
    }
}

impl<K: Eq + Hash, T> Cache<K, T> {
    /// The value of `key`, which is asked for in block number `block`; `make` finds it where it is not known. It depends on the key
    /// alone, so that it does not matter which of several threads finds it.
    pub fn get(&self, key: K, block: u64, make: impl FnOnce(&K) -> T) -> Arc<T> {
        let shard = (Words::default().hash_one(&key) >> 32) as usize % SHARDS;
        let lock = || self.shards[shard].lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kept) = lock().get_mut(&key) {
            kept.block = block;
            return Arc::clone(&kept.value);
        }
        let value = Arc::new(make(&key));
        lock().insert(key, Kept { value: Arc::clone(&value), block });
        value
    }

    /// Before block number `block`: forgets what is not `wanted`, and what was not asked for during the last blocks.
    pub fn retain(&mut self, block: u64, wanted: impl Fn(&K) -> bool) {
        for shard in &mut self.shards {
            let map = shard.get_mut().unwrap_or_else(PoisonError::into_inner);
            map.retain(|key, kept| kept.block + IDLE_BLOCKS >= block && wanted(key));
            if map.len() < map.capacity() / 4 {
                map.shrink_to_fit();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_stays_and_all_else_is_forgotten() {
        let mut cache = Cache::<u32, u32>::default();
        let known = |cache: &Cache<u32, u32>, key: u32, block: u64| {
            let mut known = true;
            let value = cache.get(key, block, |key| {
                known = false;
                10 * key
            });
            assert_eq!(*value, 10 * key);
            known
        };
        for key in 0..1000 {
            assert!(!known(&cache, key, 1));
        }
        for block in 2..30 {
            cache.retain(block, |key| *key != 7);
            // What is asked for in every fourth block.
            assert_eq!((0..5).filter(|key| block % 4 == 0 && !known(&cache, *key, block)).count(), 0);
        }
        let left: usize = cache.shards.iter().map(|shard| shard.lock().unwrap().len()).sum();
        assert_eq!(left, 5);
        assert!(!known(&cache, 7, 30) && !known(&cache, 999, 30) && known(&cache, 4, 30));
    }
}
