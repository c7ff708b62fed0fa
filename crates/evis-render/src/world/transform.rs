//! Matrices as shaders take them.

use glam::DMat4;

/// A pose without scale: a scaled parent moves a camera or light but does not stretch what it sees or lights.
pub fn rigid(world_from_node: &DMat4) -> DMat4 {
    // Without axes there is nothing to see or light; any rotation will do.
    evis_scene::rigid(world_from_node)
        .unwrap_or_else(|| DMat4::from_translation(world_from_node.w_axis.truncate()))
}

/// Columns in f32.
pub fn columns(m: &DMat4) -> [[f32; 4]; 4] {
    m.as_mat4().to_cols_array_2d()
}

/// First three rows in f32.
pub fn rows(m: &DMat4) -> [[f32; 4]; 3] {
    let t = m.transpose();
    [t.x_axis, t.y_axis, t.z_axis].map(|r| r.as_vec4().to_array())
}
