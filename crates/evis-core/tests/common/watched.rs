//! The memory that a test may allocate, and the largest block that it allocated.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The system's allocator, and the largest block that was asked of it.
struct Watched;

pub static LARGEST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: the system's allocator does everything.
unsafe impl GlobalAlloc for Watched {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        LARGEST.fetch_max(size, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.realloc(block, layout, size) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Watched = Watched;

/// Memory that a file may take in these tests.
pub const LIMIT: u64 = 64 << 20;

/// One test at a time: they share the limit and the largest block.
static ALONE: Mutex<()> = Mutex::new(());

/// Runs `test` alone, and checks that it asked for no block beyond the limit.
pub fn within_the_limit(test: impl FnOnce()) {
    let _alone = ALONE.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    evis_core::limits::set_memory_limit(LIMIT);
    LARGEST.store(0, Ordering::Relaxed);
    test();
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest as u64 <= LIMIT, "a block of {largest} bytes was asked for");
}
