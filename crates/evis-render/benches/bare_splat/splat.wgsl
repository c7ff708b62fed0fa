// A softmax splat with four bilinear taps, as one would write it first.

struct Params {
    width: u32,
    height: u32,
    moved: f32,
    sharpness: f32,
};

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> sources: array<vec4<f32>>;
// Largest depth, weight, light.
@group(0) @binding(2) var<storage, read_write> sums: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> other: array<u32>;
@group(0) @binding(4) var<storage, read_write> luminance: array<f32>;

struct Taps {
    base: vec2<i32>,
    weight: vec4<f32>,
};

fn taps(id: vec2<u32>, source: vec4<f32>) -> Taps {
    let p = vec2<f32>(id) + source.zw * params.moved;
    let base = floor(p);
    let f = p - base;
    let g = 1.0 - f;
    return Taps(vec2<i32>(base), vec4<f32>(g.x * g.y, f.x * g.y, g.x * f.y, f.x * f.y));
}

fn at(t: Taps, i: u32) -> u32 {
    let p = t.base + vec2<i32>(i32(i & 1u), i32(i >> 1u));
    if (p.x < 0 || p.y < 0 || p.x >= i32(params.width) || p.y >= i32(params.height)) {
        return 0xffffffffu;
    }
    return u32(p.y) * params.width + u32(p.x);
}

@compute @workgroup_size(64)
fn depth(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.width) {
        return;
    }
    let source = sources[id.y * params.width + id.x];
    let t = taps(id.xy, source);
    for (var i = 0u; i < 4u; i++) {
        let p = at(t, i);
        if (p != 0xffffffffu) {
            atomicMax(&sums[p], bitcast<u32>(source.y));
        }
    }
}

@compute @workgroup_size(64)
fn add(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.width) {
        return;
    }
    let plane = params.width * params.height;
    let source = sources[id.y * params.width + id.x];
    let t = taps(id.xy, source);
    for (var i = 0u; i < 4u; i++) {
        let p = at(t, i);
        if (p != 0xffffffffu) {
            let front = bitcast<f32>(atomicLoad(&sums[p]));
            let weight = t.weight[i] * exp((source.y - front) * params.sharpness);
            atomicAdd(&sums[plane + p], u32(weight * 4096.0 + 0.5));
            atomicAdd(&sums[2u * plane + p], u32(weight * source.x * 65536.0 + 0.5));
        }
    }
}

@compute @workgroup_size(64)
fn choose(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= params.width) {
        return;
    }
    let plane = params.width * params.height;
    let p = id.y * params.width + id.x;
    var weight = atomicLoad(&sums[plane + p]);
    var light = atomicLoad(&sums[2u * plane + p]);
    if (weight == 0u) {
        weight = other[plane + p];
        light = other[2u * plane + p];
    }
    luminance[p] = f32(light) / f32(max(weight, 1u)) / 16.0;
}
