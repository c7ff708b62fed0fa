//! A scene as facets: convex planar polygons without holes, and where each tile of pixels looks.

pub(crate) mod contour;
pub mod facets;
pub mod holes;
pub mod screen;
pub mod tiles;
pub mod world;
