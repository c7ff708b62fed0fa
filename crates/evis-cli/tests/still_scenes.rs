//! Scenes in which nothing moves, through the command: what moves them, what is said of it, what is refused.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{Folder, code, evis, json, stderr, stdout};

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
        let recording = evis_format::read_events(&folder.file(name), None).unwrap();
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

/// A glTF file of one white quad in front of its camera, which moves left in one animation and right in the other.
fn quad() -> String {
    let mut bytes: Vec<u8> = Vec::new();
    let mut floats = |values: &[f32]| values.iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    floats(&[-0.5, -0.5, 0.0, 0.5, -0.5, 0.0, 0.5, 0.5, 0.0, -0.5, -0.5, 0.0, 0.5, 0.5, 0.0, -0.5, 0.5, 0.0]);
    floats(&[0.0, 1.0]);
    floats(&[0.0, 0.0, 0.0, -1.0, 0.0, 0.0]);
    floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    let digits: String = bytes.chunks(3).map(base64_of).collect();
    let accessor = |view: usize, kind: &str, count: usize| {
        format!(
            "{{\"bufferView\": {view}, \"componentType\": 5126, \"type\": \"{kind}\", \"count\": {count}}}"
        )
    };
    let accessors =
        [accessor(0, "VEC3", 6), accessor(1, "SCALAR", 2), accessor(2, "VEC3", 2), accessor(3, "VEC3", 2)];
    let animation = |name: &str, output: usize| {
        format!(
            "{{\"name\": \"{name}\", \"samplers\": [{{\"input\": 1, \"output\": {output}}}], \
             \"channels\": [{{\"sampler\": 0, \"target\": {{\"node\": 0, \"path\": \"translation\"}}}}]}}"
        )
    };
    let view = |offset: usize, length: usize| {
        format!("{{\"buffer\": 0, \"byteOffset\": {offset}, \"byteLength\": {length}}}")
    };
    format!(
        "{{\"asset\": {{\"version\": \"2.0\"}}, \"extensionsUsed\": [\"KHR_materials_unlit\"], \
         \"buffers\": [{{\"byteLength\": 128, \"uri\": \"data:application/octet-stream;base64,{digits}\"}}], \
         \"bufferViews\": [{}], \"accessors\": [{}], \
         \"materials\": [{{\"extensions\": {{\"KHR_materials_unlit\": {{}}}}}}], \
         \"meshes\": [{{\"primitives\": [{{\"attributes\": {{\"POSITION\": 0}}, \"material\": 0}}]}}], \
         \"cameras\": [{{\"name\": \"eye\", \"type\": \"perspective\", \
         \"perspective\": {{\"yfov\": 1.0, \"znear\": 0.1}}}}], \
         \"nodes\": [{{\"name\": \"quad\", \"mesh\": 0, \"extras\": {{\"semantic_id\": 5, \"semantic_name\": \"sign\"}}}}, \
         {{\"camera\": 0, \"translation\": [0, 0, 4]}}], \"scenes\": [{{\"nodes\": [0, 1]}}], \
         \"animations\": [{}, {}]}}",
        [view(0, 72), view(72, 8), view(80, 24), view(104, 24)].join(", "),
        accessors.join(", "),
        animation("left", 2),
        animation("right", 3),
    )
}

/// Up to three bytes as four digits (RFC 4648).
fn base64_of(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let bits =
        bytes.iter().fold(0_usize, |bits, byte| bits << 8 | usize::from(*byte)) << (8 * (3 - bytes.len()));
    let digit = |k: usize| if k <= bytes.len() { char::from(DIGITS[bits >> (18 - 6 * k) & 63]) } else { '=' };
    (0..4).map(digit).collect()
}

#[test]
fn a_scene_is_previewed_as_one_picture_at_a_time_of_its_animation() {
    let folder = folder("preview");
    if common::no_device(&folder) {
        return;
    }
    std::fs::write(folder.file("quad.gltf"), quad()).unwrap();
    /// Mean brightness of the left and the right half.
    fn halves(path: &std::path::Path) -> [f64; 2] {
        let picture = image::open(path).unwrap().to_luma8();
        assert_eq!(picture.dimensions(), (64, 48));
        let mean = |from: u32| {
            let sum: u32 = (0..48)
                .flat_map(|y| (from..from + 32).map(move |x| (x, y)))
                .map(|(x, y)| u32::from(picture[(x, y)][0]))
                .sum();
            f64::from(sum) / (32.0 * 48.0)
        };
        [mean(0), mean(32)]
    }
    let shown = |line: &str| {
        let output = evis(&folder, &format!("preview quad.gltf -o still.png --size 64x48 {line}"));
        assert_eq!(code(&output), 0, "{line}\n{}", stderr(&output));
        assert!(stdout(&output).contains("64x48 pixels, camera 'eye'"), "{}", stdout(&output));
        (halves(&folder.file("still.png")), stderr(&output))
    };
    let ([left, right], said) = shown("");
    assert!((left - right).abs() < 1.0 && left > 3.0, "at first it is in the middle: {left} {right}");
    assert!(
        said.contains("animation 'left' plays; --animation chooses another of the file: right"),
        "{said}"
    );
    let ([left, right], _) = shown("--at 1");
    assert!(left > 4.0 * right, "the first animation: {left} {right}");
    for other in ["right", "1"] {
        let ([left, right], _) = shown(&format!("--at 1 --animation {other}"));
        assert!(right > 4.0 * left, "the other one: {left} {right}");
    }
    let info = json(&evis(&folder, "info quad.gltf --json"));
    assert_eq!(info["classes"][0], serde_json::json!({"id": 5, "name": "sign"}));
}

#[test]
fn settings_of_a_recording_play_what_was_recorded_of_the_same_scene() {
    let folder = folder("again");
    std::fs::write(folder.file("quad.gltf"), quad()).unwrap();
    std::fs::write(folder.file("other.gltf"), quad()).unwrap();
    let run = |line: &str| {
        let output = evis(&folder, &format!("run {line} --force --json --quality draft"));
        assert_eq!(code(&output), 0, "{line}\n{}", stderr(&output));
        (json(&output), stderr(&output))
    };
    let again = |line: &str| {
        let output = evis(&folder, &format!("run {line} -o b.h5 --force --json --settings a.h5"));
        assert_eq!(code(&output), 0, "{line}\n{}", stderr(&output));
        (json(&output), stderr(&output))
    };
    let of = |report: &serde_json::Value| {
        let settings = &report["settings"];
        let kept = ["animation", "speed", "duration_s"].map(|key| settings[key].clone());
        (kept, report["events"].clone(), report["on"].clone())
    };
    let (first, _) = run("quad.gltf -o a.h5 --animation right --speed 2 --duration 0.3 --size 64x48");
    assert!(first["events"].as_u64().unwrap() > 50, "{first}");
    let (second, said) = again("quad.gltf");
    assert_eq!(of(&second), of(&first));
    assert!(said.contains("settings of a.h5: animation 'right', speed 2, 0.3 s"), "{said}");
    let (faster, _) = again("quad.gltf --speed 4 --duration 0.1");
    assert_eq!(of(&faster).0, ["right".into(), 4.0.into(), 0.1.into()] as [serde_json::Value; 3]);
    // Another scene has its own.
    let (other, said) = again("other.gltf --duration 0.3");
    assert_eq!(of(&other).0, ["left".into(), 1.0.into(), 0.3.into()] as [serde_json::Value; 3]);
    assert!(!said.contains("settings of"), "{said}");
    assert_ne!(of(&other).1, of(&first).1, "canary");

    // What moved the camera moves it again.
    let (first, _) =
        run("still.toml -o a.h5 --camera-motion dolly --camera-speed 300 --duration 0.05 --size 64x48");
    let (second, said) = again("still.toml");
    assert_eq!(second["settings"]["camera_motion"], first["settings"]["camera_motion"]);
    assert_eq!(of(&second), of(&first));
    assert!(said.contains("camera motion dolly"), "{said}");
    let refused = evis(&folder, "run a.h5 -o c.h5");
    let said = stderr(&refused);
    assert!(code(&refused) == 2 && said.contains("`run SCENE --settings a.h5`"), "{said}");
}

#[test]
fn what_scenes_and_recordings_do_not_take_is_refused() {
    let folder = folder("refused-here");
    std::fs::write(folder.file("quad.gltf"), quad()).unwrap();
    common::write_recording(&folder.file("a.h5"), false, true);
    for (line, expected) in [
        (
            "preview quad.gltf -o x.png --animation rigth",
            "no animation named 'rigth'; there is left, right (did you mean 'right'?)",
        ),
        ("info quad.gltf --animation 2", "no animation named '2'; there is left, right"),
        ("run quad.gltf -o x.h5 --animation up", "no animation named 'up'; there is left, right"),
        ("run spinner -o x.h5 --animation up", "animation is 'up', but spinner is no .gltf or .glb file"),
        ("verify --scene quad.gltf --animation up", "no animation named 'up'; there is left, right"),
        ("verify --light quad.gltf --animation up", "no animation named 'up'; there is left, right"),
        ("verify --animation up", "--animation is for a scene; add --scene SCENE or --light SCENE"),
        ("chart quad.gltf --animation up", "no animation named 'up'; there is left, right"),
        ("truth quad.gltf -o x.h5 --animation up", "no animation named 'up'; there is left, right"),
        ("info a.h5 --animation up", "--animation is 'up', but a.h5 is no scene"),
        ("preview a.h5 -o x.png --animation up", "--animation is for scenes, and a.h5 is none"),
        ("preview a.h5 -o x.png --size 64x48", "--size is for scenes, and a.h5 is none"),
        ("preview quad.gltf -o x.gif", "a scene becomes a still picture, .png"),
        ("preview quad.gltf -o x.png --fps 20", "--fps is for recordings, and quad.gltf is a scene"),
        ("preview quad.gltf -o x.png --camera eey", "no camera named 'eey'; there is eye"),
    ] {
        let output = evis(&folder, line);
        assert_eq!(code(&output), 2, "{line}\n{}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{line}\n{}", stderr(&output));
    }
    assert!(folder.names().iter().all(|name| !name.starts_with("x.")), "{:?}", folder.names());
}

#[test]
fn a_still_after_the_end_of_motion_says_so() {
    let folder = folder("still-end");
    std::fs::write(folder.file("quad.gltf"), quad()).unwrap();
    for (at, told) in [("0.01", false), ("99", true)] {
        let output = evis(&folder, &format!("preview quad.gltf -o {at}.png --at {at} --size 64x48"));
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let end = "; at 99 s everything rests where it was then";
        assert_eq!(stderr(&output).contains(end), told, "{at}: {}", stderr(&output));
    }
}

#[test]
fn runs_warn_of_what_was_hardly_meant() {
    let folder = folder("meant");
    let inside = STILL.replace("[100, 80, 60]", "[0.0004, 0.0004, 0.0004]");
    let camera = "cameras = [{ name = \"own\", near = 0.00001, size = [64, 48] }]\n";
    std::fs::write(folder.file("inside.toml"), format!("{camera}{inside}")).unwrap();
    let (report, said) = run(&folder, "inside.toml");
    for words in ["largest side is 0.4 mm", "camera 'own' starts inside 'cube', whose surfaces face outwards"]
    {
        assert!(warns(&report, words), "{said}");
    }
    let (report, said) = run(&folder, "own.toml --camera-motion orbit");
    assert!(!warns(&report, "inside") && !warns(&report, "largest side"), "{said}");
}
