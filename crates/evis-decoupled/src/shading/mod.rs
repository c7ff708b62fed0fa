//! What a facet sends to a pixel: response of its material, shadows, and what is kept of both.

pub mod bounds;
pub mod cache;
pub mod light;
pub mod lobes;
pub mod material;
pub mod patch;
pub mod places;
pub mod shadow;
