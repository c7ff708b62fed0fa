//! WGSL sources and their `#import`s: each file is pasted once, before the first file that asks for it.

use std::collections::HashSet;

macro_rules! shaders {
    ($($name:literal),* $(,)?) => {
        /// Every shader file, by its path under `shaders/`.
        pub const FILES: &[(&str, &str)] =
            &[$(($name, include_str!(concat!("../../shaders/", $name)))),*];
    };
}

shaders![
    "common/ray.wgsl",
    "common/coverage.wgsl",
    "common/mean.wgsl",
    "common/tile.wgsl",
    "common/frame.wgsl",
    "common/object.wgsl",
    "common/luminance.wgsl",
    "common/sky_vertex.wgsl",
    "common/triangle.wgsl",
    "common/unknown.wgsl",
    "raster/vertex.wgsl",
    "raster/stage.wgsl",
    "raster/material.wgsl",
    "raster/lighting.wgsl",
    "raster/brdf.wgsl",
    "raster/occluders.wgsl",
    "raster/shadow.wgsl",
    "raster/environment.wgsl",
    "raster/surface.wgsl",
    "raster/luminance.wgsl",
    "raster/sky.wgsl",
    "raster/background.wgsl",
    "raster/shadow_map.wgsl",
    "raster/shadow_restore.wgsl",
    "resample/footprint.wgsl",
    "resample/samples.wgsl",
    "resample/coverage.wgsl",
    "labels/geometry.wgsl",
    "labels/appearance.wgsl",
    "labels/sky.wgsl",
    "splat/layout.wgsl",
    "splat/prepare.wgsl",
    "splat/place.wgsl",
    "splat/holes.wgsl",
    "splat/accumulate.wgsl",
    "splat/index.wgsl",
    "splat/resolve.wgsl",
    "splat/show.wgsl",
    "trigger/layout.wgsl",
    "trigger/decide.wgsl",
    "trigger/sample.wgsl",
    "trigger/count.wgsl",
    "trigger/block.wgsl",
    "trigger/scan.wgsl",
    "trigger/emit.wgsl",
    "trigger/visit.wgsl",
    "trigger/dense.wgsl",
    "trigger/emit_dense.wgsl",
    "trigger/resolve.wgsl",
    "trigger/tile_rate.wgsl",
    "trigger/between.wgsl",
    "adaptive/tiles.wgsl",
    "adaptive/mean.wgsl",
    "adaptive/resolve.wgsl",
    "adaptive/audit.wgsl",
    "chain/philox.wgsl",
    "chain/arithmetic.wgsl",
    "chain/layout.wgsl",
    "chain/state.wgsl",
    "chain/own_times.wgsl",
    "chain/response.wgsl",
    "chain/shape.wgsl",
    "chain/pixel.wgsl",
    "chain/leak.wgsl",
    "chain/walk.wgsl",
    "chain/begin.wgsl",
    "chain/places.wgsl",
    "chain/emit.wgsl",
    "chain/dense.wgsl",
    "decoupled/layout.wgsl",
    "decoupled/regions.wgsl",
    "decoupled/fragments.wgsl",
    "decoupled/texture.wgsl",
    "decoupled/shadows.wgsl",
    "decoupled/sky.wgsl",
    "decoupled/lit.wgsl",
    "decoupled/maps.wgsl",
    "decoupled/light.wgsl",
    "decoupled/knots.wgsl",
    "decoupled/prepare.wgsl",
    "decoupled/list.wgsl",
    "decoupled/pixels.wgsl",
];

/// The text of one file.
fn file(name: &str) -> &'static str {
    FILES
        .iter()
        .find(|(n, _)| *n == name)
        .map(|(_, text)| *text)
        .unwrap_or_else(|| panic!("no shader file {name}: a pass names a file that is not in the list"))
}

/// `prelude` (generated declarations, may be empty), then `name` with its imports, each file once.
pub fn compose(name: &str, prelude: &str) -> String {
    let mut out = String::from(prelude);
    let mut seen = HashSet::new();
    paste(name, &mut seen, &mut out);
    out
}

fn paste(name: &str, seen: &mut HashSet<String>, out: &mut String) {
    if !seen.insert(name.to_owned()) {
        return;
    }
    let text = file(name);
    for import in imports(text) {
        paste(import, seen, out);
    }
    for line in text.lines().filter(|l| !l.starts_with("#import ")) {
        out.push_str(line);
        out.push('\n');
    }
}

/// The files that `text` asks for.
pub fn imports(text: &str) -> impl Iterator<Item = &str> {
    text.lines().filter_map(|line| line.strip_prefix("#import ")).map(str::trim)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_pasted_once() {
        let text = compose("trigger/emit.wgsl", "");
        assert_eq!(text.matches("fn decide(").count(), 1);
        assert!(!text.contains("#import"));
    }
}
