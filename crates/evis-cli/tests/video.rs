//! Frames from elsewhere: folders, arrays and films become recordings.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use common::{Folder, code, evis, json, program, stderr};
use evis_core::format::hdf5::Recording;
use evis_core::{EmulatorConfig, Event, EventEmulator, FrameData, Frames, SensorConfig, Transfer};
use image::{DynamicImage, ImageBuffer};

const WIDTH: u32 = 16;
const HEIGHT: u32 = 12;

/// Frame `k` of a pattern that drifts.
fn codes(k: u32) -> Vec<u8> {
    let wave = |x: u32| 127.0 + 100.0 * (0.3 + 0.9 * f64::from(x) - 0.4 * f64::from(k)).sin();
    (0..WIDTH * HEIGHT).map(|i| wave(i % WIDTH) as u8).collect()
}

fn save_png(folder: &Path, name: &str, k: u32) {
    let image = ImageBuffer::from_raw(WIDTH, HEIGHT, codes(k)).unwrap();
    DynamicImage::ImageLuma8(image).save(folder.join(name)).unwrap();
}

/// A `.npy` file of `frames` frames; `bytes` are the elements.
fn npy(path: &Path, descr: &str, frames: u32, bytes: &[u8]) {
    let mut header =
        format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({frames}, {HEIGHT}, {WIDTH}), }}");
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut file = std::fs::File::create(path).unwrap();
    file.write_all(b"\x93NUMPY\x01\x00").unwrap();
    file.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
    file.write_all(header.as_bytes()).unwrap();
    file.write_all(bytes).unwrap();
}

/// What the emulator makes of the pattern at these times.
fn expected(sensor: SensorConfig, seed: u64, transfer: Transfer, times_us: &[i64]) -> Vec<Event> {
    let config = EmulatorConfig { width: WIDTH, height: HEIGHT, seed, sensor, ..EmulatorConfig::default() };
    let mut emulator = EventEmulator::new(config).unwrap();
    let frames = times_us.iter().zip(0..).flat_map(|(t_us, k)| {
        let codes = codes(k);
        let frame = Frames { data: FrameData::U8(&codes, transfer), channels: 1 };
        emulator.push(&frame, *t_us).unwrap().remove(0)
    });
    frames.collect()
}

fn events(folder: &Folder, name: &str) -> Vec<Event> {
    let recording = Recording::open(&folder.file(name)).unwrap();
    assert!(recording.is_complete().unwrap());
    recording.events(0).unwrap()
}

#[test]
fn a_folder_of_pictures_becomes_events_at_its_own_times() {
    let folder = Folder::new("video-folder");
    let frames = folder.file("frames");
    std::fs::create_dir(&frames).unwrap();
    // Names without leading zeros: their numbers say the order.
    (0..12).for_each(|k| save_png(&frames, &format!("f{k}.png"), k));
    let times: Vec<i64> = (0..12).map(|k| 1000 * k * k + 777 * k).collect();
    let list: Vec<_> = times.iter().map(|t| format!("{}", t + 5_000_000)).collect();
    std::fs::write(frames.join("timestamps.txt"), format!("# unit: us\n{}\n", list.join("\n"))).unwrap();

    let output = evis(&folder, "video frames -o a.h5 --sensor v2e-noisy --seed 7 --json --report r.json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    assert_eq!((&report["frames"], &report["offset_us"]), (&12.into(), &5_000_000.into()));
    let sensor = SensorConfig::preset("v2e-noisy").unwrap();
    let want = expected(sensor.clone(), 7, Transfer::Srgb, &times);
    assert!(want.len() > 1000);
    assert_eq!(events(&folder, "a.h5"), want);
    let even: Vec<i64> = (0..12).map(|k| 10_000 * k).collect();
    assert_ne!(expected(sensor, 7, Transfer::Srgb, &even), want, "canary: times matter");

    let info = json(&evis(&folder, "info a.h5 --json"));
    let stored = info["settings_toml"].as_str().unwrap();
    assert!(stored.contains("kind = \"folder\"") && stored.contains("leak_hz"), "{stored}");

    // A second, and the frames between 20 and 60 ms after the first.
    let output =
        evis(&folder, "video frames -o b.h5 --start 0.02 --duration 0.04 --transfer gamma:2.2 --json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let used = times.iter().filter(|t| (20_000..=60_000).contains(*t)).count();
    assert_eq!(json(&output)["frames"], used, "canary: of {}", times.len());
}

#[test]
fn arrays_give_the_same_events_in_every_dtype() {
    let folder = Folder::new("video-npy");
    let all: Vec<u8> = (0..8).flat_map(codes).collect();
    npy(&folder.file("a.npy"), "|u1", 8, &all);
    let wide: Vec<u8> = all.iter().flat_map(|v| (u16::from(*v) * 257).to_be_bytes()).collect();
    npy(&folder.file("b.npy"), ">u2", 8, &wide);
    let light: Vec<u8> =
        all.iter().flat_map(|v| (Transfer::Srgb.light(f64::from(*v) / 255.0) as f32).to_le_bytes()).collect();
    npy(&folder.file("c.npy"), "<f4", 8, &light);
    let times: Vec<i64> = (0..8).map(|k| k * 1000).collect();
    let want = expected(SensorConfig::default(), 0, Transfer::Srgb, &times);
    assert!(want.len() > 500);
    for name in ["a", "b", "c"] {
        let output = evis(&folder, &format!("video {name}.npy -o {name}.h5 --fps 1000"));
        assert_eq!(code(&output), 0, "{name}: {}", stderr(&output));
        assert_eq!(events(&folder, &format!("{name}.h5")), want, "{name}");
    }
    let output = evis(&folder, "video a.npy -o l.h5 --fps 1000 --transfer linear --size 8x6 --json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(json(&output)["width"], 8);
    assert_ne!(events(&folder, "l.h5"), want, "canary: another curve and size give other events");
}

#[test]
fn several_formats_hold_the_same_events() {
    let folder = Folder::new("video-formats");
    let all: Vec<u8> = (0..8).flat_map(codes).collect();
    npy(&folder.file("a.npy"), "|u1", 8, &all);
    let output = evis(&folder, "video a.npy -o a.h5 -o a.raw -o a.txt --fps 1000");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let count = events(&folder, "a.h5").len() as u64;
    assert!(count > 500);
    for name in ["a.raw", "a.txt"] {
        assert_eq!(json(&evis(&folder, &format!("info {name} --json")))["events"], count, "{name}");
    }
    // Without an HDF5 file among them none is left.
    let output = evis(&folder, "video a.npy -o b.aedat4 --fps 1000");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(folder.names(), ["a.h5", "a.npy", "a.raw", "a.txt", "b.aedat4"]);
    for (line, words) in [
        ("video a.npy -o c.h5 -o c.h5 --fps 1000", "given twice"),
        ("video a.npy -o c.h5 -o d.h5 --fps 1000", "a recording already"),
        ("video a.npy -o c.h5 -o c.xyz --fps 1000", "tells no format"),
        ("video a.npy -o c.h5 -o a.raw --fps 1000", "--force"),
        ("video a.npy -o c.h5 --fps 1000 --set noise.shot=1", "did you mean"),
        (
            "video a.npy -o c.h5 --fps 1000 --upsample",
            "`evis video`, the command of the Python package, does",
        ),
        ("video --upsample a.npy -o c.h5 --fps 1000", "put --upsample behind the input"),
    ] {
        let output = evis(&folder, line);
        assert_eq!(code(&output), 2, "{line}");
        assert!(stderr(&output).contains(words), "{line}: {}", stderr(&output));
        assert_eq!(folder.names().len(), 5, "{line} left something behind");
    }
}

#[test]
fn other_floats_and_alpha_are_taken() {
    let folder = Folder::new("video-floats");
    let codes: Vec<f32> = (0..8).flat_map(codes).map(|code| f32::from(code) / 256.0).collect();
    npy(&folder.file("f4.npy"), "<f4", 8, &codes.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>());
    let wide: Vec<u8> = codes.iter().flat_map(|v| f64::from(*v).to_le_bytes()).collect();
    npy(&folder.file("f8.npy"), "<f8", 8, &wide);
    for name in ["f4", "f8"] {
        let output = evis(&folder, &format!("video {name}.npy -o {name}.h5 --fps 1000"));
        assert_eq!(code(&output), 0, "{name}: {}", stderr(&output));
        assert!(!stderr(&output).contains("0 to 255"), "{}", stderr(&output));
    }
    assert_eq!(events(&folder, "f8.h5"), events(&folder, "f4.h5"));
    assert!(events(&folder, "f4.h5").len() > 100);
    let bright: Vec<u8> = codes.iter().flat_map(|v| (v * 256.0).to_le_bytes()).collect();
    npy(&folder.file("bright.npy"), "<f4", 8, &bright);
    let output = evis(&folder, "video bright.npy -o bright.h5 --fps 1000");
    assert!(stderr(&output).contains("are they 0 to 255?"), "{}", stderr(&output));
}

#[test]
fn frames_that_come_seldom_are_told_what_is_put_between_them() {
    let folder = Folder::new("video-seldom");
    npy(&folder.file("a.npy"), "|u1", 8, &(0..8).flat_map(codes).collect::<Vec<_>>());
    for (fps, told) in [("30", true), ("60", true), ("61", false), ("1000", false)] {
        let output = evis(&folder, &format!("video a.npy -o {fps}.h5 --fps {fps} --json"));
        let warned = json(&output)["warnings"].to_string().contains("`upsampler` puts frames between");
        assert_eq!((code(&output), warned), (0, told), "{fps}: {}", stderr(&output));
        assert_eq!(stderr(&output).contains("--upsample puts frames between"), told, "{}", stderr(&output));
    }
}

#[test]
fn other_pictures_are_read_too() {
    let folder = Folder::new("video-kinds");
    for (ending, linear) in [("tiff", false), ("exr", true)] {
        let frames = folder.file(ending);
        std::fs::create_dir(&frames).unwrap();
        for k in 0..3 {
            let path = frames.join(format!("{k:04}.{ending}"));
            let codes = codes(k);
            if linear {
                let light = codes.iter().flat_map(|v| [f32::from(*v) / 255.0; 3]).collect();
                let image = ImageBuffer::from_raw(WIDTH, HEIGHT, light).unwrap();
                DynamicImage::ImageRgb32F(image).save(path).unwrap();
            } else {
                let deep = codes.iter().map(|v| u16::from(*v) * 257).collect();
                let image = ImageBuffer::from_raw(WIDTH, HEIGHT, deep).unwrap();
                DynamicImage::ImageLuma16(image).save(path).unwrap();
            }
        }
        let output = evis(&folder, &format!("video {ending} -o {ending}.h5 --fps 100"));
        assert_eq!(code(&output), 0, "{ending}: {}", stderr(&output));
        let curve = if linear { Transfer::Linear } else { Transfer::Srgb };
        let want = expected(SensorConfig::default(), 0, curve, &[0, 10_000, 20_000]);
        let got = events(&folder, &format!("{ending}.h5"));
        // Luminance of three equal channels is rounded once more than one channel.
        let near = got.iter().zip(&want).filter(|(a, b)| (a.t - b.t).abs() <= 1 && a.x == b.x).count();
        assert!(
            got.len() == want.len() && near * 100 > want.len() * 95,
            "{ending}: {near} of {}",
            want.len()
        );
    }
}

#[test]
fn bad_frames_are_told_with_their_number() {
    let folder = Folder::new("video-bad");
    let frames = folder.file("frames");
    std::fs::create_dir(&frames).unwrap();
    (0..4).for_each(|k| save_png(&frames, &format!("{k}.png"), k));
    let all: Vec<u8> = (0..4).flat_map(codes).collect();
    npy(&folder.file("short.npy"), "|u1", 5, &all);
    npy(&folder.file("kind.npy"), "<i8", 4, &all);
    let bad: Vec<u8> =
        [vec![0.5_f32; 192], vec![-1.0; 192]].concat().iter().flat_map(|v| v.to_le_bytes()).collect();
    npy(&folder.file("dark.npy"), "<f4", 2, &bad);
    std::fs::write(folder.file("back.txt"), "0.1\n0.2\n0.15\n0.3\n").unwrap();
    std::fs::write(folder.file("few.txt"), "0.1\n0.2\n").unwrap();
    std::fs::write(folder.file("names.txt"), "a.png 0.1\n0.png 0.2\n").unwrap();
    std::fs::write(folder.file("not.toml"), "threshold_on = -1\n").unwrap();
    for (line, told) in [
        ("frames", "does not say when they were taken; give --fps"),
        ("short.npy", "does not say when they were taken; give --fps"),
        ("short.npy --fps 30", "does not fit in its 896 bytes"),
        ("kind.npy --fps 30", "dtype '<i8'"),
        ("dark.npy --fps 30", "frame 1 has light -1 at pixel (0, 0)"),
        ("dark.npy --fps 30 --transfer srgb", "transfer is srgb; it must be linear"),
        ("frames --timestamps back.txt", "line 3: frame 2 at 150000 us does not come after"),
        ("frames --timestamps few.txt", "it has 4 frames, and there are 2 times"),
        ("frames --timestamps names.txt", "there is no picture 'a.png'"),
        ("frames --timestamps none.txt", "cannot read none.txt"),
        ("frames --fps 0", "--fps"),
        ("frames --fps 30 --transfer film", "srgb, rec709, linear, or gamma:G"),
        ("frames --fps 30 --sensor v3e", "neither a preset nor a file"),
        ("frames --fps 30 --sensor not.toml", "threshold_on"),
        ("frames --fps 30 --start 9", "before the last frame"),
        ("frames --fps 30 --size 0x4", "--size"),
        ("nowhere --fps 30", "nowhere"),
    ] {
        let output = evis(&folder, &format!("video {line} -o x.h5"));
        assert_eq!(code(&output), 2, "{line}: {}", stderr(&output));
        assert!(stderr(&output).contains(told), "{line}: {}", stderr(&output));
        // A frame that went wrong later leaves those before it; everything else leaves no file.
        let begun = told.starts_with("frame 1");
        assert_eq!(folder.file("x.h5").exists(), begun, "{line}");
        let _ = std::fs::remove_file(folder.file("x.h5"));
    }
    save_png(&folder.file("frames"), "4.png", 4);
    let other = DynamicImage::new_luma8(WIDTH, HEIGHT + 1);
    other.save(frames.join("5.png")).unwrap();
    let output = evis(&folder, "video frames --fps 30 -o part.h5");
    assert_eq!(code(&output), 2);
    assert!(
        stderr(&output).contains("frame 5 has 16x13 pixels, and those before it 16x12"),
        "{}",
        stderr(&output)
    );
    std::fs::write(frames.join("5.png"), b"\x89PNG\r\n\x1a\nnothing").unwrap();
    let output = evis(&folder, "video frames --fps 30 -o part.h5 --force");
    assert!(stderr(&output).contains("frame 5: "), "{}", stderr(&output));
    // What was written before is there.
    let recording = Recording::open(&folder.file("part.h5")).unwrap();
    assert!(!recording.is_complete().unwrap() && recording.event_count(0).unwrap() > 0);
    let output = evis(&folder, "video frames --fps 30 -o part.h5");
    assert!(code(&output) == 2 && stderr(&output).contains("exists already"), "{}", stderr(&output));
}

/// Whether ffmpeg is there; a test without it says that it ran nothing.
fn has_ffmpeg() -> bool {
    let there = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    let there = there.is_ok_and(|status| status.success());
    if !there {
        eprintln!("skipped: ffmpeg is not on PATH; apt-get install ffmpeg");
    }
    there
}

/// A lossless film of `frames` frames whose frame n is shown at `micros` (an expression in N).
fn film(folder: &Folder, name: &str, frames: u32, micros: &str) {
    let mut child = Command::new("ffmpeg")
        .current_dir(folder.path())
        .args([
            "-v",
            "error",
            "-f",
            "rawvideo",
            "-pix_fmt",
            "gray",
            "-s",
            &format!("{WIDTH}x{HEIGHT}"),
            "-r",
            "30",
        ])
        .args(["-i", "pipe:0", "-vf", &format!("settb=1/1000000,setpts='{micros}'"), "-c:v", "ffv1"])
        .args(["-pix_fmt", "bgr0", "-vsync", "passthrough", "-enc_time_base", "1:1000000", name])
        .stdin(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let bytes: Vec<u8> = (0..frames).flat_map(codes).collect();
    child.stdin.take().unwrap().write_all(&bytes).unwrap();
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_film_keeps_the_times_of_its_frames() {
    if !has_ffmpeg() {
        return;
    }
    let folder = Folder::new("video-film");
    // NUT keeps microseconds; frames of variable length, far from the start.
    film(&folder, "a.nut", 12, "3600000000+N*10000+N*N*777");
    let output = evis(&folder, "video a.nut -o a.h5 --transfer srgb --json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    let times: Vec<i64> = (0..12).map(|n| n * 10_000 + n * n * 777).collect();
    assert_eq!((&report["frames"], &report["kind"]), (&12.into(), &"film".into()));
    assert_eq!(report["stream_s"], *times.last().unwrap() as f64 / 1e6);
    assert_eq!(report["warnings"].as_array().unwrap().len(), 0, "{report}");
    let mut emulator =
        EventEmulator::new(EmulatorConfig { width: WIDTH, height: HEIGHT, ..EmulatorConfig::default() })
            .unwrap();
    let mut want = Vec::new();
    for (k, t_us) in (0..12).zip(&times) {
        let rgb: Vec<u8> = codes(k).into_iter().flat_map(|v| [v; 3]).collect();
        want.extend(emulator.push(&Frames::u8(&rgb, Transfer::Srgb).rgb(), *t_us).unwrap().remove(0));
    }
    assert_eq!(events(&folder, "a.h5"), want);
    let output = evis(&folder, "video a.nut -o b.h5 --fps 240 --json");
    assert_eq!(json(&output)["stream_s"], 0.045_833, "--fps replaces the film's times");
    let output = evis(&folder, "video a.nut -o c.h5 --start 0.05 --duration 0.1 --json");
    let used = times.iter().filter(|t| **t >= 50_000).count();
    let first = times.iter().find(|t| **t >= 50_000).unwrap();
    let used = used - times.iter().filter(|t| **t > first + 100_000).count();
    assert_eq!(json(&output)["frames"], used);
}

#[test]
fn a_film_that_cannot_be_read_is_told() {
    let folder = Folder::new("video-nofilm");
    std::fs::write(folder.file("text.mp4"), "this is no film\n".repeat(100)).unwrap();
    let output = program(&folder)
        .args(["video", "text.mp4", "-o", "x.h5"])
        .env("EVIS_FFMPEG", "/none/ffmpeg")
        .output();
    let output = output.unwrap();
    assert_eq!(code(&output), 2);
    for told in ["/none/ffmpeg did not start", "apt-get install ffmpeg", "evis[video]", "EVIS_FFMPEG"] {
        assert!(stderr(&output).contains(told), "{}", stderr(&output));
    }
    if !has_ffmpeg() {
        return;
    }
    let output = evis(&folder, "video text.mp4 -o x.h5");
    assert!(code(&output) == 2 && stderr(&output).contains("Invalid data"), "{}", stderr(&output));
    film(&folder, "a.nut", 12, "N*10000");
    let whole = std::fs::read(folder.file("a.nut")).unwrap();
    // Ends within a frame: what was whole before it counts, and the rest is told.
    std::fs::write(folder.file("cut.nut"), &whole[..whole.len() * 2 / 3]).unwrap();
    let output = evis(&folder, "video cut.nut -o cut.h5 --json");
    if code(&output) == 0 {
        assert!(json(&output)["frames"].as_u64().unwrap() < 12);
    } else {
        assert!(code(&output) == 2 && stderr(&output).contains("frame "), "{}", stderr(&output));
    }
    assert_eq!(folder.names().iter().filter(|name| *name == "x.h5").count(), 0);
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_a_whole_file() {
    let folder = Folder::new("video-interrupt");
    // Long enough for the signal to come in between: 20 000 frames.
    let all: Vec<u8> = (0..64).flat_map(codes).collect();
    npy(&folder.file("long.npy"), "|u1", 64 * 400, &all.repeat(400));
    let mut child = program(&folder)
        .args("video long.npy -o a.h5 --fps 1000 --sensor v2e-noisy --json".split(' '))
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    while !folder.file("a.h5").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended too early");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(code(&output), 130);
    let report = json(&output);
    assert_eq!(report["interrupted"], true);
    let frames = report["frames"].as_u64().unwrap();
    assert!((1..64 * 400).contains(&frames), "{frames}");
    assert_eq!(events(&folder, "a.h5").len() as u64, report["events"].as_u64().unwrap());
}
