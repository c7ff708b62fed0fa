//! What is fuzzed: each kind of file that is read, as a function of bytes, with a few small files that it takes.
//!
//! `crates/evis-cli/tests/mutated_files.rs` runs them with mutants that are the same in every run, `cargo fuzz` with
//! those that it finds. A target must return, whatever the bytes are, and hand out only what readers promise.

use std::io::{Cursor, Write as _};
use std::path::Path;

use evis_core::emulator::{EmulatorConfig, FrameData, Frames};
use evis_core::event::MOST_T_US;
use evis_core::format::FormatError;
use evis_core::format::hdf5::{self, Recording, RecordingHeader, RecordingWriter};
use evis_core::sensor::Readout;
use evis_core::stats::stats;
use evis_core::{
    CameraInfo, Event, EventEmulator, LabelData, LabelFrame, LabelKind, Polarity, PoseSample, SensorConfig,
    Truth,
};
use evis_format::{AedatImuSample, Format, Frame, Packet, ReadOptions, Trigger, WriteOptions, read_events};
use evis_scene::environment::Environment;
use evis_scene::gltf::Options;
use evis_scene::image::{Transfer, decode};
use evis_scene::{Rig, Scene, SceneState, gltf, picture, toml_scene};
use evis_video::{Clock, FrameSource, SourceConfig, read_times};
use image::{DynamicImage, ImageFormat, Rgb32FImage, RgbaImage};

/// A kind of file.
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// Mutants that a test tries.
    pub mutants: usize,
    /// Words of its files that are worth replacing.
    pub marks: &'static [&'static str],
    /// Small files that it takes; the folder is for what is written on the way.
    pub seeds: fn(&Path) -> Vec<Vec<u8>>,
    /// Reads `bytes`, in a file of the folder where the reader takes a path; whether they were taken.
    pub read: fn(&Path, &[u8]) -> bool,
}

/// All of them.
pub const TARGETS: [Target; 17] = [
    Target {
        name: "gltf",
        mutants: 1800,
        marks: &[
            "5126",
            "5123",
            "\"SCALAR\"",
            "\"VEC3\"",
            "\"count\":3",
            "\"byteLength\"",
            ":0",
            ":1",
            "1.0",
        ],
        seeds: gltf_seeds,
        read: read_gltf,
    },
    Target {
        name: "toml_scene",
        mutants: 1500,
        marks: &["1", "0.5", "[", "]", "'spin'", "180", "256", "[32, 24]", "'sphere'"],
        seeds: toml_seeds,
        read: read_toml,
    },
    Target {
        name: "sensor",
        mutants: 600,
        marks: &["0.2", "0.0", "1.0", "true", "false", "\"crossing\""],
        seeds: sensor_seeds,
        read: read_sensor,
    },
    Target {
        name: "rig",
        mutants: 500,
        marks: &["458.654", "752", "[", "radtan", "pinhole", "0.0", "1.0"],
        seeds: rig_seeds,
        read: read_rig,
    },
    Target {
        name: "trajectory",
        mutants: 800,
        marks: &["0.0", "1.0", "2.0", "0.5", "unit: s"],
        seeds: trajectory_seeds,
        read: read_trajectory,
    },
    Target { name: "picture", mutants: 1000, marks: &[], seeds: picture_seeds, read: read_picture },
    Target {
        name: "environment",
        // Each that is taken is filtered: an eighth of a second.
        mutants: 60,
        marks: &["-Y 8", "+X 16", "FORMAT"],
        seeds: environment_seeds,
        read: read_environment,
    },
    Target {
        name: "events",
        mutants: 1000,
        marks: &["640x480", "640", "480", "EVTS", "<u2", "<i8", "(80,)"],
        seeds: event_seeds,
        read: read_event_file,
    },
    Target {
        name: "raw",
        mutants: 400,
        marks: &["640x480", "640", "480", "EVT3", "EVT2", "% end"],
        seeds: raw_seeds,
        read: read_event_file,
    },
    Target {
        name: "aedat4",
        mutants: 400,
        marks: &["EVTS", "FRME", "IMUS", "TRIG"],
        seeds: aedat4_seeds,
        read: read_event_file,
    },
    Target {
        name: "bag",
        mutants: 500,
        marks: &["evt3", "mono8", "32FC1", "/events", "image_raw", "plumb_bob", "sensor_msgs/msg/Image"],
        seeds: bag_seeds,
        read: read_event_file,
    },
    Target { name: "hdf5", mutants: 400, marks: &[], seeds: hdf5_seeds, read: read_event_file },
    Target {
        name: "numpy",
        mutants: 500,
        marks: &["<u2", "<i8", "(80,)", "t.npy"],
        seeds: numpy_seeds,
        read: read_numpy,
    },
    Target { name: "recording", mutants: 700, marks: &[], seeds: recording_seeds, read: read_recording },
    Target { name: "truth", mutants: 300, marks: &[], seeds: truth_seeds, read: read_truth },
    Target { name: "state", mutants: 600, marks: &[], seeds: state_seeds, read: read_state },
    Target {
        name: "frames",
        mutants: 500,
        marks: &["|u1", "<f4", "(3, 6, 8)", "(2, 6, 8, 3)", "False", "unit: us", "1000"],
        seeds: frame_seeds,
        read: read_frames,
    },
];

/// Puts a new file in the place of `path`. Writing over the old one would wait for the disk each time.
fn file(folder: &Path, name: &str, bytes: &[u8]) -> std::path::PathBuf {
    let path = folder.join(name);
    let _ = std::fs::remove_file(&path);
    std::fs::write(&path, bytes).expect("the folder can be written to");
    path
}

/// What readers of recordings and arrays promise of events.
fn check_events(events: &[Event], (width, height): (u32, u32)) {
    assert!(events.is_sorted_by_key(|event| event.t), "events that go back in time");
    for event in events {
        assert!(u32::from(event.x) < width && u32::from(event.y) < height, "{event:?} in {width}x{height}");
        assert!((0..=1).contains(&event.p), "{event:?}");
        assert!((-MOST_T_US..=MOST_T_US).contains(&event.t), "{event:?}");
    }
}

fn events() -> Vec<Event> {
    let polarity = |i: i64| if i % 3 == 0 { Polarity::Off } else { Polarity::On };
    (0..80).map(|i| Event::new(i * 37, (i * 7 % 40) as u16, (i * 5 % 30) as u16, polarity(i))).collect()
}

/// A scene that was taken is also posed and described.
fn use_scene(scene: &Scene) {
    let mut state = SceneState::default();
    for t_s in [0.0, 0.25, 1e6] {
        scene.evaluate(t_s, &mut state);
    }
}

// glTF

fn gltf_seeds(_: &Path) -> Vec<Vec<u8>> {
    let floats: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let mut binary: Vec<u8> = floats.iter().flat_map(|v| v.to_le_bytes()).collect();
    binary.extend([0_u16, 1, 2, 0].iter().flat_map(|v| v.to_le_bytes()));
    let keys: [f32; 8] = [0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0];
    binary.extend(keys.iter().flat_map(|v| v.to_le_bytes()));
    let at_picture = binary.len();
    let png = encoded(&DynamicImage::ImageRgba8(pixels()), ImageFormat::Png);
    binary.extend(&png);
    binary.resize(binary.len().next_multiple_of(4), 0);
    let json = |buffer: &str| {
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0,2]}}],
"nodes":[{{"name":"root","children":[1],"translation":[0.5,0,0]}},{{"mesh":0,"skin":0}},{{"camera":0,"translation":[0,0,5],
"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}}],
"cameras":[{{"type":"perspective","perspective":{{"yfov":0.8,"znear":0.1}}}}],
"extensionsUsed":["KHR_lights_punctual"],
"extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"spot","intensity":20.0,"spot":{{"innerConeAngle":0.1}}}}]}}}},
"skins":[{{"joints":[0]}}],
"meshes":[{{"weights":[0.25],"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":0}},"indices":1,"material":0,
"targets":[{{"POSITION":4}}]}}]}}],
"materials":[{{"alphaMode":"MASK","pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}],
"textures":[{{"source":0}}],"images":[{{"bufferView":4,"mimeType":"image/png"}}],
"animations":[{{"samplers":[{{"input":2,"output":3}}],"channels":[{{"sampler":0,"target":{{"node":0,"path":"translation"}}}}]}}],
"buffers":[{{{buffer}"byteLength":{}}}],
"bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":6}},
{{"buffer":0,"byteOffset":44,"byteLength":8}},{{"buffer":0,"byteOffset":52,"byteLength":24}},
{{"buffer":0,"byteOffset":{at_picture},"byteLength":{}}}],
"accessors":[{{"bufferView":0,"componentType":5126,"type":"VEC3","count":3}},
{{"bufferView":1,"componentType":5123,"type":"SCALAR","count":3}},
{{"bufferView":2,"componentType":5126,"type":"SCALAR","count":2}},
{{"bufferView":3,"componentType":5126,"type":"VEC3","count":2}},
{{"componentType":5126,"type":"VEC3","count":3,"sparse":{{"count":1,
"indices":{{"bufferView":1,"componentType":5123}},"values":{{"bufferView":0}}}}}}]}}"#,
            binary.len(),
            png.len(),
        )
    };
    let uri: String = base64(&binary);
    let text = json(&format!(r#""uri":"data:application/octet-stream;base64,{uri}","#));
    let mut chunk = json("").into_bytes();
    chunk.resize(chunk.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF".to_vec();
    for word in [2, 12 + 8 + chunk.len() + 8 + binary.len(), chunk.len()] {
        glb.extend((word as u32).to_le_bytes());
    }
    glb.extend(b"JSON");
    glb.extend(&chunk);
    glb.extend((binary.len() as u32).to_le_bytes());
    glb.extend(b"BIN\0");
    glb.extend(&binary);
    vec![glb, text.into_bytes()]
}

/// RFC 4648, section 4.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for part in bytes.chunks(3) {
        let word =
            part.iter().fold(0_u32, |word, byte| word << 8 | u32::from(*byte)) << (8 * (3 - part.len()));
        for k in 0..4 {
            let letter = LETTERS[(word >> (18 - 6 * k)) as usize & 63];
            text.push(if k <= part.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

fn read_gltf(folder: &Path, bytes: &[u8]) -> bool {
    let scene = gltf::read(bytes, folder, &Options::default());
    scene.as_ref().is_ok_and(|scene| {
        use_scene(scene);
        true
    })
}

// Scene files and what they name

const SCENE: &str = r"
name = 'small'
duration_s = 1
background = '#102030'
[[textures]]
name = 't'
pattern = 'checker'
size = 256
[[materials]]
name = 'm'
texture = 't'
roughness = 0.5
model = 'metallic_roughness'
[[primitives]]
name = 'ball'
shape = 'sphere'
radius = 0.5
segments = [8, 4]
material = 'm'
position = [0, 1, 0]
motion = { kind = 'spin', degrees_per_s = 180, axis = [0, 2, 0] }
[[lights]]
name = 'spot'
kind = 'spot'
intensity = 5
inner_degrees = 10
outer_degrees = 20
casts_shadow = true
position = [0, 3, 0]
look_at = [0, 0, 0]
waveform = { shape = 'square', frequency_hz = 50 }
[[cameras]]
name = 'eye'
size = [32, 24]
fov_y_degrees = 45
threshold_on = 0.5
motion = { kind = 'keys', times_s = [0, 1], positions = [[0, 0, 2], [0, 0, 3]] }
[[environments]]
time_offset_s = 0.5
offsets.ball = { position = [0, 0, 1] }
";

fn toml_seeds(_: &Path) -> Vec<Vec<u8>> {
    let other = r"
[[materials]]
name = 'm'
emissive = [1, 2, 3]
[[primitives]]
name = 'wall'
shape = 'box'
size = [1, 1, 0.5]
material = 'm'
motion = { kind = 'chain', motions = [{ kind = 'constant_velocity', velocity = [1, 0, 0] }, { kind = 'spin', degrees_per_s = 180, axis = [0, 1, 0] }] }
[[cameras]]
name = 'c'
size = [32, 24]
fx = 40
distortion = { model = 'fisheye', k1 = 0.01 }
position = [0, 0, 5]
";
    vec![SCENE.into(), other.into()]
}

fn read_toml(folder: &Path, bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    toml_scene::parse(text, folder).is_ok_and(|scene| {
        use_scene(&scene);
        true
    })
}

fn sensor_seeds(_: &Path) -> Vec<Vec<u8>> {
    let names = ["v2e-noisy", "davis346"].map(|name| SensorConfig::preset(name).expect("a preset"));
    names.iter().chain([&SensorConfig::default()]).map(|sensor| sensor.to_toml().into_bytes()).collect()
}

fn read_sensor(_: &Path, bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let Ok(sensor) = SensorConfig::from_toml(text) else { return false };
    let config = EmulatorConfig { width: 8, height: 6, threads: 1, sensor, ..EmulatorConfig::default() };
    let Ok(mut emulator) = EventEmulator::new(config) else { return false };
    for k in 0..3 {
        push(&mut emulator, (8, 6), k, k * 1000);
    }
    true
}

/// Pushes a frame; a time that is too far away is refused as any other one would be.
fn push(emulator: &mut EventEmulator, (width, height): (u32, u32), k: i64, t_us: i64) {
    let light: Vec<f32> =
        (0..width * height).map(|i| 0.2 + ((i64::from(i) * 7 + k * 13) % 11) as f32).collect();
    if let Ok(lists) = emulator.push(&Frames { data: FrameData::Linear(&light), channels: 1 }, t_us) {
        for event in lists.iter().flatten() {
            assert!(u32::from(event.x) < width && u32::from(event.y) < height, "{event:?}");
            assert!((0..=1).contains(&event.p), "{event:?}");
        }
    }
}

fn rig_seeds(_: &Path) -> Vec<Vec<u8>> {
    let kalibr = "\
cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, -0.0003]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.01, -0.02, 0.003, 0.0004]
  distortion_model: equidistant
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
";
    vec![kalibr.into()]
}

fn read_rig(_: &Path, bytes: &[u8]) -> bool {
    std::str::from_utf8(bytes).is_ok_and(|text| Rig::parse(text).is_ok())
}

fn trajectory_seeds(_: &Path) -> Vec<Vec<u8>> {
    let tum = "# unit: s\n0.0 0.0 1.0 2.0 0 0 0 1\n0.5 1.0 1.0 2.0 0 0 0 1\n1.0 2.0 1.0 2.0 0 0 0 1\n";
    vec![tum.into(), tum.replace(' ', ",").replace("#,unit:,", "# unit: ").into()]
}

fn read_trajectory(folder: &Path, bytes: &[u8]) -> bool {
    file(folder, "walk.csv", bytes);
    let mut read = false;
    for more in ["", "time_unit = 'ms', interpolation = 'catmull_rom'"] {
        let motion = format!("motion = {{ kind = 'trajectory', file = 'walk.csv', {more} }}");
        let text = format!(
            "[[materials]]\nname = 'm'\n[[primitives]]\nname = 'b'\nshape = 'sphere'\nradius = 1\nmaterial = 'm'\n\
             [[cameras]]\nname = 'c'\nsize = [8, 8]\nfov_y_degrees = 60\n{}\n",
            motion.replace(", }", " }")
        );
        if let Ok(scene) = toml_scene::parse(&text, folder) {
            use_scene(&scene);
            read = true;
        }
    }
    read
}

// Pictures

fn pixels() -> RgbaImage {
    RgbaImage::from_fn(8, 6, |x, y| image::Rgba([188, (x * 30) as u8, (y * 40) as u8, 255]))
}

fn floats(width: u32, height: u32) -> DynamicImage {
    DynamicImage::ImageRgb32F(Rgb32FImage::from_fn(width, height, |x, y| {
        image::Rgb([0.5, x as f32 * 2.0, y as f32])
    }))
}

fn encoded(image: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).expect("in memory");
    bytes.into_inner()
}

fn picture_seeds(_: &Path) -> Vec<Vec<u8>> {
    let rgba = DynamicImage::ImageRgba8(pixels());
    let rgb = DynamicImage::ImageRgb8(rgba.to_rgb8());
    let deep = DynamicImage::ImageLuma16(rgba.to_luma16());
    vec![
        encoded(&rgba, ImageFormat::Png),
        encoded(&deep, ImageFormat::Png),
        encoded(&rgb, ImageFormat::Jpeg),
        encoded(&rgb, ImageFormat::Tiff),
        encoded(&deep, ImageFormat::Tiff),
        encoded(&floats(8, 6), ImageFormat::OpenExr),
        encoded(&floats(8, 6), ImageFormat::Hdr),
    ]
}

/// As a scene, which is what a user opens, and where the decoders' own panics are caught.
fn read_picture(folder: &Path, bytes: &[u8]) -> bool {
    // PNG and JPEG come as textures too.
    if bytes.starts_with(b"\x89PNG") || bytes.starts_with(b"\xff\xd8") {
        let _ = decode("texture", bytes, Transfer::Srgb);
    }
    let ending = match bytes {
        [0x89, ..] => "png",
        [0xff, ..] => "jpg",
        [0x76, ..] => "exr",
        [b'#', ..] => "hdr",
        _ => "tif",
    };
    let path = file(folder, &format!("picture.{ending}"), bytes);
    picture::load(&path).is_ok_and(|scene| {
        use_scene(&scene);
        true
    })
}

fn environment_seeds(_: &Path) -> Vec<Vec<u8>> {
    vec![encoded(&floats(16, 8), ImageFormat::Hdr), encoded(&floats(16, 8), ImageFormat::OpenExr)]
}

fn read_environment(folder: &Path, bytes: &[u8]) -> bool {
    Environment::load(file(folder, "light.map", bytes)).is_ok()
}

// Events

const SIZE: (u32, u32) = (640, 480);

fn event_file(folder: &Path, format: Format) -> Vec<u8> {
    let path = folder.join(format!("seed-{}", format.name()));
    let mut packet = Packet { events: events(), ..Packet::default() };
    if matches!(format, Format::Aedat4 | Format::Mcap) {
        packet.triggers = vec![Trigger::new(0, 0, true)];
        packet.frames =
            vec![Frame { width: 8, height: 8, channels: 1, pixels: vec![1; 64], ..Frame::default() }];
        packet.imu = vec![AedatImuSample::default(); 3];
    }
    let options = WriteOptions { size: SIZE, overwrite: true };
    let mut writer = evis_format::create(&path, format, &options).expect("a writer");
    writer.write(&packet).expect("written");
    writer.finish().expect("finished");
    std::fs::read(&path).expect("the file that was written")
}

/// Formats with a target of their own.
const APART: [Format; 4] = [Format::Evt3, Format::Evt2, Format::Aedat4, Format::Mcap];

fn event_seeds(folder: &Path) -> Vec<Vec<u8>> {
    let others = Format::BOTH_WAYS.iter().filter(|format| !APART.contains(format));
    others.map(|format| event_file(folder, *format)).collect()
}

fn raw_seeds(folder: &Path) -> Vec<Vec<u8>> {
    vec![event_file(folder, Format::Evt3), event_file(folder, Format::Evt2)]
}

fn aedat4_seeds(folder: &Path) -> Vec<Vec<u8>> {
    vec![event_file(folder, Format::Aedat4)]
}

/// Of events with images and inertial samples, and of a recording with all that it has.
fn bag_seeds(folder: &Path) -> Vec<Vec<u8>> {
    let path = folder.join("seed.h5");
    write_recording(&path);
    let bag = folder.join("seed.mcap");
    let recording = Recording::open(&path).expect("a recording");
    evis_format::export_mcap(&recording, &bag, true, |_| true).expect("exported");
    vec![event_file(folder, Format::Mcap), std::fs::read(&bag).expect("the bag")]
}

/// HDF5 of another program, and a recording as `convert` reads it.
fn hdf5_seeds(folder: &Path) -> Vec<Vec<u8>> {
    let path = folder.join("seed.h5");
    write_recording(&path);
    let dsec = folder.join("seed-dsec");
    let recording = Recording::open(&path).expect("a recording");
    evis_format::export_dsec(&recording, &dsec, true, |_| true).expect("exported");
    let events = dsec.join("events/left/events.h5");
    [path, events].map(|path| std::fs::read(path).expect("what was written")).into()
}

fn read_event_file(folder: &Path, bytes: &[u8]) -> bool {
    // No ending: the content tells the format.
    let path = file(folder, "events", bytes);
    let Ok(mut reader) = evis_format::open(&path, &ReadOptions::default()) else { return false };
    let mut packet = Packet::default();
    let mut whole = true;
    if reader.info().format == Format::Mcap {
        // As `convert` makes a recording of it; what it makes is complete.
        let made = folder.join("made.h5");
        if let Ok(Some(import)) = evis_format::import_mcap(&path, &made, true, |_| true) {
            let recording = Recording::open(&made).expect("a recording");
            let counts =
                (0..import.cameras.len()).map(|camera| recording.event_count(camera).expect("a count"));
            assert_eq!(counts.sum::<u64>(), import.events);
        }
    }
    for seek in [None, Some(1500)] {
        if let Some(t_us) = seek
            && reader.seek(t_us).is_err()
        {
            return false;
        }
        loop {
            match reader.read_packet(&mut packet) {
                Ok(true) => {}
                Ok(false) => break,
                Err(_) => {
                    whole = false;
                    break;
                }
            }
            // Order and size are the file's own; writers check them.
            assert!(packet.events.iter().all(|event| (0..=1).contains(&event.p)), "a polarity that is none");
        }
    }
    whole
}

fn numpy_seeds(folder: &Path) -> Vec<Vec<u8>> {
    vec![event_file(folder, Format::Npy), event_file(folder, Format::Npz)]
}

fn read_numpy(folder: &Path, bytes: &[u8]) -> bool {
    let path = file(folder, if bytes.starts_with(b"PK") { "events.npz" } else { "events.npy" }, bytes);
    read_events(&path, None).is_ok_and(|read| {
        check_events(&read.events, read.size);
        let _ = stats(&read.events, read.size, read.range);
        true
    })
}

// Recordings

fn camera() -> CameraInfo {
    CameraInfo {
        name: "left".into(),
        width: 40,
        height: 30,
        fx: 40.0,
        fy: 40.0,
        cx: 20.0,
        cy: 15.0,
        distortion: None,
    }
}

fn write_recording(path: &Path) {
    let header = RecordingHeader {
        cameras: vec![camera()],
        seed: 3,
        method: "native".into(),
        environment: 0,
        config_toml: "[run]\nreference_luminance = 1.0\n".into(),
        duration_us: Some(10_000),
        t_offset_us: 0,
        labels: vec![LabelKind::Depth],
    };
    let mut writer = RecordingWriter::create(path, &header, true).expect("a writer");
    writer.write_events(0, &events()).expect("events");
    for t_us in [0, 5000] {
        let data = LabelData::F32((0..1200).map(|i| i as f32).collect());
        let frame = LabelFrame { kind: LabelKind::Depth, t_us, t_other_us: t_us, data };
        writer.write_label(0, &frame).expect("a label");
        let pose = PoseSample { t_us, position: [0.0, 1.0, 2.0], rotation: [0.0, 0.0, 0.0, 1.0] };
        writer.write_pose(0, &pose).expect("a pose");
    }
    writer.finish("{\"stream_s\": 0.01}").expect("finished");
}

fn recording_seeds(folder: &Path) -> Vec<Vec<u8>> {
    let path = folder.join("seed-recording.h5");
    write_recording(&path);
    vec![std::fs::read(&path).expect("the recording")]
}

fn read_recording(folder: &Path, bytes: &[u8]) -> bool {
    let path = file(folder, "recording.h5", bytes);
    let read = read_all_of(&path).is_ok();
    let _ = hdf5::check(&path);
    // A repaired file can be read; one that is refused stays as it was.
    match hdf5::repair(&path) {
        Ok(_) => {
            let again = read_all_of(&path);
            assert!(again.is_ok(), "after its repair: {}", again.expect_err("an error"));
        }
        Err(_) => {
            let after = std::fs::read(&path).expect("the file is still there");
            assert!(after == bytes, "a refused repair has changed the file");
        }
    }
    read
}

fn read_all_of(path: &Path) -> Result<(), FormatError> {
    let recording = Recording::open(path)?;
    recording.is_complete()?;
    recording.report()?;
    for (index, camera) in recording.header().cameras.iter().enumerate() {
        check_events(&recording.events(index)?, (camera.width, camera.height));
        recording.events_between(index, 500, 900)?;
        recording.poses(index)?;
        for kind in recording.label_kinds(index)? {
            for k in 0..recording.label_times(index, *kind)?.len() {
                recording.label(index, *kind, k)?;
            }
        }
    }
    Ok(())
}

fn truth_seeds(folder: &Path) -> Vec<Vec<u8>> {
    let path = folder.join("seed-truth.h5");
    let truth = Truth::from_events(events(), camera(), SensorConfig::default(), 1.0, 10_000);
    truth.write(&path, true).expect("written");
    vec![std::fs::read(&path).expect("the truth")]
}

fn read_truth(folder: &Path, bytes: &[u8]) -> bool {
    Truth::load(&file(folder, "truth.h5", bytes), None).is_ok()
}

// States

const STATE_SIZE: (u32, u32) = (12, 8);

/// A sensor of each kind of memory; a state's file begins with the number of its own.
fn sensors() -> [SensorConfig; 4] {
    let bus = Readout { row_ns: 30_000, event_ns: 700, ..Readout::default() };
    let ideal = SensorConfig::default();
    let preset = |name: &str| SensorConfig::preset(name).expect("a preset");
    [ideal.clone(), preset("v2e-noisy"), preset("davis346"), SensorConfig { readout: bus, ..ideal }]
}

fn emulator(sensor: &SensorConfig) -> EventEmulator {
    let (width, height) = STATE_SIZE;
    let sensor = sensor.clone();
    let config = EmulatorConfig { width, height, sensor, threads: 1, ..EmulatorConfig::default() };
    EventEmulator::new(config).expect("settings that work")
}

/// The hash that ends a state, which a mutant must have to be looked at: as in `evis_core::emulator`'s states, and the
/// seeds, which are sealed here, show whether it still is.
fn sealed(content: &[u8]) -> Vec<u8> {
    let (words, rest) = content.as_chunks::<8>();
    let mut last = [0; 8];
    last[..rest.len()].copy_from_slice(rest);
    let hash = words.iter().chain([&last]).fold(0xcbf2_9ce4_8422_2325, |hash: u64, word| {
        (hash ^ u64::from_le_bytes(*word)).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29)
    });
    [content, &hash.to_le_bytes()].concat()
}

fn state_seeds(_: &Path) -> Vec<Vec<u8>> {
    let of = |(number, sensor): (usize, &SensorConfig)| {
        let mut one = emulator(sensor);
        for k in 0..3 {
            push(&mut one, STATE_SIZE, k, k * 1000);
        }
        let state = one.state();
        let mut bytes = vec![number as u8];
        // Without its hash, which is made anew.
        bytes.extend(&state[..state.len() - 8]);
        bytes
    };
    sensors().iter().enumerate().map(of).collect()
}

fn read_state(_: &Path, bytes: &[u8]) -> bool {
    let Some((number, content)) = bytes.split_first() else { return false };
    let mut one = emulator(&sensors()[usize::from(*number) % 4]);
    if one.restore(&sealed(content)).is_err() {
        return false;
    }
    for k in 3..6 {
        let now_us = one.now_us().unwrap_or(0);
        push(&mut one, STATE_SIZE, k, now_us.max(2000) + 1000);
    }
    true
}

// Frames of films

fn stack(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.write_all(data).expect("in memory");
    bytes
}

fn frame_seeds(_: &Path) -> Vec<Vec<u8>> {
    let values: Vec<u8> = (0..288_u16).flat_map(|i| f32::from(i).to_le_bytes()).collect();
    vec![
        stack("|u1", "(3, 6, 8)", &[7; 144]),
        stack("<f4", "(2, 6, 8, 3)", &values),
        b"# unit: us\n0\n1000\n2000\n".to_vec(),
    ]
}

fn read_frames(folder: &Path, bytes: &[u8]) -> bool {
    if !bytes.starts_with(b"\x93") {
        return read_times(&file(folder, "times.txt", bytes)).is_ok();
    }
    let path = file(folder, "stack.npy", bytes);
    let config = SourceConfig { clock: Clock::Rate(100.0), size: Some((8, 6)), ..SourceConfig::new(path) };
    let Ok(mut source) = FrameSource::open(config) else { return false };
    for _ in 0..8 {
        match source.next_frame() {
            Ok(Some(_)) => {}
            Ok(None) => break,
            Err(_) => return false,
        }
    }
    true
}
