//! What is kept of surfaces from block to block, as long as it is used.

use std::collections::HashMap;
use std::hash::{BuildHasher, Hash};
use std::sync::{Arc, Mutex, PoisonError};

use crate::hash::Words;

/// Maps that share the work of a lock.
const SHARDS: usize = 64;
/// Blocks after which an unused value is dropped: what a moving camera has passed would fill all memory.
const IDLE_BLOCKS: u64 = 8;

/// Values by key, shared by threads.
pub struct Cache<K, T> {
    shards: Vec<Mutex<HashMap<K, Used<T>, Words>>>,
}

struct Used<T> {
    value: Arc<T>,
    /// The block in which it was used last.
    block: u64,
}

impl<K, T> Default for Cache<K, T> {
    fn default() -> Self {
        Self { shards: (0..SHARDS).map(|_| Mutex::default()).collect() }
    }
}

impl<K: Eq + Hash, T> Cache<K, T> {
    /// The value of `key`, used in block number `block`; `make` computes it if it is not known. It must depend on the key alone: if
    /// several threads compute it, all of them get the same.
    pub fn get(&self, key: K, block: u64, make: impl FnOnce(&K) -> T) -> Arc<T> {
        let shard = (Words::default().hash_one(&key) >> 32) as usize % SHARDS;
        let lock = || self.shards[shard].lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(used) = lock().get_mut(&key) {
            used.block = block;
            return Arc::clone(&used.value);
        }
        let value = Arc::new(make(&key));
        lock().insert(key, Used { value: Arc::clone(&value), block });
        value
    }

    /// Before block number `block`: drops what was not used during the last blocks.
    pub fn retain(&mut self, block: u64) {
        for shard in &mut self.shards {
            let map = shard.get_mut().unwrap_or_else(PoisonError::into_inner);
            map.retain(|_, used| used.block + IDLE_BLOCKS >= block);
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
    fn what_is_used_stays_and_all_else_is_dropped() {
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
            cache.retain(block);
            // Some are used in every fourth block.
            assert_eq!((0..5).filter(|key| block % 4 == 0 && !known(&cache, *key, block)).count(), 0);
        }
        let left: usize = cache.shards.iter().map(|shard| shard.lock().unwrap().len()).sum();
        assert_eq!(left, 5);
        assert!(!known(&cache, 7, 30) && !known(&cache, 999, 30) && known(&cache, 4, 30));
    }
}
