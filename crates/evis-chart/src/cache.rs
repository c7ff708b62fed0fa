//! Where truths are kept between charts.

use std::path::PathBuf;

/// The folder for truths in the user's cache: `evis/truth` under what the XDG base directory specification names, or
/// under Windows' `LOCALAPPDATA`. `None` where the system names none. It need not exist.
pub fn user_cache() -> Option<PathBuf> {
    let folder = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let base = if cfg!(windows) {
        folder("LOCALAPPDATA")
    } else {
        // The specification says to ignore a relative path.
        folder("XDG_CACHE_HOME").filter(|f| f.is_absolute()).or_else(|| Some(folder("HOME")?.join(".cache")))
    };
    Some(base?.join("evis").join("truth"))
}
