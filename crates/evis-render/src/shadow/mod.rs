//! What throws shadows, and where: light matrices, shadow volumes, trees and cells for shadow rays.

pub mod bvh;
pub mod light_grid;
pub mod plan;
pub mod volume;
