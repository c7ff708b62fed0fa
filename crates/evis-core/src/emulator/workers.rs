//! Threads that share the parts of a push.
//!
//! A small frame takes a tenth of a millisecond, which waking a thread and being woken by it would take too. So the
//! thread that pushes works itself, and its helpers wait a moment for more without sleeping. Each has a share of the
//! items, the same one in every part, so that tiles stay in its cache; whoever is done takes from others' shares.

mod sync;
mod table;

use std::sync::Arc;

use rayon::prelude::*;

use table::Table;

/// Who works on the items of a part.
#[derive(Clone, Copy)]
pub(crate) enum Threads<'a> {
    /// The calling thread.
    One,
    /// So many threads of the pool that the caller runs in.
    Pool(usize),
    /// The caller and its helpers.
    Workers(&'a WorkerPool),
}

impl Threads<'_> {
    /// Threads, at most.
    pub fn count(self) -> usize {
        match self {
            Self::One => 1,
            Self::Pool(threads) => threads,
            Self::Workers(workers) => workers.table.members(),
        }
    }

    /// Does `work` on each of `items`.
    pub fn each<T: Send>(self, items: &mut [T], work: impl Fn(&mut T) + Sync) {
        match self {
            Self::Pool(_) => items.par_iter_mut().for_each(&work),
            Self::Workers(workers) if items.len() > 1 => workers.each(items, work),
            _ => items.iter_mut().for_each(work),
        }
    }
}

/// The thread that owns it, and the threads of a pool.
#[derive(Debug)]
pub(crate) struct WorkerPool {
    pool: rayon::ThreadPool,
    table: Arc<Table>,
}

/// Items that need a pointer to cross threads: each is taken by one.
struct Base<T>(*mut T);

// SAFETY: as a `&mut [T]` would be; no two threads take the same item.
unsafe impl<T: Send> Sync for Base<T> {}

impl<T> Base<T> {
    /// # Safety
    /// `index` lies in the slice, and nobody else asks for it.
    #[expect(clippy::mut_from_ref, reason = "each index is asked for once")]
    unsafe fn item(&self, index: usize) -> &mut T {
        // SAFETY: as the caller promises.
        unsafe { &mut *self.0.add(index) }
    }
}

impl WorkerPool {
    /// The caller, whoever that is, and one thread of `pool` less than there are.
    pub fn new(pool: rayon::ThreadPool) -> Self {
        let table = Table::new(pool.current_num_threads());
        Self { pool, table: Arc::new(table) }
    }

    /// All threads, for work that is not divided into items.
    pub const fn pool(&self) -> &rayon::ThreadPool {
        &self.pool
    }

    /// One thread at a time may call this: an emulator pushes through `&mut`.
    fn each<T: Send>(&self, items: &mut [T], work: impl Fn(&mut T) + Sync) {
        let (count, base) = (items.len(), Base(items.as_mut_ptr()));
        // SAFETY: the table gives each index below `count` to one thread, once.
        let work = |index: usize| work(unsafe { base.item(index) });
        self.table.each(count, &work, |number| {
            let table = self.table.clone();
            self.pool.spawn(move || table.help(number));
        });
    }
}

#[cfg(test)]
mod tests {
    use super::sync::LINGER;
    use super::*;

    fn workers(threads: usize) -> WorkerPool {
        WorkerPool::new(rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap())
    }

    #[test]
    fn each_item_is_worked_on_once_in_every_part() {
        for threads in [1, 2, 3, 8] {
            let workers = workers(threads);
            for items in [0, 1, 2, 7, 100] {
                let mut all: Vec<usize> = (0..items).collect();
                for _ in 0..50 {
                    Threads::Workers(&workers).each(&mut all, |item| *item += 1000);
                }
                assert!(all.iter().enumerate().all(|(i, item)| *item == i + 50_000), "{threads} {items}");
            }
        }
    }

    #[test]
    fn a_panic_comes_through_and_the_pool_lives_on() {
        let workers = workers(2);
        for bad in [0, 99] {
            let run = || {
                let mut all: Vec<usize> = (0..100).collect();
                Threads::Workers(&workers).each(&mut all, |item| assert_ne!(*item, bad));
            };
            assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)).is_err());
        }
        let mut all = [1; 10];
        Threads::Workers(&workers).each(&mut all, |item| *item = 2);
        assert_eq!(all, [2; 10]);
    }

    #[test]
    fn helpers_come_back_after_a_pause() {
        let workers = workers(2);
        let me = std::thread::current().id();
        let alone = |workers: &WorkerPool| {
            let mut who = [me; 2];
            let meet = std::sync::Barrier::new(2);
            Threads::Workers(workers).each(&mut who, |who| {
                meet.wait();
                *who = std::thread::current().id();
            });
            who == [me; 2]
        };
        assert!(!alone(&workers));
        std::thread::sleep(10 * LINGER);
        assert!(!alone(&workers));
    }
}
