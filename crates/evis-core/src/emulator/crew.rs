//! Threads that share the parts of a push.
//!
//! A small frame takes a tenth of a millisecond, which waking a thread and being woken by it would take too. So the
//! thread that pushes works itself, and its helpers wait a moment for more without sleeping. Each has a share of the
//! items, the same one in every part, so that tiles stay in its cache; whoever is done takes from others' shares.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicPtr, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rayon::prelude::*;

/// Who works on the items of a part.
#[derive(Clone, Copy)]
pub(crate) enum Hands<'a> {
    /// The calling thread.
    One,
    /// So many threads of the pool that the caller runs in.
    Pool(usize),
    /// The caller and its helpers.
    Crew(&'a Crew),
}

impl Hands<'_> {
    /// Threads, at most.
    pub fn count(self) -> usize {
        match self {
            Self::One => 1,
            Self::Pool(threads) => threads,
            Self::Crew(crew) => crew.table.members.len(),
        }
    }

    /// Does `work` on each of `items`.
    pub fn each<T: Send>(self, items: &mut [T], work: impl Fn(&mut T) + Sync) {
        match self {
            Self::Pool(_) => items.par_iter_mut().for_each(&work),
            Self::Crew(crew) if items.len() > 1 => crew.each(items, work),
            _ => items.iter_mut().for_each(work),
        }
    }
}

/// How long a helper waits for more: less than it takes to wake one.
const LINGER: Duration = Duration::from_micros(20);

/// The thread that owns it, and the threads of a pool.
#[derive(Debug)]
pub(crate) struct Crew {
    pool: rayon::ThreadPool,
    table: Arc<Table>,
}

/// What members share.
#[derive(Debug)]
struct Table {
    members: Vec<Member>,
    /// Lives while members have items and until as many as there are are `done`.
    job: AtomicPtr<Job<'static>>,
    panicked: AtomicBool,
}

/// Alone in its cache lines, which members would otherwise take from each other with every item.
#[derive(Debug, Default)]
#[repr(align(128))]
struct Member {
    /// Items of its share that nobody has taken.
    left: AtomicUsize,
    /// Items that it has done.
    done: AtomicUsize,
    /// Whether it looks for more.
    present: AtomicBool,
}

struct Job<'a> {
    work: &'a (dyn Fn(usize) + Sync),
    items: usize,
}

/// Counts an item of a member's when it is done, and when it panics.
struct Done<'a>(&'a Table, usize);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.panicked.store(true, Ordering::Relaxed);
        }
        self.0.members[self.1].done.fetch_add(1, Ordering::Release);
    }
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

impl Crew {
    /// The caller, whoever that is, and one thread of `pool` less than there are.
    pub fn new(pool: rayon::ThreadPool) -> Self {
        let members = (0..pool.current_num_threads()).map(|_| Member::default()).collect();
        let job = AtomicPtr::new(std::ptr::null_mut());
        let table = Table { members, job, panicked: AtomicBool::new(false) };
        Self { pool, table: Arc::new(table) }
    }

    /// All threads, for work that is not divided into items.
    pub const fn pool(&self) -> &rayon::ThreadPool {
        &self.pool
    }

    /// One thread at a time may call this: an emulator pushes through `&mut`.
    fn each<T: Send>(&self, items: &mut [T], work: impl Fn(&mut T) + Sync) {
        let (table, count, base) = (&*self.table, items.len(), Base(items.as_mut_ptr()));
        // SAFETY: `take` gives each index below `count` to one thread, once.
        let work = |index: usize| work(unsafe { base.item(index) });
        let job = Job { work: &work, items: count };
        table.job.store((&raw const job).cast_mut().cast(), Ordering::Release);
        for member in &table.members {
            member.done.store(0, Ordering::Relaxed);
        }
        for (number, member) in table.members.iter().enumerate() {
            member.left.store(table.share(number, count).len(), Ordering::Release);
        }
        for (number, member) in table.members.iter().enumerate().skip(1).take(count - 1) {
            if !member.present.swap(true, Ordering::AcqRel) {
                let table = self.table.clone();
                self.pool.spawn(move || table.help(number));
            }
        }
        // A panic of this thread's must not end `job` while others look at it.
        let here = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| while table.take(0) {}));
        if here.is_err() {
            // Nobody shall work on what nobody has begun.
            let dropped = table.members.iter().map(|member| member.left.swap(0, Ordering::Relaxed)).sum();
            table.members[0].done.fetch_add(dropped, Ordering::Relaxed);
        }
        let since = Instant::now();
        while table.members.iter().map(|member| member.done.load(Ordering::Acquire)).sum::<usize>() < count {
            if since.elapsed() < LINGER { std::hint::spin_loop() } else { std::thread::yield_now() }
        }
        let panicked = table.panicked.swap(false, Ordering::Relaxed);
        if let Err(panic) = here {
            std::panic::resume_unwind(panic);
        }
        assert!(!panicked, "a thread that helped with a push panicked");
    }
}

impl Table {
    fn help(&self, number: usize) {
        let mut since = Instant::now();
        while since.elapsed() < LINGER {
            // The thread that pushes reports it.
            match std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| self.take(number))) {
                Ok(false) => std::hint::spin_loop(),
                _ => since = Instant::now(),
            }
        }
        self.members[number].present.store(false, Ordering::Release);
    }

    fn share(&self, number: usize, items: usize) -> std::ops::Range<usize> {
        let members = self.members.len();
        number * items / members..(number + 1) * items / members
    }

    /// Takes an item and works on it; whether there was one.
    fn take(&self, number: usize) -> bool {
        let members = self.members.len();
        for owner in (number..members).chain(0..number) {
            let one_less = |left: usize| left.checked_sub(1);
            let taken = self.members[owner].left.fetch_update(Ordering::Acquire, Ordering::Relaxed, one_less);
            let Ok(left) = taken else { continue };
            let _done = Done(self, number);
            // SAFETY: an item was taken and is not done, so `each` has not returned.
            let job = unsafe { &*self.job.load(Ordering::Acquire) };
            (job.work)(self.share(owner, job.items).end - left);
            return true;
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crew(threads: usize) -> Crew {
        Crew::new(rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap())
    }

    #[test]
    fn each_item_is_worked_on_once_in_every_part() {
        for threads in [1, 2, 3, 8] {
            let crew = crew(threads);
            for items in [0, 1, 2, 7, 100] {
                let mut all: Vec<usize> = (0..items).collect();
                for _ in 0..50 {
                    Hands::Crew(&crew).each(&mut all, |item| *item += 1000);
                }
                assert!(all.iter().enumerate().all(|(i, item)| *item == i + 50_000), "{threads} {items}");
            }
        }
    }

    #[test]
    fn a_panic_comes_through_and_the_pool_lives_on() {
        let crew = crew(2);
        for bad in [0, 99] {
            let run = || {
                let mut all: Vec<usize> = (0..100).collect();
                Hands::Crew(&crew).each(&mut all, |item| assert_ne!(*item, bad));
            };
            assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)).is_err());
        }
        let mut all = [1; 10];
        Hands::Crew(&crew).each(&mut all, |item| *item = 2);
        assert_eq!(all, [2; 10]);
    }

    #[test]
    fn helpers_come_back_after_a_pause() {
        let crew = crew(2);
        let me = std::thread::current().id();
        let alone = |crew: &Crew| {
            let mut who = [me; 2];
            let meet = std::sync::Barrier::new(2);
            Hands::Crew(crew).each(&mut who, |who| {
                meet.wait();
                *who = std::thread::current().id();
            });
            who == [me; 2]
        };
        assert!(!alone(&crew));
        std::thread::sleep(10 * LINGER);
        assert!(!alone(&crew));
    }
}
