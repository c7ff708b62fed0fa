// Tiles of a picture, a workgroup each.

// Pixels along a tile's side. Twin: world/tiles.rs.
const TILE: u32 = 16u;

// The number of a workgroup's tile in a dispatch of `row` workgroups per row; there may be more than tiles.
fn tile_number(group: vec3<u32>, row: u32) -> u32 {
    return group.y * row + group.x;
}
