//! Matrices as shaders take them.

use glam::DMat4;

/// A scaled parent moves a camera or light but does not stretch what it sees or lights.
pub use evis_scene::rigid_or_unrotated as rigid;

/// Columns in f32.
pub fn columns(m: &DMat4) -> [[f32; 4]; 4] {
    m.as_mat4().to_cols_array_2d()
}

/// First three rows in f32.
pub fn rows(m: &DMat4) -> [[f32; 4]; 3] {
    let t = m.transpose();
    [t.x_axis, t.y_axis, t.z_axis].map(|r| r.as_vec4().to_array())
}
