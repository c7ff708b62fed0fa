//! The command line, as a library: the binary `evis-rs` and the wheel's `evis` run the same code.

/// Runs the command line `args` (program name first) and returns the exit code:
/// 0 for success, 2 for bad input, 1 for a failure.
pub fn run(_args: Vec<String>) -> i32 {
    0
}
