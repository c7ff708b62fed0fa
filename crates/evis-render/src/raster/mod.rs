//! Drawing: luminance layers, geometry for labels and warps, shadow maps.

pub mod context;
pub mod geometry;
pub mod layers;
pub mod luminance;
pub mod readback;
pub mod resample;
pub mod shadow_maps;
pub mod shadows;
