//! What pictures say: textures over footprints, maps of materials at a place, light from all around.

pub mod environment;
pub mod maps;
pub mod texture;
