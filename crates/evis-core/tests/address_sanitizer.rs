//! Shows that AddressSanitizer is in force where `make asan` says so.

/// Without it this passes: what lies behind a list of the heap can be read.
#[test]
#[ignore = "`make asan` runs it, and demands that it ends the process"]
fn canary_a_read_past_the_end_ends_the_process() {
    let list = std::hint::black_box(vec![1_u8; 24]);
    // SAFETY: there is none; that is what is to be noticed.
    let behind = unsafe { std::hint::black_box(list.as_ptr()).add(list.len()).read_volatile() };
    std::hint::black_box(behind);
}
