//! Environment maps: orientation, energy, closed forms, and files good and bad.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::f64::consts::{PI, TAU};
use std::io::Write;
use std::path::{Path, PathBuf};

use evis_scene::SceneError;
use evis_scene::environment::{
    CubeMap, Environment, FACES, SPECULAR_LEVELS, brdf_lut, cube_coordinates, cube_direction,
    cube_solid_angle, direction_from_equirect, equirect_from_direction, split_sum,
};
use glam::DVec3;
use half::f16;

/// A file that is gone when the test ends.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str, bytes: &[u8]) -> Self {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-{name}", std::process::id()));
        std::fs::write(&path, bytes).unwrap();
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}

/// Numbers in [0, 1) that are the same in every run.
fn noise(state: &mut u64) -> f64 {
    *state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
    (*state >> 11) as f64 / (1_u64 << 53) as f64
}

fn from_map(width: usize, texel: impl Fn(usize, usize) -> [f32; 3]) -> Environment {
    let texels = (0..width * width / 2).map(|i| texel(i % width, i / width)).collect();
    let mut warnings = Vec::new();
    let environment = Environment::from_equirect("test", width, texels, &mut warnings).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    environment
}

/// Mean radiance over the sphere, with exact solid angles.
fn mean(cube: &CubeMap, level: usize) -> DVec3 {
    let size = cube.level_size(level);
    let mut sum = DVec3::ZERO;
    for (i, texel) in cube.levels[level].iter().enumerate() {
        let (x, y) = (i % size, i / size % size);
        let edge = |k: usize| 2.0 * k as f64 / size as f64 - 1.0;
        let weight = cube_solid_angle([edge(x), edge(x + 1)], [edge(y), edge(y + 1)]);
        sum += DVec3::new(texel[0].to_f64(), texel[1].to_f64(), texel[2].to_f64()) * weight;
    }
    sum / (4.0 * PI)
}

fn map_mean(width: usize, texel: impl Fn(usize, usize) -> [f32; 3]) -> DVec3 {
    let height = width / 2;
    let mut sum = DVec3::ZERO;
    for i in 0..width * height {
        let (x, y) = (i % width, i / width);
        let polar = |y: usize| (y as f64 / height as f64 * PI).cos();
        sum += DVec3::from_array(texel(x, y).map(f64::from)) * (polar(y) - polar(y + 1)) * TAU / width as f64;
    }
    sum / (4.0 * PI)
}

/// The map that most tests use: dim sky over a dark ground, a sun, a coloured window.
fn outdoors(x: usize, y: usize) -> [f32; 3] {
    match (x, y) {
        (37..=38, 20..=21) => [900.0, 800.0, 600.0],
        (80..=95, 25..=40) => [4.0, 6.0, 9.0],
        (_, 0..=31) => [0.6, 0.8, 1.1],
        _ => [0.15, 0.12, 0.1],
    }
}

#[test]
fn faces_follow_the_table_of_webgpu() {
    // Vulkan 1.3, table 29 (WebGPU has the same): s_c, t_c and the major axis of each face.
    let table = |face: usize, d: DVec3| match face {
        0 => (-d.z, -d.y, d.x),
        1 => (d.z, -d.y, -d.x),
        2 => (d.x, d.z, d.y),
        3 => (d.x, -d.z, -d.y),
        4 => (d.x, -d.y, d.z),
        _ => (-d.x, -d.y, -d.z),
    };
    let size = 5;
    let cube = CubeMap { size: size as u32, levels: vec![vec![[f16::ZERO; 4]; FACES * size * size]] };
    for i in 0..FACES * size * size {
        let (face, x, y) = (i / (size * size), i % size, i / size % size);
        let direction = cube.direction(0, face, x, y);
        let (s_c, t_c, major) = table(face, direction);
        assert!(major > 0.0);
        // Texel (x, y) of the stored image has its centre at s = (x + 0.5) / size of [0, 1].
        assert!((0.5 * (s_c / major + 1.0) - (x as f64 + 0.5) / size as f64).abs() < 1e-12, "{face} {x} {y}");
        assert!((0.5 * (t_c / major + 1.0) - (y as f64 + 0.5) / size as f64).abs() < 1e-12, "{face} {x} {y}");
        let (face_back, s, t) = cube_coordinates(direction * 3.7);
        assert_eq!(face_back, face);
        assert!((cube_direction(face, s, t).normalize() - direction).length() < 1e-12);
    }
    // Canary: by the row of its opposite, a face does not even look forwards.
    assert!(table(1, cube.direction(0, 0, 0, 0)).2 < 0.0);
}

#[test]
fn solid_angles_of_a_face_sum_to_a_sixth_of_the_sphere() {
    let edge = |k: usize| 2.0 * k as f64 / 7.0 - 1.0;
    let sum: f64 = (0..49)
        .map(|i| cube_solid_angle([edge(i % 7), edge(i % 7 + 1)], [edge(i / 7), edge(i / 7 + 1)]))
        .sum();
    assert!((sum - 4.0 * PI / 6.0).abs() < 1e-12, "{sum}");
}

#[test]
fn maps_lie_as_in_the_sample_viewer_and_three_js() {
    // u = 0.5 + atan2(z, x) / 2 pi, v = acos(y) / pi.
    for (u, v, direction) in [
        (0.5, 0.5, DVec3::X),
        (0.75, 0.5, DVec3::Z),
        (0.25, 0.5, DVec3::NEG_Z),
        (0.3, 0.0, DVec3::Y),
        (0.3, 1.0, DVec3::NEG_Y),
    ] {
        assert!((direction_from_equirect(u, v) - direction).length() < 1e-12);
        let back = equirect_from_direction(direction * 2.0);
        assert!((back.1 - v).abs() < 1e-12 && (v == 0.0 || v == 1.0 || (back.0 - u).abs() < 1e-12));
    }
    // The same through the whole build: a lamp painted at u = 0.25 shines from -Z, one at the top row from +Y.
    let lamp =
        from_map(64, |x, y| if (14..18).contains(&x) && (14..18).contains(&y) { [9.0; 3] } else { [0.0; 3] });
    assert!(lamp.radiance(DVec3::NEG_Z).x > 8.9);
    assert!(lamp.diffuse(DVec3::NEG_Z).x > 10.0 * lamp.diffuse(DVec3::Z).x);
    assert!(lamp.reflection(DVec3::NEG_Z, 0.4).x > 10.0 * lamp.reflection(DVec3::X, 0.4).x);
    let zenith = from_map(64, |_, y| if y < 4 { [1.0, 2.0, 3.0] } else { [0.0; 3] });
    assert_eq!(zenith.radiance(DVec3::Y), DVec3::new(1.0, 2.0, 3.0));
    assert_eq!(zenith.radiance(DVec3::NEG_Y), DVec3::ZERO);
}

#[test]
fn an_environment_turns_about_the_vertical_with_its_rotation() {
    let mut lamp =
        from_map(64, |x, y| if x.abs_diff(32) < 3 && y.abs_diff(16) < 3 { [4.0; 3] } else { [0.0; 3] });
    assert!(lamp.radiance(DVec3::X).x > 3.9);
    lamp.rotation = std::f32::consts::FRAC_PI_2;
    lamp.intensity = 0.5;
    // A quarter turn about +Y takes +X to -Z.
    assert!((lamp.radiance(DVec3::NEG_Z).x - 2.0).abs() < 0.1);
    assert!(lamp.radiance(DVec3::X).x < 1e-6);
}

#[test]
fn constant_light_stays_exactly_constant() {
    let colour = [0.1, 1.7, 300.0];
    let expected = colour.map(|v: f32| f16::from_f32(v));
    let check = |environment: &Environment| -> bool {
        let cubes = [&environment.sky, &environment.irradiance, &environment.specular];
        cubes.iter().all(|cube| cube.levels.iter().flatten().all(|t| t[..3] == expected && t[3] == f16::ONE))
    };
    // 30 columns divide nothing; 1200 are reduced on the way in.
    for width in [2, 30, 1200] {
        let environment = from_map(width, |_, _| colour);
        assert!(check(&environment), "{width}");
        assert_eq!(environment.specular.levels.len(), SPECULAR_LEVELS);
        assert_eq!(environment.specular.size, 256);
        assert_eq!(environment.irradiance.size, 32);
        for cube in [&environment.sky, &environment.specular, &environment.irradiance] {
            for (level, texels) in cube.levels.iter().enumerate() {
                assert_eq!(texels.len(), FACES * cube.level_size(level).pow(2));
            }
        }
    }
    assert!(check(&Environment::uniform(colour)));
    // Canary: one texel of the map that differs is seen.
    assert!(!check(&from_map(30, |x, y| if (x, y) == (3, 4) { [0.2, 1.7, 300.0] } else { colour })));
}

#[test]
fn one_bright_texel_gives_cosine_shaped_irradiance() {
    let (width, height, x, y, radiance) = (256, 128, 70, 40, 1000.0);
    let environment = from_map(width, |i, j| if (i, j) == (x, y) { [radiance as f32; 3] } else { [0.0; 3] });
    let light = direction_from_equirect((x as f64 + 0.5) / width as f64, (y as f64 + 0.5) / height as f64);
    let edge = |j: usize| (j as f64 / height as f64 * PI).cos();
    let solid_angle = (edge(y) - edge(y + 1)) * TAU / width as f64;
    let closed_form = |normal: DVec3| radiance * solid_angle * normal.dot(light).max(0.0) / PI;
    let peak = closed_form(light);
    let mut worst = 0.0_f64;
    for face in 0..FACES {
        for i in 0..32 * 32 {
            let normal = environment.irradiance.direction(0, face, i % 32, i / 32);
            let found = environment.irradiance.levels[0][(face * 32 + i / 32) * 32 + i % 32][1].to_f64();
            worst = worst.max((found - closed_form(normal)).abs() / peak);
        }
    }
    // Half a unit of the 16-bit float, and the horizon crossing a texel of 1.4 degrees.
    assert!(worst < 1.5e-3, "{worst}");
    // Between texels too, where the cosine is interpolated; 32 texels a face are 3 degrees each.
    for normal in [light, light.cross(DVec3::Y).normalize(), DVec3::Y, -light] {
        assert!((environment.diffuse(normal).x - closed_form(normal)).abs() / peak < 0.01);
    }
    // Canary: with the light a few degrees off, the same comparison fails.
    let off = (light + DVec3::new(0.0, 0.05, 0.0)).normalize();
    let normal = light.cross(DVec3::Z).normalize();
    assert!(
        (radiance * solid_angle * normal.dot(off) / PI - environment.diffuse(normal).x).abs() / peak > 0.01
    );
}

#[test]
fn every_cube_keeps_the_light_of_the_map() {
    let environment = from_map(128, outdoors);
    let truth = map_mean(128, outdoors);
    let error = |found: DVec3| ((found - truth) / truth).abs().max_element();
    for level in 0..environment.sky.levels.len() {
        let error = error(mean(&environment.sky, level));
        assert!(error < 5e-3, "sky level {level}: {error}");
    }
    // Convolution with a normalised kernel keeps the mean over all directions.
    let irradiance = error(mean(&environment.irradiance, 0));
    assert!(irradiance < 1e-3, "{irradiance}");
    for level in 0..SPECULAR_LEVELS {
        let error = error(mean(&environment.specular, level));
        assert!(error < 0.02, "specular level {level}: {error}");
    }
    // Canary: without its sun the map holds visibly less light.
    let cloudy = |x: usize, y: usize| outdoors(x, y).map(|v| v.min(10.0));
    assert!(error(map_mean(128, cloudy)) > 0.05);
}

#[test]
fn large_maps_lose_no_light_when_they_are_reduced() {
    // One texel of a map that is reduced about threefold, off the reduced grid.
    let sun = |x: usize, y: usize| if (x, y) == (1601, 707) { [60000.0; 3] } else { [0.0; 3] };
    let truth = map_mean(3200, sun).x;
    let environment = from_map(3200, sun);
    assert_eq!(environment.sky.size, 512);
    let sky = mean(&environment.sky, 0).x;
    let irradiance = mean(&environment.irradiance, 0).x;
    assert!((sky / truth - 1.0).abs() < 0.02, "{sky} {truth}");
    assert!((irradiance / truth - 1.0).abs() < 0.02, "{irradiance} {truth}");
}

#[test]
fn specular_levels_equal_direct_quadrature() {
    let environment = from_map(128, outdoors);
    let mut worst = [0.0_f64; SPECULAR_LEVELS];
    let mut state = 7;
    let texels: Vec<(DVec3, f64, DVec3)> = (0..128 * 64)
        .flat_map(|i| {
            let (x, y) = (i % 128, i / 128);
            let polar = |y: f64| (y / 64.0 * PI).cos();
            // Each texel in 2x2 parts.
            (0..4).map(move |k| {
                let (x2, y2) = ((2 * x + k % 2) as f64, (2 * y + k / 2) as f64);
                let direction = direction_from_equirect((x2 + 0.5) / 256.0, (y2 + 0.5) / 128.0);
                let solid_angle = (polar(y2 / 2.0) - polar((y2 + 1.0) / 2.0)) * TAU / 256.0;
                (direction, solid_angle, DVec3::from_array(outdoors(x, y).map(f64::from)))
            })
        })
        .collect();
    for (level, worst) in worst.iter_mut().enumerate().skip(2) {
        let roughness = level as f64 / (SPECULAR_LEVELS - 1) as f64;
        let alpha2 = roughness.powi(4);
        for _ in 0..40 {
            let [z, azimuth] = [2.0 * noise(&mut state) - 1.0, TAU * noise(&mut state)];
            let radius = (1.0 - z * z).sqrt();
            let normal = DVec3::new(radius * azimuth.cos(), z, radius * azimuth.sin());
            let (mut sum, mut total) = (DVec3::ZERO, 0.0);
            for &(direction, solid_angle, radiance) in &texels {
                let n_dot_l = normal.dot(direction);
                if n_dot_l > 0.0 {
                    let cos2 = 0.5 * (1.0 + n_dot_l);
                    let d = alpha2 / (PI * (cos2 * (alpha2 - 1.0) + 1.0).powi(2));
                    sum += radiance * (d / 4.0 * n_dot_l * solid_angle);
                    total += d / 4.0 * n_dot_l * solid_angle;
                }
            }
            let truth = sum / total;
            let found = environment.reflection(normal, roughness);
            *worst = worst.max(((found - truth) / truth).abs().max_element());
        }
    }
    println!("worst relative error per level: {worst:?}");
    // The sun is 900 times the sky, and the worst places are those where the lobe's tail just touches it: a single
    // bright texel is the hardest case there is for samples of finite size.
    assert!(worst.iter().all(|e| *e < 0.25), "{worst:?}");
    // Canary: the neighbouring level is not as close.
    let toward_sun = direction_from_equirect(38.0 / 128.0, 21.0 / 64.0);
    let ratio = environment.reflection(toward_sun, 0.4).x / environment.reflection(toward_sun, 0.6).x;
    assert!(ratio > 1.5, "{ratio}");
}

#[test]
fn sampling_is_seamless() {
    let mut state = 3;
    let size = 4_usize;
    let texels = (0..FACES * size * size).map(|_| [f16::from_f64(noise(&mut state)); 4]).collect();
    let cube = CubeMap { size: size as u32, levels: vec![texels] };
    let at = |d: DVec3| f64::from(cube.sample(d, 0.0)[0]);
    let mut worst = 0.0_f64;
    for i in 0..2000 {
        // A point on an edge, or near a corner, and its two sides.
        let (a, b) =
            (2.0 * noise(&mut state) - 1.0, if i % 5 == 0 { 0.999 } else { 2.0 * noise(&mut state) - 1.0 });
        let sign = |v: f64| if v < 0.5 { -1.0 } else { 1.0 };
        let (p, q) = (sign(noise(&mut state)), sign(noise(&mut state)));
        let edge = [DVec3::new(p, q, a), DVec3::new(a, p, q), DVec3::new(p, a, q)][i % 3];
        let step = DVec3::new(1.0, -0.7, 0.3) * b * 1e-7;
        worst = worst.max((at(edge + step) - at(edge - step)).abs());
        // A texel's centre gives the texel.
        let (face, x, y) = (i % 6, i / 6 % size, i / 24 % size);
        let texel = cube.levels[0][(face * size + y) * size + x][0].to_f64();
        assert!((at(cube.direction(0, face, x, y)) - texel).abs() < 1e-6);
    }
    // Along an edge the neighbour's texels are shifted by less than half a texel (resolve), which leaves a step of
    // second order where rows of different slope meet.
    assert!(worst < 1e-5, "{worst}");
    // Canary: clamped at the face's edge, the two sides differ by texels.
    let nearest = |d: DVec3| {
        let (face, s, t) = cube_coordinates(d);
        let index = |c: f64| ((c + 1.0) * 0.5 * size as f64).clamp(0.0, 3.0) as usize;
        cube.levels[0][(face * size + index(t)) * size + index(s)][0].to_f64()
    };
    let step = DVec3::new(1e-7, -1e-7, 0.0);
    assert!(
        (nearest(DVec3::new(1.0, 1.0, 0.1) + step) - nearest(DVec3::new(1.0, 1.0, 0.1) - step)).abs() > 0.01
    );
}

#[test]
fn levels_blend_linearly() {
    let level = |v: f64, n: usize| vec![[f16::from_f64(v); 4]; FACES * n * n];
    let cube = CubeMap { size: 2, levels: vec![level(1.0, 2), level(3.0, 1)] };
    for (at, expected) in [(-1.0, 1.0), (0.0, 1.0), (0.25, 1.5), (1.0, 3.0), (9.0, 3.0), (f64::NAN, 1.0)] {
        assert!((f64::from(cube.sample(DVec3::X, at)[2]) - expected).abs() < 1e-6, "{at}");
    }
}

/// The split sum by plain quadrature over the light's direction.
fn split_sum_by_quadrature(cos_v: f64, roughness: f64) -> [f64; 2] {
    let alpha2 = roughness.powi(4);
    let view = DVec3::new((1.0 - cos_v * cos_v).sqrt(), 0.0, cos_v);
    let (mut scale, mut bias) = (0.0, 0.0);
    let (rings, sectors) = (1500, 700);
    for i in 0..rings {
        // Finer towards the horizon and the pole alike: equal steps of cos theta.
        let cos_l = (f64::from(i) + 0.5) / f64::from(rings);
        let sin_l = (1.0 - cos_l * cos_l).sqrt();
        for j in 0..sectors {
            let azimuth = PI * (f64::from(j) + 0.5) / f64::from(sectors);
            let light = DVec3::new(sin_l * azimuth.cos(), sin_l * azimuth.sin(), cos_l);
            let half = (view + light).normalize();
            let d = alpha2 / (PI * (half.z * half.z * (alpha2 - 1.0) + 1.0).powi(2));
            let visibility = 0.5
                / (cos_l * (cos_v * cos_v * (1.0 - alpha2) + alpha2).sqrt()
                    + cos_v * (cos_l * cos_l * (1.0 - alpha2) + alpha2).sqrt());
            let value = d * visibility * cos_l * 2.0 * PI / f64::from(rings * sectors);
            let fresnel = (1.0 - view.dot(half)).powi(5);
            scale += (1.0 - fresnel) * value;
            bias += fresnel * value;
        }
    }
    [scale, bias]
}

#[test]
fn split_sum_keeps_the_white_furnace_and_known_values() {
    let size = 32;
    let lut = brdf_lut(size);
    assert_eq!(lut.len(), size * size);
    for (i, [scale, bias]) in lut.iter().enumerate() {
        assert!(*scale >= 0.0 && *bias >= 0.0 && scale + bias <= 1.0 + 1e-6, "{i}: {scale} + {bias}");
        assert!(scale + bias > 0.3, "{i}: {scale} + {bias}");
    }
    // A mirror reflects Schlick's Fresnel term itself.
    for cos_v in [0.05, 0.3, 0.9, 1.0] {
        let [scale, bias] = split_sum(cos_v, 0.0, 256);
        let fresnel = (1.0_f64 - cos_v).powi(5);
        assert!((scale - (1.0 - fresnel)).abs() < 1e-9 && (bias - fresnel).abs() < 1e-9, "{cos_v}");
    }
    // The table's rows are roughness, its columns n·v; independent quadrature agrees with both.
    for (x, y) in [(31, 31), (16, 16), (4, 20), (28, 9), (3, 31)] {
        let at = |i: usize| (i as f64 + 0.5) / size as f64;
        let truth = split_sum_by_quadrature(at(x), at(y));
        let found = lut[y * size + x].map(f64::from);
        for c in 0..2 {
            assert!((found[c] - truth[c]).abs() < 1.5e-3, "({x}, {y}): {found:?} {truth:?}");
        }
    }
    // Canary: the transposed entry is another one.
    let truth = split_sum_by_quadrature(4.5 / 32.0, 20.5 / 32.0);
    assert!((f64::from(lut[4 * size + 20][0]) - truth[0]).abs() > 0.05);
}

fn encode_hdr(width: usize, height: usize, texel: impl Fn(usize, usize) -> [f32; 3]) -> Vec<u8> {
    let pixels: Vec<image::Rgb<f32>> =
        (0..width * height).map(|i| image::Rgb(texel(i % width, i / width))).collect();
    let mut bytes = Vec::new();
    image::codecs::hdr::HdrEncoder::new(&mut bytes).encode(&pixels, width, height).unwrap();
    bytes
}

fn encode_exr(width: usize, height: usize, texel: impl Fn(usize, usize) -> [f32; 4]) -> Vec<u8> {
    let raw = (0..width * height).flat_map(|i| texel(i % width, i / width)).collect();
    let picture = image::Rgba32FImage::from_raw(width as u32, height as u32, raw).unwrap();
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::DynamicImage::ImageRgba32F(picture).write_to(&mut bytes, image::ImageFormat::OpenExr).unwrap();
    bytes.into_inner()
}

#[test]
fn radiance_and_openexr_files_come_in_linear() {
    // A red sky of 40, far above 1, over a ground of 0.25; the picture's alpha must not matter.
    let sky = |y: usize| y < 8;
    let hdr = encode_hdr(32, 16, |_, y| if sky(y) { [40.0, 0.5, 0.0] } else { [0.25; 3] });
    let exr = encode_exr(32, 16, |_, y| if sky(y) { [40.0, 0.5, 0.0, 0.0] } else { [0.25, 0.25, 0.25, 1.0] });
    // The other usual first line of a Radiance file.
    let rgbe = [b"#?RGBE".as_slice(), &hdr[b"#?RADIANCE".len()..]].concat();
    for (name, bytes) in [("linear.hdr", &hdr), ("linear.exr", &exr), ("misnamed.exr", &rgbe)] {
        let file = Scratch::new(name, bytes);
        let mut warnings = Vec::new();
        let environment = Environment::load_with_warnings(&file.0, &mut warnings).unwrap();
        assert!(warnings.is_empty(), "{name}: {warnings:?}");
        assert_eq!(environment.radiance(DVec3::Y), DVec3::new(40.0, 0.5, 0.0), "{name}");
        assert_eq!(environment.radiance(DVec3::NEG_Y), DVec3::splat(0.25), "{name}");
        assert!(environment.visible && environment.name.contains(name));
        assert_eq!(Environment::load(&file.0).unwrap(), environment);
    }
}

#[test]
fn unusable_values_are_repaired_and_told() {
    let exr = encode_exr(32, 16, |x, y| match (x, y) {
        (3, 4) => [f32::NAN, 1.0, 1.0, 1.0],
        (5, 4) | (6, 4) => [-2.0, 1.0, 1.0, 1.0],
        (7, 9) => [f32::INFINITY, 1e9, 1.0, 1.0],
        _ => [1.0; 4],
    });
    let file = Scratch::new("repair.exr", &exr);
    let mut warnings = Vec::new();
    let environment = Environment::load_with_warnings(&file.0, &mut warnings).unwrap();
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert!(warnings[0].contains("1 of 512") && warnings[0].contains("not a number"), "{warnings:?}");
    assert!(warnings[1].contains("2 of 512") && warnings[1].contains("negative"), "{warnings:?}");
    assert!(warnings[2].contains("1 of 512") && warnings[2].contains("65504"), "{warnings:?}");
    let all = [&environment.sky, &environment.irradiance, &environment.specular];
    for value in all.iter().flat_map(|c| &c.levels).flatten().flatten() {
        assert!(value.is_finite() && *value >= f16::ZERO);
    }
    let sun = environment.radiance(direction_from_equirect(7.5 / 32.0, 9.5 / 16.0));
    assert!(sun.x > 60000.0 && sun.z < 1.1, "{sun}");
}

#[test]
fn bad_files_are_told_with_a_remedy() {
    let error = |name: &str, bytes: &[u8]| {
        let file = Scratch::new(name, bytes);
        let error = Environment::load(&file.0).unwrap_err();
        assert!(matches!(error, SceneError::Invalid { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains(name), "{text}");
        text
    };
    let missing = Environment::load("no/such/map.hdr").unwrap_err();
    assert!(matches!(missing, SceneError::Io { .. }), "{missing}");
    assert!(missing.to_string().contains("no/such/map.hdr"));

    let square = error("square.hdr", &encode_hdr(16, 16, |_, _| [1.0; 3]));
    assert!(square.contains("16x16") && square.contains("16x8"), "{square}");
    let wide = error("wide.exr", &encode_exr(64, 16, |_, _| [1.0; 4]));
    assert!(wide.contains("64x16") && wide.contains("64x32"), "{wide}");
    assert!(error("empty.hdr", b"").contains("is empty"));
    assert!(error("photo.hdr", b"\x89PNG....").contains("neither"));
    let huge = error("huge.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2000000000 +X 4000000000\n");
    assert!(huge.contains("4000000000") || huge.contains("too large"), "{huge}");
    let xyze = error("xyze.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 8 +X 16\n");
    assert!(xyze.contains("xyze"), "{xyze}");
    // A run of repeat markers whose multiplier overflows in the decoder.
    let markers = [
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n".as_slice(),
        &[9, 9, 9, 128],
        &[1, 1, 1, 0].repeat(20),
    ];
    assert!(error("markers.hdr", &markers.concat()).contains("damaged"));
    let mut warnings = Vec::new();
    let ragged = Environment::from_equirect("ragged", 4, vec![[0.0; 3]; 7], &mut warnings).unwrap_err();
    assert!(ragged.to_string().contains("7 texels"), "{ragged}");
    assert!(Environment::from_equirect("none", 0, Vec::new(), &mut warnings).is_err());
}

#[test]
fn truncated_files_are_refused() {
    let hdr = encode_hdr(16, 8, |x, y| [(x * y) as f32 * 0.1; 3]);
    let exr = encode_exr(16, 8, |x, y| [(x * y) as f32 * 0.1; 4]);
    for (name, bytes) in [("cut.hdr", &hdr), ("cut.exr", &exr)] {
        let step = (bytes.len() / 40).max(1);
        for length in (0..bytes.len()).step_by(step).chain([bytes.len() - 1]) {
            let file = Scratch::new(name, &bytes[..length]);
            assert!(Environment::load(&file.0).is_err(), "{name} cut to {length} of {}", bytes.len());
        }
    }
}

#[test]
fn the_studio_lights_from_above_and_the_front() {
    let studio = Environment::studio();
    let luminance = |d: DVec3| d.dot(DVec3::new(0.2126, 0.7152, 0.0722));
    // A white surface is near the middle of what a display shows, so that a model without lights is well exposed.
    let up = luminance(studio.diffuse(DVec3::Y));
    assert!((0.7..1.3).contains(&up), "{up}");
    assert!(up > 2.0 * luminance(studio.diffuse(DVec3::NEG_Y)));
    let key = luminance(studio.diffuse(DVec3::new(0.8, 0.9, 0.9).normalize()));
    assert!(key > 1.5 * luminance(studio.diffuse(DVec3::NEG_X)), "{key}");
    // Every side gets some light.
    for face in 0..FACES {
        assert!(luminance(studio.diffuse(cube_direction(face, 0.0, 0.0))) > 0.15, "{face}");
    }
    assert_eq!(studio, Environment::studio());
}

/// The faces as a cross: +Y above -X +Z +X -Z above -Y, each as it is stored.
fn cross(cube: &CubeMap, level: usize, exposure: f64) -> image::RgbImage {
    let size = cube.level_size(level);
    let mut picture = image::RgbImage::new(4 * size as u32, 3 * size as u32);
    for (face, column, row) in [(2, 1, 0), (1, 0, 1), (4, 1, 1), (0, 2, 1), (5, 3, 1), (3, 1, 2)] {
        for i in 0..size * size {
            let texel = cube.levels[level][face * size * size + i];
            let byte =
                |v: f16| ((v.to_f64() * exposure).clamp(0.0, 1.0).powf(1.0 / 2.2) * 255.0).round() as u8;
            let (x, y) = (column * size + i % size, row * size + i / size);
            picture.put_pixel(
                x as u32,
                y as u32,
                image::Rgb([byte(texel[0]), byte(texel[1]), byte(texel[2])]),
            );
        }
    }
    picture
}

#[test]
fn real_maps_load() {
    let out = Path::new(env!("CARGO_TARGET_TMPDIR"));
    cross(&Environment::studio().sky, 0, 0.5).save(out.join("studio_cross.png")).unwrap();
    let Some(assets) = std::env::var_os("EVIS_ASSETS") else {
        // Past the capture of the test harness: what did not run must be seen.
        writeln!(
            std::io::stderr(),
            "\nNOT RUN: real_maps_load needs EVIS_ASSETS (the folder that holds environments/)"
        )
        .unwrap();
        return;
    };
    for name in ["empty_warehouse_01_1k.hdr", "venice_sunset_1k.exr"] {
        let path = Path::new(&assets).join("environments").join(name);
        let start = std::time::Instant::now();
        let mut warnings = Vec::new();
        let environment = Environment::load_with_warnings(&path, &mut warnings).unwrap();
        println!("{name}: {} ms, sky {}, {warnings:?}", start.elapsed().as_millis(), environment.sky.size);
        assert_eq!(environment.sky.size, 256);
        // Skies and lit halls are brighter above than below, and their light is kept by every cube.
        assert!(environment.diffuse(DVec3::Y).y > environment.diffuse(DVec3::NEG_Y).y, "{name}");
        let light = mean(&environment.sky, 0);
        assert!(light.min_element() > 0.01, "{light}");
        for level in 0..SPECULAR_LEVELS {
            let error = ((mean(&environment.specular, level) - light) / light).abs().max_element();
            println!("{name}: specular level {level} keeps the light to {error:.4}");
            assert!(error < 0.02, "{name} level {level}: {error}");
        }
        let exposure = 0.25 / light.y;
        cross(&environment.sky, 0, exposure).save(out.join(format!("{name}_cross.png"))).unwrap();
        cross(&environment.specular, 2, exposure).save(out.join(format!("{name}_rough.png"))).unwrap();
        cross(&environment.irradiance, 0, exposure).save(out.join(format!("{name}_irradiance.png"))).unwrap();
    }
}
