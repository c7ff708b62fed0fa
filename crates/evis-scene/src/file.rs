//! Files that users name.

use std::path::Path;

use evis_limits::Budget;

/// Memory that a byte of a text may become: numbers of two characters are values of a tree.
const BYTES_PER_CHARACTER: u64 = 64;

/// The text of a scene file, a sensor or a trajectory.
pub(crate) fn text(path: &Path) -> std::io::Result<String> {
    let budget = Budget::default();
    let text = evis_limits::read_text(path, &budget)?;
    budget.take(text.len() as u64 * BYTES_PER_CHARACTER, "what its text says")?;
    Ok(text)
}
