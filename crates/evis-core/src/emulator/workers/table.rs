//! How the threads of a pool share the items of a part: who takes which, and when all are done.
//!
//! The package `loom/` includes this file and runs it in every order of its atomic operations, so it names no others than
//! those of `sync`, which is `std`'s here and loom's there.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use super::sync::{AtomicBool, AtomicPtr, AtomicUsize, Backoff, Ordering, is_panicking};

/// What members share.
#[derive(Debug)]
pub(crate) struct Table {
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
        if is_panicking() {
            self.0.panicked.store(true, Ordering::Relaxed);
        }
        self.0.members[self.1].done.fetch_add(1, Ordering::Release);
    }
}

impl Table {
    /// For so many members, of which the first is the thread that calls `each`.
    pub fn new(members: usize) -> Self {
        let members = (0..members).map(|_| Member::default()).collect();
        Self { members, job: AtomicPtr::new(std::ptr::null_mut()), panicked: AtomicBool::new(false) }
    }

    /// Members.
    pub const fn members(&self) -> usize {
        self.members.len()
    }

    /// Does `work` for each number below `items`, once, with those who help; `call` lets another thread [`help`](Self::help)
    /// as that member. One thread at a time may call this.
    pub fn each(&self, items: usize, work: &(dyn Fn(usize) + Sync), mut call: impl FnMut(usize)) {
        let job = Job { work, items };
        self.job.store((&raw const job).cast_mut().cast(), Ordering::Release);
        for member in &self.members {
            member.done.store(0, Ordering::Relaxed);
        }
        for (number, member) in self.members.iter().enumerate() {
            member.left.store(self.share(number, items).len(), Ordering::Release);
        }
        for (number, member) in self.members.iter().enumerate().skip(1).take(items.saturating_sub(1)) {
            if !member.present.swap(true, Ordering::AcqRel) {
                call(number);
            }
        }
        // A panic of this thread's must not end `job` while others look at it.
        let here = catch_unwind(AssertUnwindSafe(|| while self.take(0) {}));
        if here.is_err() {
            // Nobody shall work on what nobody has begun.
            let dropped = self.members.iter().map(|member| member.left.swap(0, Ordering::Relaxed)).sum();
            self.members[0].done.fetch_add(dropped, Ordering::Relaxed);
        }
        let mut backoff = Backoff::new();
        while self.members.iter().map(|member| member.done.load(Ordering::Acquire)).sum::<usize>() < items {
            backoff.wait();
        }
        let panicked = self.panicked.swap(false, Ordering::Relaxed);
        if let Err(panic) = here {
            resume_unwind(panic);
        }
        assert!(!panicked, "a thread that helped with a push panicked");
    }

    /// Works as member `number` until there was nothing to do for a while.
    pub fn help(&self, number: usize) {
        let mut backoff = Backoff::new();
        while backoff.spins() {
            // The thread that pushes reports it.
            match catch_unwind(AssertUnwindSafe(|| self.take(number))) {
                Ok(false) => backoff.spin(),
                _ => backoff = Backoff::new(),
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
