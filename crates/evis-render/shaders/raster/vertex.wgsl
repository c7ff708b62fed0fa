#import common/frame.wgsl
#import common/object.wgsl
// Vertex stage shared by every pass that draws surfaces. The prelude declares VertexIn, its accessors input_*(),
// Varyings and set_varyings(), so that an attribute that a variant does not use is neither fetched nor interpolated.

override SKINNED: bool = false;
override MORPHED: bool = false;

@group(0) @binding(1) var<storage, read> objects: array<ObjectRecord>;
// Rows of world_from_joint * inverse_bind, three per joint.
@group(0) @binding(2) var<storage, read> joints: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> morph_weights: array<f32>;
// Per target and vertex: position displacement, then normal displacement (xyz each).
@group(0) @binding(4) var<storage, read> morph_data: array<f32>;

struct LocalVertex {
    position: vec3<f32>,
    normal: vec3<f32>,
    // w: the bitangent's sign.
    tangent: vec4<f32>,
};

fn morph_delta(object: ObjectRecord, vertex: u32, part: u32) -> vec3<f32> {
    var sum = vec3<f32>(0.0);
    for (var k = 0u; k < object.morph_target_count; k++) {
        let w = morph_weights[object.morph_weight_base + k];
        let at = object.morph_data_base + ((k * object.morph_vertex_count + vertex) * 2u + part) * 3u;
        sum += w * vec3<f32>(morph_data[at], morph_data[at + 1u], morph_data[at + 2u]);
    }
    return sum;
}

struct JointRows {
    r0: vec4<f32>,
    r1: vec4<f32>,
    r2: vec4<f32>,
};

fn blended_joint(object: ObjectRecord, index: vec4<u32>, weight: vec4<f32>) -> JointRows {
    var rows = JointRows(vec4<f32>(0.0), vec4<f32>(0.0), vec4<f32>(0.0));
    for (var i = 0u; i < 4u; i++) {
        let at = (object.joint_base + index[i]) * 3u;
        rows.r0 += weight[i] * joints[at];
        rows.r1 += weight[i] * joints[at + 1u];
        rows.r2 += weight[i] * joints[at + 2u];
    }
    return rows;
}

// The vertex after morphing and skinning, in the space that the object's record starts from.
// `vertex` is the draw's vertex index; morph_data_base is biased by the primitive's first vertex (wrapping).
fn deform(instance: u32, in: VertexIn, vertex: u32) -> LocalVertex {
    var v = LocalVertex(input_position(in), input_normal(in), input_tangent(in));
    if (MORPHED) {
        let object = objects[instance];
        v.position += morph_delta(object, vertex, 0u);
        v.normal += morph_delta(object, vertex, 1u);
    }
    if (SKINNED) {
        let rows = blended_joint(objects[instance], input_joints(in), input_joint_weights(in));
        let p = vec4<f32>(v.position, 1.0);
        v.position = vec3<f32>(dot(rows.r0, p), dot(rows.r1, p), dot(rows.r2, p));
        v.normal = cofactor_normal(rows.r0.xyz, rows.r1.xyz, rows.r2.xyz, v.normal);
        v.tangent = linear_tangent(rows.r0.xyz, rows.r1.xyz, rows.r2.xyz, v.tangent);
    }
    return v;
}
