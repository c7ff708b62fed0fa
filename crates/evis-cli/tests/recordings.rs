//! `info` and `preview` on a recording that the test has written.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{
    Folder, HEIGHT, OFF_EVENTS, ON_EVENTS, WIDTH, code, evis, json, program, stderr, stdout,
    write_inertial_samples, write_many_events, write_recording,
};

const WHITE: [u8; 3] = [255, 255, 255];
const ON: [u8; 3] = [230, 159, 0];
const OFF: [u8; 3] = [0, 66, 120];

fn done(folder: &Folder, line: &str) -> String {
    let output = evis(folder, line);
    assert_eq!(code(&output), 0, "{line}\n{}", stderr(&output));
    stdout(&output)
}

#[test]
fn info_tells_what_is_in_the_file() {
    let folder = Folder::new("info");
    write_recording(&folder.file("a.h5"), true, true);
    let info = json(&evis(&folder, "info a.h5 --json"));
    assert_eq!(info["complete"], true);
    assert_eq!(info["seed"], 7);
    assert_eq!(info["events"], ON_EVENTS + OFF_EVENTS);
    let left = &info["cameras"][0];
    assert_eq!(
        (&left["name"], &left["width"], &left["height"]),
        (&"left".into(), &WIDTH.into(), &HEIGHT.into())
    );
    assert_eq!(
        (&left["on"], &left["off"], &left["poses"]),
        (&ON_EVENTS.into(), &OFF_EVENTS.into(), &4.into())
    );
    assert_eq!((&left["labels"][0]["kind"], &left["labels"][0]["frames"]), (&"hdr".into(), &4.into()));
    assert_eq!(info["cameras"][1]["events"], 0);
    assert!(info["settings_toml"].as_str().unwrap().contains("scene = \"test\""));

    let right = json(&evis(&folder, "info a.h5 --camera right --json"));
    assert_eq!((&right["cameras"][0]["name"], &right["events"]), (&"right".into(), &0.into()));
    assert_eq!(right["cameras"].as_array().unwrap().len(), 1);

    let text = done(&folder, "info a.h5");
    for words in ["complete", "75.0 % ON", "camera left", "camera right", "hdr: 4 frames", "scene = \"test\""]
    {
        assert!(text.contains(words), "the text lacks '{words}':\n{text}");
    }
}

#[test]
fn a_file_that_was_cut_off_is_told_and_repaired() {
    let folder = Folder::new("repair");
    write_recording(&folder.file("cut.h5"), false, false);
    let before = json(&evis(&folder, "info cut.h5 --json"));
    assert_eq!((&before["complete"], &before["events"]), (&false.into(), &(ON_EVENTS + OFF_EVENTS).into()));
    assert!(done(&folder, "info cut.h5").contains("--repair"));
    let after = json(&evis(&folder, "info cut.h5 --repair --json"));
    assert_eq!(after["events"], ON_EVENTS + OFF_EVENTS);
    assert_eq!(after["repaired"]["reopened"], true);
}

#[test]
fn a_check_names_the_hole_in_a_damaged_file() {
    let folder = Folder::new("hole");
    let path = folder.file("a.h5");
    write_many_events(&path);
    done(&folder, "info a.h5 --check");
    let mut bytes = std::fs::read(&path).unwrap();
    // A page that the disk gave back empty.
    let page = bytes.len() / 2 / 4096 * 4096;
    assert!(bytes[page..page + 4096].iter().any(|byte| *byte != 0));
    bytes[page..page + 4096].fill(0);
    std::fs::write(&path, &bytes).unwrap();
    let output = evis(&folder, "info a.h5 --check");
    assert_eq!(code(&output), 2, "{}", stdout(&output));
    let told = stderr(&output);
    for words in ["a.h5", "rows ", " of left/events", " cannot be read; ", "info --repair"] {
        assert!(told.contains(words), "the error lacks '{words}':\n{told}");
    }
    assert!(std::fs::read(&path).unwrap() == bytes, "a check writes nothing");
}

#[test]
fn a_damaged_inertial_unit_costs_no_event() {
    let folder = Folder::new("unit");
    let path = folder.file("a.h5");
    write_inertial_samples(&path);
    done(&folder, "info a.h5 --check");
    let mut bytes = std::fs::read(&path).unwrap();
    // The middle of the file holds samples.
    let page = bytes.len() / 2 / 4096 * 4096;
    bytes[page..page + 4096].fill(0);
    std::fs::write(&path, &bytes).unwrap();
    for line in ["info a.h5", "info a.h5 --check"] {
        let output = evis(&folder, line);
        assert_eq!(code(&output), 2, "{line}\n{}", stdout(&output));
        assert!(stderr(&output).contains("info --repair"), "{line}\n{}", stderr(&output));
    }
    let told = stderr(&evis(&folder, "info a.h5 --check"));
    for words in
        ["rows ", " of imus/head (between ", " cannot be read; ", " rows are missing, 0 of them events"]
    {
        assert!(told.contains(words), "the error lacks '{words}':\n{told}");
    }
    let told = done(&folder, "info a.h5 --repair");
    for words in [
        "100 of 100 events",
        "rows of labels, poses, inertial samples and states were dropped",
        " of imus/head (between ",
        "imu head",
    ] {
        assert!(told.contains(words), "the text lacks '{words}':\n{told}");
    }
    done(&folder, "info a.h5 --check");
}

#[test]
fn a_picture_shows_the_events_of_its_window() {
    let folder = Folder::new("window");
    write_recording(&folder.file("a.h5"), false, true);
    done(&folder, "preview a.h5 -o a.png --at 0.004 --window-ms 2 --scale 2");
    let picture = image::open(folder.file("a.png")).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (2 * WIDTH, 2 * HEIGHT + 16));
    // The window [2, 4) ms holds an ON event in row 2 and an OFF event in row 3, both in column 0.
    let at = |x: u32, y: u32| picture.get_pixel(2 * x + 1, 2 * y + 1).0;
    assert_eq!((at(0, 2), at(0, 3)), (ON, OFF));
    assert_eq!((at(0, 1), at(0, 4), at(1, 2)), (WHITE, WHITE, WHITE));
    done(&folder, "preview a.h5 -o silent.png --at 0.1 --camera right");
    let silent = image::open(folder.file("silent.png")).unwrap().to_rgb8();
    let colored = silent.enumerate_pixels().filter(|(_, y, p)| *y < HEIGHT && p.0 != WHITE).count();
    assert_eq!(colored, 0);
}

#[test]
fn frames_stand_beside_the_events() {
    let folder = Folder::new("hdr");
    write_recording(&folder.file("a.h5"), true, true);
    for (at, level) in [("0.02", 0.1_f32), ("0.12", 0.3)] {
        done(&folder, &format!("preview a.h5 -o a.png --at {at}"));
        let picture = image::open(folder.file("a.png")).unwrap().to_rgb8();
        assert_eq!(picture.width(), 2 * WIDTH + 8);
        let linear = level * (1.0 + level / 16.0) / (1.0 + level);
        let expected = ((1.055 * linear.powf(1.0 / 2.4) - 0.055) * 255.0).round() as u8;
        assert_eq!(picture.get_pixel(WIDTH / 2, HEIGHT / 2).0, [expected; 3], "at {at} s");
    }
}

#[test]
fn the_same_recording_gives_the_same_picture() {
    let folder = Folder::new("determinism");
    write_recording(&folder.file("a.h5"), true, true);
    for ending in ["png", "gif"] {
        done(&folder, &format!("preview a.h5 -o one.{ending}"));
        done(&folder, &format!("preview a.h5 -o two.{ending}"));
        let read = |name: &str| std::fs::read(folder.file(&format!("{name}.{ending}"))).unwrap();
        assert_eq!(read("one"), read("two"), "{ending}");
        done(&folder, &format!("preview a.h5 -o two.{ending} --duration 0.1"));
        assert_ne!(read("one"), read("two"), "canary: another part of the recording looks different");
    }
}

#[test]
fn a_gif_keeps_the_time_of_the_stream() {
    use image::AnimationDecoder;
    let folder = Folder::new("gif");
    write_recording(&folder.file("a.h5"), false, true);
    for (arguments, frames, millis) in [("", 4, 200), ("--slow 3", 12, 600), ("--fps 30 --slow 5", 30, 1000)]
    {
        done(&folder, &format!("preview a.h5 -o a.gif {arguments}"));
        let file = std::io::BufReader::new(std::fs::File::open(folder.file("a.gif")).unwrap());
        let decoder = image::codecs::gif::GifDecoder::new(file).unwrap();
        let delays: Vec<_> = decoder
            .into_frames()
            .map(|frame| {
                let (numerator, denominator) = frame.unwrap().delay().numer_denom_ms();
                numerator / denominator
            })
            .collect();
        assert_eq!(delays.len(), frames, "{arguments}");
        assert_eq!(delays.iter().sum::<u32>(), millis, "{arguments}: {delays:?}");
    }
}

#[test]
fn without_ffmpeg_the_remedies_are_named() {
    let folder = Folder::new("no-ffmpeg");
    write_recording(&folder.file("a.h5"), false, true);
    let output = program(&folder)
        .args(["preview", "a.h5", "-o", "a.mp4"])
        .env("EVIS_FFMPEG", "/no/such/ffmpeg")
        .output()
        .unwrap();
    let message = stderr(&output);
    assert_eq!(code(&output), 2, "{message}");
    for words in ["/no/such/ffmpeg", "apt-get install ffmpeg", "evis[video]", "EVIS_FFMPEG", ".gif"] {
        assert!(message.contains(words), "the message lacks '{words}':\n{message}");
    }
    assert_eq!(folder.names(), ["a.h5"]);
}

#[cfg(unix)]
#[test]
fn every_frame_reaches_ffmpeg() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new("ffmpeg");
    write_recording(&folder.file("a.h5"), false, true);
    // Stands in for ffmpeg: stores what it gets under the name that it is given last.
    let script = folder.file("fake-ffmpeg");
    std::fs::write(&script, "#!/bin/sh\nfor last; do :; done\nexec cat > \"$last\"\n").unwrap();
    std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
    let run = |line: &str| {
        program(&folder).args(line.split_whitespace()).env("EVIS_FFMPEG", &script).output().unwrap()
    };
    let output = run("preview a.h5 -o a.mp4 --fps 100");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let frame = (WIDTH.max(72) * (HEIGHT + 16) * 3) as usize;
    let bytes = std::fs::read(folder.file("a.mp4")).unwrap();
    assert_eq!((bytes.len() % frame, bytes.len() / frame), (0, 20), "frames of 10 ms in 200 ms");

    // One that fails: its words are told, and nothing is left.
    std::fs::write(&script, "#!/bin/sh\necho no such codec >&2\nexit 3\n").unwrap();
    let output = run("preview a.h5 -o b.mp4");
    assert_eq!(code(&output), 1, "{}", stderr(&output));
    assert!(stderr(&output).contains("no such codec"), "{}", stderr(&output));
    assert_eq!(folder.names(), ["a.h5", "a.mp4", "fake-ffmpeg"]);
}
