//! Settings by file: what `tune` writes, and what recordings store.

use std::path::Path;

use evis_core::format::hdf5::Recording;
use evis_render::settings::SettingsFile;

/// The settings in `path`.
pub(crate) fn load(path: &Path) -> anyhow::Result<SettingsFile> {
    let is_recording =
        path.extension().is_some_and(|ending| ["h5", "hdf5"].iter().any(|e| ending.eq_ignore_ascii_case(e)));
    if is_recording {
        let recording = Recording::open(path)?;
        return Ok(SettingsFile::parse(&recording.header().config_toml, &path.display().to_string())?);
    }
    Ok(SettingsFile::read(path)?)
}
