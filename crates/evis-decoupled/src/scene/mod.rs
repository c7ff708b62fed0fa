//! A scene as facets: convex planar polygons without holes, and where each tile of pixels looks.

pub(crate) mod contour;
pub mod facets;
pub mod holes;
pub mod screen;
#[cfg(test)]
pub(crate) mod testing;
pub mod tiles;
pub mod world;
