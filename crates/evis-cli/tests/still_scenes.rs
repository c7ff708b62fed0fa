//! Scenes in which nothing moves, through the command: what moves them, what is said of it, what is refused.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{Folder, code, evis, json, stderr};

/// A cube on a stand, with a texture so that it fires everywhere.
const STILL: &str = r#"
textures = [{ name = "t", pattern = "bricks", size = 128 }]
materials = [{ name = "m", model = "unlit", texture = "t" }]
primitives = [{ name = "cube", shape = "box", size = [100, 80, 60], material = "m" }]
"#;

/// Two boxes without textures.
const PLAIN: &str = r#"
background = [0.3, 0.3, 0.3]
materials = [{ name = "m", color = [0.6, 0.6, 0.6] }, { name = "d", model = "unlit", color = [0.1, 0.1, 0.1] }]
primitives = [
  { name = "cube", shape = "box", size = [100, 80, 60], material = "m" },
  { name = "bar", shape = "box", size = [20, 120, 20], material = "d" },
]
lights = [{ name = "sun", kind = "directional", intensity = 3.0, rotation_degrees = [-40, 30, 0] }]
"#;

const CAMERA: &str = "cameras = [{ name = \"own\", position = [0, 40, 260], size = [64, 48] }]\n";

const FAST: &str = "--duration 0.05 --rate 200 --samples 1 --size 64x48";

fn folder(test: &str) -> Folder {
    let folder = Folder::new(test);
    std::fs::write(folder.file("still.toml"), STILL).unwrap();
    std::fs::write(folder.file("own.toml"), format!("{CAMERA}{STILL}")).unwrap();
    let picture =
        image::RgbImage::from_fn(96, 64, |x, y| image::Rgb([(x * 37 % 251) as u8, (y * 53 % 241) as u8, 90]));
    picture.save(folder.file("photo.png")).unwrap();
    folder
}

/// The report of a run, and what it says on standard error.
fn run(folder: &Folder, line: &str) -> (serde_json::Value, String) {
    let output = evis(folder, &format!("run {line} -o out.h5 --force --json {FAST}"));
    assert_eq!(code(&output), 0, "{line}\n{}", stderr(&output));
    (json(&output), stderr(&output))
}

fn warns(report: &serde_json::Value, words: &str) -> bool {
    report["warnings"].as_array().unwrap().iter().any(|w| w.as_str().unwrap().contains(words))
}

#[test]
fn a_model_without_camera_and_motion_fires_and_says_why() {
    let folder = folder("orbit");
    let (report, said) = run(&folder, "still.toml");
    assert!(report["events"].as_u64().unwrap() > 50, "{report}");
    for words in ["orbits the model at about 100 px/s", "camera motion orbit"] {
        assert!(said.contains(words) && warns(&report, words), "{said}");
    }
    let moved = &report["settings"]["camera_motion"];
    assert_eq!((&moved["motion"], &moved["by_default"]), (&"orbit".into(), &true.into()), "{moved}");
    // The recording says what moved.
    let info = json(&evis(&folder, "info out.h5 --json"));
    let settings: toml::Table = info["settings_toml"].as_str().unwrap().parse().unwrap();
    let stored = settings["camera_motion"].as_table().unwrap();
    assert_eq!(stored["speed_px_per_s"].as_float(), Some(100.0));
    assert!(stored["description"].as_str().unwrap().contains("degrees per second"), "{stored:?}");
}

#[test]
fn what_rests_is_said_before_and_after() {
    let folder = folder("rest");
    for line in ["own.toml", "still.toml --camera-motion none", "photo.png --camera-motion none"] {
        let (report, said) = run(&folder, line);
        assert_eq!(report["events"], 0, "{line}");
        for words in ["nothing moves and no light changes", "no event was fired in"] {
            assert!(said.contains(words) && warns(&report, words), "{line}\n{said}");
        }
        assert!(said.contains("--camera-motion orbit"), "{said}");
    }
}

#[test]
fn motions_that_are_asked_for_move_a_scene_with_its_own_camera() {
    let folder = folder("asked");
    std::fs::write(folder.file("path.csv"), "0 0 40 260 0 0 0 1\n1 60 40 260 0 0 0 1\n").unwrap();
    for motion in ["orbit", "dolly", "shake", "path.csv"] {
        let (report, said) = run(&folder, &format!("own.toml --camera-motion {motion}"));
        assert!(report["events"].as_u64().unwrap() > 20, "{motion}: {report}");
        assert!(!said.contains("warning"), "{said}");
        assert_eq!(report["settings"]["camera_motion"]["motion"], motion);
        assert_eq!(report["settings"]["camera_motion"]["by_default"], false);
    }
    let events = |speed| {
        run(&folder, &format!("own.toml --camera-motion orbit --camera-speed {speed}")).0["events"]
            .as_u64()
            .unwrap()
    };
    assert!(events("400") > 2 * events("100"));
}

#[test]
fn a_photo_is_a_scene_and_gives_the_same_bytes_twice() {
    let folder = folder("photo");
    let (report, said) = run(&folder, "photo.png");
    assert!(
        report["events"].as_u64().unwrap() > 50 && said.contains("the camera shakes before it"),
        "{said}"
    );
    let first = std::fs::read(folder.file("out.h5")).unwrap();
    let (again, _) = run(&folder, "photo.png");
    assert_eq!(again["events"], report["events"]);
    let events = |name: &str| {
        let recording = evis_core::format::read_events(&folder.file(name), None).unwrap();
        format!("{recording:?}")
    };
    std::fs::write(folder.file("first.h5"), first).unwrap();
    assert_eq!(events("first.h5"), events("out.h5"));
    run(&folder, "photo.png --camera-motion dolly");
    assert_ne!(events("first.h5"), events("out.h5"), "canary");
}

#[test]
fn bad_motions_are_refused_with_what_works() {
    let folder = folder("refused");
    std::fs::write(folder.file("bad.csv"), "0 0 0 0 0 0 0 1\n1 0 0 up 0 0 0 1\n").unwrap();
    for (line, expected) in [
        ("still.toml --camera-motion orbti", "did you mean 'orbit'?"),
        ("still.toml --camera-motion bad.csv", "bad.csv: line 2, column 7: 'up' is not a number"),
        ("still.toml --camera-motion missing.csv", "missing.csv"),
        ("still.toml --camera-motion orbit --camera-speed 0", "0.01 to 100000"),
        ("still.toml --camera-motion orbit --camera-speed -3", "0.01 to 100000"),
        ("still.toml --camera-motion orbit --camera-speed nan", "0.01 to 100000"),
        ("still.toml --camera-motion orbit --camera-speed 1e12", "0.01 to 100000"),
        ("still.toml --camera-motion none --camera-speed 5", "takes no speed"),
        ("own.toml --camera-speed 5", "moves nothing here"),
        ("spinner --camera-motion orbit", "moves by itself"),
        ("photo.png --camera-motion orbit", "shake or dolly"),
    ] {
        let output = evis(&folder, &format!("run {line} -o out.h5"));
        assert_eq!(code(&output), 2, "{line}\n{}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{line}\n{}", stderr(&output));
        assert!(!folder.file("out.h5").exists(), "{line}");
    }
    let output = evis(&folder, "verify --camera-motion orbit");
    assert!(code(&output) == 2 && stderr(&output).contains("--scene"), "{}", stderr(&output));
}

#[test]
fn truth_moves_as_the_engine_does() {
    let folder = folder("truth");
    std::fs::write(folder.file("plain.toml"), PLAIN).unwrap();
    let common = "--size 64x48 --duration 0.1 --camera-speed 40";
    let output =
        evis(&folder, &format!("truth plain.toml -o truth.h5 --truth-pixels all --cache cache {common}"));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(stderr(&output).contains("orbits the model"), "{}", stderr(&output));
    let output = evis(&folder, &format!("run plain.toml -o out.h5 --rate 2000 --samples 16 {common}"));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let score = evis(&folder, "score out.h5 --truth truth.h5 --json");
    assert_eq!(code(&score), 0, "{}", stderr(&score));
    let score = json(&score);
    // Measured: 0.869; a motion of another kind leaves nearly nothing.
    let f1 = score["score"]["tolerances"][0]["plain"]["f1"].as_f64();
    assert!(f1.is_some_and(|f1| f1 > 0.8), "{score}");
}
