// One primitive of one node in one view at one instant.

// Matrices, as per-instance vertex attributes: drivers fetch those once per draw, not once per vertex and lane.
// Twin: gpu/uniforms.rs, InstanceRecord.
struct InstanceRecord {
    clip_from_object: mat4x4<f32>,
    // Rows of world_from_object (identity for skinned objects, whose joints are in world space).
    world_row_0: vec4<f32>,
    world_row_1: vec4<f32>,
    world_row_2: vec4<f32>,
};

// The rest, read where a variant needs it. Twin: gpu/uniforms.rs, ObjectRecord.
struct ObjectRecord {
    joint_base: u32,
    morph_weight_base: u32,
    morph_data_base: u32,
    morph_target_count: u32,
    morph_vertex_count: u32,
    instance_id: u32,
    semantic_id: u32,
    // Factor of the material's emission waveform.
    emission_factor: f32,
    // Of the material, where a host changes it: base colour and metallic, emitted radiance and roughness.
    base_metallic: vec4<f32>,
    emissive_roughness: vec4<f32>,
};

fn world_from_object(object: InstanceRecord, position: vec3<f32>) -> vec3<f32> {
    let p = vec4<f32>(position, 1.0);
    return vec3<f32>(dot(object.world_row_0, p), dot(object.world_row_1, p), dot(object.world_row_2, p));
}

// Normals take the cofactor matrix of the linear part, whose rows are r0, r1, r2: the inverse transpose without the
// division, its sign undone for mirrors, so that what was outside stays outside.
fn cofactor_normal(r0: vec3<f32>, r1: vec3<f32>, r2: vec3<f32>, normal: vec3<f32>) -> vec3<f32> {
    let c0 = cross(r1, r2);
    let n = vec3<f32>(dot(c0, normal), dot(cross(r2, r0), normal), dot(cross(r0, r1), normal));
    return select(n, -n, dot(r0, c0) < 0.0);
}

// glTF 2.0, 3.7.2.1: the bitangent is cross(normal, tangent) * w in the mesh's own space; a mirroring matrix turns
// the cross product of what it makes of the two against it, so w changes sign.
fn linear_tangent(r0: vec3<f32>, r1: vec3<f32>, r2: vec3<f32>, tangent: vec4<f32>) -> vec4<f32> {
    let w = select(tangent.w, -tangent.w, dot(r0, cross(r1, r2)) < 0.0);
    return vec4<f32>(dot(r0, tangent.xyz), dot(r1, tangent.xyz), dot(r2, tangent.xyz), w);
}

// Of unit length at every vertex: else a stretched or morphed one would outweigh its neighbours in between.
fn world_normal(object: InstanceRecord, normal: vec3<f32>) -> vec3<f32> {
    let n = cofactor_normal(object.world_row_0.xyz, object.world_row_1.xyz, object.world_row_2.xyz, normal);
    return n * inverseSqrt(max(dot(n, n), 1e-36));
}

fn world_tangent(object: InstanceRecord, tangent: vec4<f32>) -> vec4<f32> {
    return linear_tangent(object.world_row_0.xyz, object.world_row_1.xyz, object.world_row_2.xyz, tangent);
}
