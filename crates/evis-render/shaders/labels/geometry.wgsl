#import common/frame.wgsl
#import raster/vertex.wgsl
#import raster/material.wgsl
// Geometry labels, one sample at the pixel's centre: inverse depth, flow to the next and the last label, ids.

// Distance in `objects` between the records of this instant and the next, and between the next and the last.
struct LabelFrame {
    next_offset: u32,
    last_offset: u32,
    // Pixels per unit of ndc: width / 2, height / 2.
    half_size: vec2<f32>,
};

@group(3) @binding(0) var<uniform> label: LabelFrame;
@group(3) @binding(1) var<storage, read> instances: array<InstanceRecord>;

// Written where a flow is not defined: the point lies behind the other camera.
const NO_FLOW: vec2<f32> = vec2<f32>(1e30, 1e30);

struct GeometryVaryings {
    @builtin(position) position: vec4<f32>,
    @location(8) here: vec4<f32>,
    @location(9) next: vec4<f32>,
    @location(10) last: vec4<f32>,
    @location(11) @interpolate(flat) ids: vec2<u32>,
    @location(12) uv: vec4<f32>,
    @location(13) alpha: f32,
};

struct GeometryOut {
    @location(0) inverse_depth: f32,
    @location(1) flow: vec4<f32>,
    @location(2) ids: vec2<u32>,
};

// Clip position at another label. What is scaled to nothing is not seen there: it is as behind the camera.
fn other_clip(object: InstanceRecord, position: vec3<f32>) -> vec4<f32> {
    let clip = object.clip_from_object;
    let none = vec4<f32>(0.0);
    if (all(clip[0] == none) && all(clip[1] == none) && all(clip[2] == none)) {
        return vec4<f32>(0.0, 0.0, 0.0, -1.0);
    }
    return clip * vec4<f32>(position, 1.0);
}

@vertex
fn vs_main(in: VertexIn, @builtin(instance_index) instance: u32, @builtin(vertex_index) vertex: u32) -> GeometryVaryings {
    let next = instance + label.next_offset;
    let last = instance + label.last_offset;
    var out: GeometryVaryings;
    out.here = input_clip(in) * vec4<f32>(deform(instance, in, vertex).position, 1.0);
    out.position = out.here;
    out.next = other_clip(instances[next], deform(next, in, vertex).position);
    out.last = other_clip(instances[last], deform(last, in, vertex).position);
    out.ids = vec2<u32>(objects[instance].instance_id, objects[instance].semantic_id);
    out.uv = vec4<f32>(input_uv0(in), input_uv1(in));
    out.alpha = input_color(in).a;
    return out;
}

// Displacement in pixels, x right and y down, from clip position `a` to clip position `b`.
fn flow_pixels(a: vec4<f32>, b: vec4<f32>) -> vec2<f32> {
    if (b.w <= 0.0 || a.w <= 0.0) {
        return NO_FLOW;
    }
    let d = b.xy / b.w - a.xy / a.w;
    return vec2<f32>(d.x, -d.y) * label.half_size;
}

@fragment
fn fs_main(v: GeometryVaryings) -> GeometryOut {
    if (ALPHA_MASK) {
        var alpha = material.base_color.a * v.alpha;
        if (HAS_BASE_TEXTURE) {
            let row0 = material.uv_rows[0];
            let row1 = material.uv_rows[1];
            let uv = vec3<f32>(select(v.uv.xy, v.uv.zw, row0.w > 0.5), 1.0);
            alpha *= textureSample(base_texture, base_sampler, vec2<f32>(dot(row0.xyz, uv), dot(row1.xyz, uv))).a;
        }
        if (alpha < material.emissive.w) {
            discard;
        }
    }
    return GeometryOut(
        inverse_depth(v.position),
        vec4<f32>(flow_pixels(v.here, v.next), flow_pixels(v.here, v.last)),
        v.ids);
}
