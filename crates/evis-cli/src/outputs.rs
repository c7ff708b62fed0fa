//! Files to write, refused before any work where they cannot be.

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::failure::bad_input;

/// Refuses the file of `flag` where it would take another one's place: without `force` any, and always those that are
/// `taken`.
pub(crate) fn check_beside(
    flag: &str,
    path: &Path,
    force: bool,
    taken: &[(&str, &Path)],
) -> anyhow::Result<()> {
    check_apart(path, flag, taken)?;
    check_parent(path, flag)?;
    check_unused(path, flag, force)
}

/// Refuses a path that is one of those that are `taken`, under whatever name.
fn check_apart(path: &Path, flag: &str, taken: &[(&str, &Path)]) -> anyhow::Result<()> {
    let place = |path: &Path| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        path.canonicalize().ok().or_else(|| Some(folder.canonicalize().ok()?.join(path.file_name()?)))
    };
    match taken.iter().find(|(_, other)| place(path).is_some_and(|at| place(other) == Some(at))) {
        Some((what, _)) => {
            Err(bad_input(format!("{flag} {}: that is {what}; choose another name", path.display())))
        }
        None => Ok(()),
    }
}

/// Refuses an output that could not be written, before any work.
pub(crate) fn check_output(path: &Path) -> anyhow::Result<()> {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    if !matches!(ending.as_deref(), Some("h5" | "hdf5")) {
        return Err(bad_input(format!(
            "--output {}: recordings are HDF5 files; end the name with .h5 or .hdf5",
            path.display()
        )));
    }
    check_parent(path, "--output")
}

/// Refuses a path whose folder does not exist or does not let us write.
pub(crate) fn check_parent(path: &Path, flag: &str) -> anyhow::Result<()> {
    if path.is_dir() {
        return Err(bad_input(format!("{flag} {}: this is a folder; give a file name", path.display())));
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        return Err(bad_input(format!(
            "{flag} {}: the folder {} does not exist; create it or choose another",
            path.display(),
            folder.display()
        )));
    }
    // Asking the system is the only true answer: permissions, quotas and read-only mounts all have a say.
    let existed = path.exists();
    let probe = OpenOptions::new().write(true).create(true).truncate(false).open(path);
    if let Err(error) = probe {
        return Err(bad_input(format!(
            "{flag} {}: cannot write there ({error}); choose another place or change its permissions",
            path.display()
        )));
    }
    if !existed {
        std::fs::remove_file(path).with_context(|| format!("cannot remove {}", path.display()))?;
    }
    Ok(())
}

pub(crate) fn check_free(path: &Path, force: bool) -> anyhow::Result<()> {
    check_unused(path, "--output", force)
}

fn check_unused(path: &Path, flag: &str, force: bool) -> anyhow::Result<()> {
    if path.exists() && !force {
        return Err(bad_input(format!(
            "{flag} {} exists already; --force overwrites it, or choose another name",
            path.display()
        )));
    }
    Ok(())
}

/// `OUT.h5`, or `OUT_0000.h5`, … where there are several environments.
pub(crate) fn output_paths(output: &Path, environments: usize) -> Vec<PathBuf> {
    if environments == 1 {
        return vec![output.to_path_buf()];
    }
    let part = |p: Option<&std::ffi::OsStr>| p.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let (stem, ending) = (part(output.file_stem()), part(output.extension()));
    (0..environments).map(|k| output.with_file_name(format!("{stem}_{k:04}.{ending}"))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_environments_get_numbered_files() {
        let paths = output_paths(Path::new("out/a.b.h5"), 2);
        assert_eq!(paths, [PathBuf::from("out/a.b_0000.h5"), PathBuf::from("out/a.b_0001.h5")]);
        assert_eq!(output_paths(Path::new("x.h5"), 1), [PathBuf::from("x.h5")]);
    }
}
