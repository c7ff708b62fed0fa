//! The threads that share the parts of a push, in every order of their atomic operations that the memory model allows,
//! with two preemptions (three for those that are short).
//!
//! `crates/evis-core/src/emulator/workers/table.rs` is all synchronisation that is our own: what else crosses threads goes
//! through rayon, channels and `std`'s locks. `make loom` runs this.

#![cfg(test)]

#[allow(dead_code, reason = "evis-core asks for the number of members")]
#[path = "../../crates/evis-core/src/emulator/workers/table.rs"]
mod table;

/// As `crates/evis-core/src/emulator/workers/sync.rs`, by loom.
mod sync {
    pub(super) use loom::sync::atomic::{AtomicBool, AtomicPtr, AtomicUsize, Ordering};
    pub(super) use std::thread::panicking as is_panicking;

    /// Loom has no clock: a helper leaves when it found nothing twice.
    pub(super) struct Backoff(u32);

    impl Backoff {
        pub fn new() -> Self {
            Self(0)
        }

        pub fn spins(&self) -> bool {
            self.0 < 2
        }

        pub fn spin(&mut self) {
            self.0 += 1;
            loom::thread::yield_now();
        }

        pub fn wait(&mut self) {
            loom::thread::yield_now();
        }
    }
}

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;

use loom::cell::UnsafeCell;
use loom::sync::Arc;
use loom::thread::JoinHandle;
use table::Table;

/// Values that loom watches: two threads at one, of which one writes, fail the test unless the one is told of the other.
struct Items(Vec<UnsafeCell<usize>>);

// SAFETY: loom stops at the first access that would be a race.
unsafe impl Sync for Items {}

impl Items {
    fn new(count: usize) -> Self {
        Self((0..count).map(|_| UnsafeCell::new(0)).collect())
    }

    fn add(&self, index: usize) {
        // SAFETY: as above.
        self.0[index].with_mut(|item| unsafe { *item += 1 });
    }

    fn values(&self) -> Vec<usize> {
        // SAFETY: as above.
        self.0.iter().map(|item| item.with(|item| unsafe { *item })).collect()
    }
}

fn explore(preemptions: usize, test: impl Fn() + Sync + Send + 'static) {
    let mut model = loom::model::Builder::new();
    model.preemption_bound = Some(preemptions);
    model.check(test);
}

/// One part: `work` for each of `items`, with helpers that are threads of loom's.
fn part(table: &Arc<Table>, items: usize, work: &(dyn Fn(usize) + Sync), helpers: &mut Vec<JoinHandle<()>>) {
    table.each(items, work, |number| {
        let table = table.clone();
        helpers.push(loom::thread::spawn(move || table.help(number)));
    });
}

/// `parts` parts of `count` items by `members`; every item is done once in each, before the part ends.
fn parts(members: usize, count: usize, parts: usize) {
    let table = Arc::new(Table::new(members));
    let mut helpers = Vec::new();
    let items = Items::new(count);
    for round in 1..=parts {
        // Ends with its part, as what `work` borrows does in a push: who is late reads it while it is written to.
        let borrowed = Items::new(1);
        part(
            &table,
            count,
            &|index| {
                assert_eq!(borrowed.values(), [0]);
                items.add(index);
            },
            &mut helpers,
        );
        borrowed.add(0);
        assert_eq!(items.values(), vec![round; count]);
    }
    for helper in helpers {
        helper.join().unwrap();
    }
}

#[test]
fn two_threads_do_each_item_once() {
    explore(3, || parts(2, 2, 1));
}

#[test]
fn items_beyond_shares_are_done_once() {
    explore(2, || parts(2, 3, 1));
}

#[test]
fn a_helper_of_the_last_part_does_items_of_the_next() {
    explore(2, || parts(2, 2, 2));
}

#[test]
fn three_threads_do_each_item_once() {
    explore(2, || parts(3, 3, 1));
}

#[test]
fn a_part_without_items_ends() {
    explore(3, || parts(2, 0, 2));
}

#[test]
fn a_panic_ends_a_part_when_nobody_works_on_it() {
    explore(2, || {
        let table = Arc::new(Table::new(2));
        let mut helpers = Vec::new();
        let items = Items::new(2);
        let run = catch_unwind(AssertUnwindSafe(|| {
            part(
                &table,
                2,
                &|index| {
                    items.add(index);
                    std::panic::resume_unwind(Box::new("planted"));
                },
                &mut helpers,
            );
        }));
        assert!(run.is_err());
        // Nobody is at them, and none was done twice.
        assert!(items.values().iter().all(|value| *value <= 1));
        for helper in helpers {
            helper.join().unwrap();
        }
    });
}

/// Threads that share items without telling each other: the helper that sees a race in `Items` is seen to work.
#[test]
fn a_race_is_noticed() {
    let race = || {
        let items = Arc::new(Items::new(1));
        let other = items.clone();
        let thread = loom::thread::spawn(move || other.add(0));
        items.add(0);
        thread.join().unwrap();
    };
    assert!(catch_unwind(|| explore(2, race)).is_err());
}

/// Loom tries more than one order: the last of two threads is either.
#[test]
fn every_order_is_tried() {
    static SEEN: Mutex<[bool; 2]> = Mutex::new([false; 2]);
    explore(2, || {
        let last = Arc::new(sync::AtomicUsize::new(0));
        let other = last.clone();
        let thread = loom::thread::spawn(move || other.store(1, sync::Ordering::Release));
        last.store(0, sync::Ordering::Release);
        thread.join().unwrap();
        SEEN.lock().unwrap()[last.load(sync::Ordering::Acquire)] = true;
    });
    assert_eq!(*SEEN.lock().unwrap(), [true; 2]);
}
