//! Whole runs, from a built-in scene to a file; they need a device.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{Folder, code, evis, json, no_device, stderr, stdout};

const SMALL: &str = "--size 64x48 --duration 0.05 --samples 1 --rate 500";

#[test]
fn a_scene_becomes_a_recording() {
    let folder = Folder::new("run");
    if no_device(&folder) {
        return;
    }
    let line =
        format!("run spinner -o a.h5 {SMALL} --labels depth,flow --label-rate 100 --report r.json --json");
    let output = evis(&folder, &line);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    let events = report["events"].as_u64().unwrap();
    assert!(events > 0, "a moving scene gave no event");
    assert_eq!(report["packets"], 5);
    assert_eq!(report["settings"]["run"]["rate_hz"], 500.0);
    assert!(report["settings"]["run"]["reference_luminance"].is_number(), "the effective value is stored");
    let stored: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.file("r.json")).unwrap()).unwrap();
    assert_eq!(stored, report);

    let info = json(&evis(&folder, "info a.h5 --json"));
    assert_eq!((&info["complete"], &info["events"]), (&true.into(), &events.into()));
    let kinds: Vec<_> = info["cameras"][0]["labels"]
        .as_array()
        .unwrap()
        .iter()
        .map(|l| l["kind"].as_str().unwrap())
        .collect();
    assert_eq!(
        kinds,
        ["depth", "flow_forward", "flow_forward_valid", "flow_backward", "flow_backward_valid"]
    );
    assert!(info["settings_toml"].as_str().unwrap().contains("rate_hz = 500.0"));

    let output = evis(&folder, "preview a.h5 -o a.gif");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
}

#[test]
fn a_run_records_inertial_measurement_units() {
    use evis_core::format::hdf5::Recording;
    use evis_render::{Imu, ImuConfig, ImuNoise};

    let folder = Folder::new("imu");
    if no_device(&folder) {
        return;
    }
    let units = "--imu camera --imu square --imu-rate 400 --imu-noise gyroscope_noise_density=1e-3 \
                 --imu-noise accelerometer_random_walk=2e-3 --seed 3 --start 0.1";
    let output = evis(&folder, &format!("run spinner -o a.h5 {SMALL} {units}"));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let recording = Recording::open(&folder.file("a.h5")).unwrap();
    assert_eq!(recording.imus().unwrap(), ["camera", "square"]);
    let scene = evis_scene::builtin::load("spinner", 3).unwrap();
    let noise =
        ImuNoise { gyroscope_noise_density: 1e-3, accelerometer_random_walk: 2e-3, ..ImuNoise::default() };
    for name in ["camera", "square"] {
        let node = scene.camera_or_node(name).unwrap();
        let config = ImuConfig { rate_hz: 400.0, noise, seed: 3, start_us: 100_000, ..ImuConfig::new(node) };
        let expected = |config| Imu::new(&scene, config).unwrap().advance(&scene, 50_000);
        let found = recording.imu(name).unwrap();
        assert_eq!(found.len(), 20);
        assert!(found == expected(config), "{name}");
        assert!(found != expected(ImuConfig { seed: 4, ..config }), "canary: {name}");
    }
    let info = json(&evis(&folder, "info a.h5 --json"));
    assert_eq!((&info["imus"][1]["name"], &info["imus"][1]["samples"]), (&"square".into(), &20.into()));
    assert!(info["settings_toml"].as_str().unwrap().contains("accelerometer_random_walk = 0.002"));
    let told = stdout(&evis(&folder, "info a.h5"));
    assert!(told.contains("imu camera  20 samples from 0 s to 0.0475 s"), "{told}");
    assert_eq!(code(&evis(&folder, "preview a.h5 -o a.gif")), 0);
    for (bad, words) in [
        ("--imu camra", "did you mean 'camera'?"),
        ("--imu a/b", "slash"),
        ("--imu camera --imu camera", "twice"),
        ("--imu camera --imu-noise gyro=1", "gyroscope_noise_density"),
        ("--imu camera --imu-noise gyroscope_random_walk=-1", "0 or more"),
        ("--imu-rate 100", "--imu"),
    ] {
        let output = evis(&folder, &format!("run spinner -o b.h5 {SMALL} {bad}"));
        assert!(code(&output) == 2 && stderr(&output).contains(words), "{bad}: {}", stderr(&output));
        assert!(!folder.file("b.h5").exists(), "{bad}");
    }
}

#[test]
fn light_that_the_paper_cannot_count_is_warned_of_once() {
    let folder = Folder::new("clipped");
    if no_device(&folder) {
        return;
    }
    let run = |name: &str, reference: &str| {
        let line = format!(
            "run spinner -o {name} --size 64x48 --duration 0.05 --samples 1 --method evis-paper --keyframe-rate 100 \
             --reference-luminance {reference} --json"
        );
        let output = evis(&folder, &line);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        (json(&output), stderr(&output))
    };
    let (report, told) = run("a.h5", "1e-6");
    assert!(report["clipped"].as_u64().unwrap() > 0, "{report}");
    for words in
        ["camera 'camera'", "from 0 us on", "65536 Y_ref", "the --method splat", "--reference-luminance"]
    {
        assert!(told.contains(words), "{words}: {told}");
    }
    assert_eq!(told.matches("pixels of keyframes").count(), 1, "{told}");
    let warned = |report: &serde_json::Value| report["warnings"].to_string().contains("pixels of keyframes");
    assert!(warned(&report));
    let (report, told) = run("b.h5", "0.1");
    assert!(report["clipped"] == 0 && !warned(&report) && !told.contains("pixels of keyframes"), "{told}");
}

#[test]
fn a_run_prints_four_lines_and_more_when_asked() {
    let folder = Folder::new("lines");
    if no_device(&folder) {
        return;
    }
    let short = "--size 32x24 --duration 0.03 --quality draft";
    let scene = "[[primitives]]\nname = \"wall\"\nshape = \"box\"\nsize = [1, 1, 1]\nmaterial = \"white\"\n[[materials]]\nname = \"white\"\n[[lights]]\nname = \"sun\"\nkind = \"directional\"\nintensity = 3.0\n";
    std::fs::write(folder.file("own.toml"), scene).unwrap();
    let first_words = |text: &str| -> Vec<String> {
        text.lines().map(|line| line.split(' ').next().unwrap().to_owned()).collect()
    };
    let told = |line: &str| {
        let output = evis(&folder, line);
        assert_eq!(code(&output), 0, "{line}: {}", stderr(&output));
        (stdout(&output), stderr(&output))
    };
    let (built_in, forecast) = told(&format!("run spinner -o a.h5 {short}"));
    assert_eq!(first_words(&built_in), ["file", "events", "time", "quality"], "{built_in}");
    assert!(built_in.contains("a.h5") && built_in.contains("built-in scenes at 640x480"), "{built_in}");
    assert!(forecast.contains("quality draft") && forecast.contains("0.03 s of stream"), "{forecast}");
    // What was measured on built-in scenes is not said of another one.
    let (own, _) = told(&format!("run own.toml -o b.h5 {short}"));
    assert!(own.contains("not measured on this scene; `chart own.toml`"), "{own}");
    assert!(!own.contains("built-in scenes"), "{own}");
    let (by_hand, _) = told(&format!("run spinner -o c.h5 {SMALL} --verbose"));
    assert!(by_hand.contains("native, set by hand"), "{by_hand}");
    assert_eq!(first_words(&by_hand)[4..], ["view", "device", "method", "work", "stages"], "{by_hand}");
}

#[test]
fn single_values_of_a_sensor_stand_over_preset_and_scene() {
    let folder = Folder::new("set");
    if no_device(&folder) {
        return;
    }
    let sensor = |arguments: &str| {
        let output = evis(&folder, &format!("run spinner -o a.h5 --force --json {SMALL} {arguments}"));
        assert_eq!(code(&output), 0, "{arguments}: {}", stderr(&output));
        json(&output)["settings"]["run"]["sensor"].clone()
    };
    let set = sensor("--sensor v2e --set noise.shot_hz=2 --set threshold_on=0.3");
    assert_eq!((&set["noise"]["shot_hz"], &set["refractory"]["period_us"]), (&2.0.into(), &500.into()));
    std::fs::write(folder.file("s.toml"), "base = \"v2e\"\nthreshold_on = 0.3\n[noise]\nshot_hz = 2\n")
        .unwrap();
    assert_eq!(sensor("--sensor s.toml"), set);
    assert_eq!(sensor("--sensor v2e --set noise.shot_hz=2 --threshold-on 0.3"), set);
    assert_ne!(sensor("--sensor v2e"), set, "canary");
}

#[test]
fn a_preset_its_settings_by_hand_and_a_recordings_settings_give_the_same_bytes() {
    let folder = Folder::new("quality");
    if no_device(&folder) {
        return;
    }
    let line = |name: &str, arguments: &str| {
        format!("run spinner -o {name}.h5 --size 64x48 --duration 0.05 --json {arguments}")
    };
    let run = |name: &str, arguments: &str| {
        let output = evis(&folder, &line(name, arguments));
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        json(&output)
    };
    let counts = |run: &serde_json::Value| (run["events"].clone(), run["on"].clone());
    // What stands first is what a run takes without a word.
    let standard = run("standard", "");
    let settings = &standard["settings"]["run"];
    assert_eq!(settings["quality"], "standard");
    assert!(standard["drawn_pixels"].as_u64().unwrap() > 0 && standard["events"].as_u64().unwrap() > 100);
    if settings["method"] == "decoupled" {
        let by_hand = run("own", &format!("--method decoupled --adaptive {}", settings["adaptive_px"]));
        assert!(by_hand["settings"]["run"]["quality"].is_null());
        assert_eq!(counts(&by_hand), counts(&standard));
        let finer = run("half", "--method decoupled --adaptive 0.3");
        assert_ne!(finer["drawn_pixels"], standard["drawn_pixels"], "canary");
    }
    let draft = run("draft", "--quality draft --threshold-on 0.3 --seed 5");
    let settings = &draft["settings"]["run"];
    let (rate, step, taps) = (&settings["rate_hz"], &settings["adaptive_px"], &settings["texture_taps"]);
    let sampling = if settings["method"] == "decoupled" {
        format!("--method decoupled --adaptive {step}")
    } else {
        let samples = &settings["samples"];
        format!("--rate {rate} --adaptive {step} --antialias edges --samples {samples} --texture-taps {taps}")
    };
    let by_hand = run("hand", &format!("{sampling} --threshold-on 0.3 --seed 5"));
    assert!(by_hand["settings"]["run"]["quality"].is_null());
    assert_eq!(counts(&by_hand), counts(&draft));
    assert_ne!(counts(&draft), counts(&standard), "canary");
    // Flags stand over a recording's settings.
    let again = run("again", "--settings draft.h5");
    assert_eq!(again["settings"]["run"], draft["settings"]["run"]);
    assert_eq!(counts(&again), counts(&draft));
    let finer = run("finer", "--settings draft.h5 --adaptive 0.7");
    assert_eq!(finer["settings"]["run"]["adaptive_px"], 0.7);
    assert_eq!(finer["settings"]["run"]["seed"], 5);
    let over = run("over", "--quality draft --samples 36");
    assert_eq!(
        (&over["settings"]["run"]["method"], &over["settings"]["run"]["samples"]),
        (&"native".into(), &36.into())
    );
    assert!(over["settings"]["run"]["quality"].is_null(), "not the preset's own settings any more");
    let text = evis(&folder, "run spinner -o text.h5 --size 64x48 --duration 0.02");
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    assert!(text.contains("quality  standard") && text.contains("F1 (1 ms)"), "{text}");

    let refused = |arguments: &str, wanted: &[&str]| {
        let output = evis(&folder, &line("no", arguments));
        let text = stderr(&output);
        assert_eq!(code(&output), 2, "{arguments}: {text}");
        assert!(wanted.iter().all(|part| text.contains(part)), "{arguments}: {text}");
    };
    std::fs::write(folder.file("other.toml"), "evis = \"7.1.0\"\n[run]\nsamples = 3\n").unwrap();
    std::fs::write(folder.file("none.toml"), "colour = 3\n").unwrap();
    let version = env!("CARGO_PKG_VERSION");
    std::fs::write(folder.file("typo.toml"), format!("evis = \"{version}\"\n[run]\nsample = 3\n")).unwrap();
    refused("--settings other.toml", &["other.toml", "7.1.0", version]);
    refused("--settings none.toml", &["none.toml is no settings file", "evis tune"]);
    std::fs::write(folder.file("picture.toml"), [0x89, b'P', b'N', b'G', 0xff]).unwrap();
    refused("--settings picture.toml", &["picture.toml is no settings file (it is no text)"]);
    refused("--settings typo.toml", &["typo.toml", "sample", "did you mean 'samples'"]);
    refused("--settings gone.toml", &["gone.toml"]);
    refused("--settings draft.h5 --quality high", &["quality", "high", "settings file"]);
    refused("--quality high --method splat", &["quality", "high", "splat"]);
}

#[test]
fn tune_writes_settings_that_run_takes() {
    let folder = Folder::new("tune");
    if no_device(&folder) {
        return;
    }
    let output = evis(&folder, "tune spinner -o found.toml --size 96x72 --target-f1 0.6");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("* ") && text.contains("whole samples") && text.contains("found.toml"), "{text}");
    let found = std::fs::read_to_string(folder.file("found.toml")).unwrap();
    assert!(found.starts_with("# Found by") && found.contains("adaptive_px"), "{found}");
    let run = evis(&folder, "run spinner -o a.h5 --size 96x72 --duration 0.02 --json --settings found.toml");
    assert_eq!(code(&run), 0, "{}", stderr(&run));
    let settings = &json(&run)["settings"]["run"];
    assert!(settings["quality"].is_null() && settings["adaptive_px"].as_f64().is_some(), "{settings}");
    for (arguments, wanted) in [
        ("tune spinner -o found.toml", &["found.toml", "--force"][..]),
        ("tune spinner -o found.h5", &["found.h5", ".toml"]),
        ("tune spinner -o b.toml --target-f1 1.5", &["--target-f1 is 1.5", "0.98"]),
        ("tune spinner -o b.toml --budget 0", &["budget", "0", "above 0"]),
    ] {
        let output = evis(&folder, arguments);
        let text = stderr(&output);
        assert_eq!(code(&output), 2, "{arguments}: {text}");
        assert!(wanted.iter().all(|part| text.contains(part)), "{arguments}: {text}");
    }
}

#[test]
fn a_sensor_is_a_preset_or_a_file_and_flags_come_before_it() {
    let folder = Folder::new("sensor");
    if no_device(&folder) {
        return;
    }
    let run = |name: &str, arguments: &str| {
        let output = evis(&folder, &format!("run spinner -o {name}.h5 {SMALL} --json {arguments}"));
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        json(&output)
    };
    let preset = run("preset", "--sensor v2e-noisy --seed 3 --frame-rate 50");
    let sensor = &preset["settings"]["run"]["sensor"];
    assert_eq!((&sensor["times"], &sensor["noise"]["shot_hz"]), (&"shared".into(), &5.0.into()));
    std::fs::write(folder.file("own.toml"), "threshold_on = 0.35\n[refractory]\nperiod_us = 9000\n").unwrap();
    let file = run("file", "--sensor own.toml --threshold-on 0.25 --trigger latch");
    let sensor = &file["settings"]["run"]["sensor"];
    assert_eq!((&sensor["threshold_on"], &sensor["trigger"]), (&0.25.into(), &"latch".into()));
    assert!(file["suppressed"].as_u64().unwrap() > 0);
    let info = json(&evis(&folder, "info preset.h5 --json"));
    let settings = info["settings_toml"].as_str().unwrap();
    assert!(settings.contains("shot_hz = 5.0") && settings.contains("leak_jitter"), "{settings}");
    let frames = &info["cameras"][0]["labels"][0];
    assert_eq!((&frames["kind"], &frames["frames"]), (&"frame".into(), &3.into()), "{frames}");
    let events = |report: &serde_json::Value| report["events"].as_u64().unwrap();
    let again = run("again", "--sensor v2e-noisy --seed 3");
    assert_eq!(events(&again), events(&preset), "frames change no event");
    let other = run("other", "--sensor v2e-noisy --seed 4");
    assert_ne!(events(&other), events(&preset), "canary: another seed");
}

#[test]
fn each_camera_has_the_sensor_that_scene_or_flag_gives_it() {
    let folder = Folder::new("cameras");
    if no_device(&folder) {
        return;
    }
    let camera =
        |name: &str, more: &str| format!("[[cameras]]\nname = \"{name}\"\nsize = [48, 36]\n{more}\n");
    let scene = [
        "[[primitives]]\nname = \"bar\"\nshape = \"box\"\nsize = [0.5, 1.2, 0.2]\nposition = [0, 0, -2]\n",
        "material = \"white\"\nmotion = { kind = \"spin\", degrees_per_s = 300, axis = [0, 0, 1] }\n",
        "[[materials]]\nname = \"white\"\nmodel = \"unlit\"\n",
        &camera("left", "sensor = \"davis346\""),
        &camera("right", "threshold_on = 0.25\n[cameras.sensor]\nthreshold_off = 0.3"),
        &camera("top", ""),
    ];
    std::fs::write(folder.file("rig.toml"), scene.concat()).unwrap();
    let run = |name: &str, arguments: &str| -> Vec<(String, String, u64)> {
        let settings = "--duration 0.05 --samples 1 --rate 500 --reference-luminance 0.5";
        let output = evis(&folder, &format!("run rig.toml -o {name}.h5 {settings} {arguments}"));
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let text = evis(&folder, &format!("info {name}.h5"));
        let info = json(&evis(&folder, &format!("info {name}.h5 --json")));
        let of = |camera: &serde_json::Value| {
            let told = |key: &str| camera[key].as_str().unwrap().to_owned();
            let line = format!("  sensor  {}", told("sensor"));
            assert!(String::from_utf8_lossy(&text.stdout).contains(&line), "{line}");
            (told("name"), told("sensor"), camera["events"].as_u64().unwrap())
        };
        info["cameras"].as_array().unwrap().iter().map(of).collect()
    };
    let sensors = |cameras: &[(String, String, u64)]| -> Vec<String> {
        cameras.iter().map(|(_, sensor, _)| sensor.clone()).collect()
    };
    let own = run("own", "");
    assert_eq!(sensors(&own), ["davis346", "of its own, thresholds 0.25 and 0.3", "ideal"]);
    assert!(own.iter().all(|(_, _, events)| *events > 50), "{own:?}");
    for (index, (name, ..)) in own.iter().enumerate() {
        assert_eq!(run(&format!("only-{name}"), &format!("--camera {name}")), own[index..=index]);
    }
    let named = run("named", "--sensor left=evis --sensor top=v2e");
    assert_eq!(sensors(&named), ["evis", "of its own, thresholds 0.25 and 0.3", "v2e"]);
    assert_eq!(named[1], own[1]);
    let rest = run("rest", "--sensor v2e --sensor left=esim --threshold-on 0.4");
    let thresholds = |index: usize| rest[index].1.rsplit_once("thresholds ").unwrap().1;
    assert!(["0.4 and", "0.25 and", "0.4 and"].iter().zip(0..).all(|(t, i)| thresholds(i).starts_with(t)));
    assert_ne!(rest[0].1, rest[2].1, "one is esim's");
    let all = run("all", "--sensor gen4-like --camera left --camera top");
    assert_eq!(sensors(&all), ["gen4-like", "gen4-like"], "--sensor comes before the scene");
}

#[test]
fn times_beyond_the_scene_are_told_once() {
    let folder = Folder::new("beyond");
    if no_device(&folder) {
        return;
    }
    let run = |name: &str, end_s: f64| {
        let line = format!("run {name} -o a.h5 {SMALL} --start {} --json --force", end_s - 0.02);
        let output = evis(&folder, &line);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let told = stderr(&output).matches("the scene's motion ends").count();
        let report = json(&output);
        let warnings = report["warnings"].as_array().unwrap();
        let ends = |w: &&serde_json::Value| w.as_str().unwrap().contains("the scene's motion ends");
        (told, warnings.iter().filter(ends).count())
    };
    let ends = r#"
        duration_s = 0.5
        [[materials]]
        name = "grey"
        [[primitives]]
        name = "ball"
        shape = "sphere"
        radius = 0.3
        material = "grey"
        motion = { kind = "keys", times_s = [0.0, 0.5], positions = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]] }
    "#;
    std::fs::write(folder.file("ends.toml"), ends).unwrap();
    assert_eq!(run("ends.toml", 0.5), (1, 1));
    // Its motion is a formula, which goes on.
    assert_eq!(run("spinner", 4.0), (0, 0));
}

#[test]
fn every_environment_gets_its_file() {
    let folder = Folder::new("environments");
    if no_device(&folder) {
        return;
    }
    let scene = r#"
        [[environments]]
        count = 2
        time_step_s = 0.1

        [[cameras]]
        name = "eye"
        position = [0.0, 0.0, 3.0]

        [[materials]]
        name = "bright"
        model = "unlit"

        [[primitives]]
        name = "box"
        shape = "box"
        size = [1.0, 1.0, 1.0]
        material = "bright"
        motion = { kind = "spin", degrees_per_s = 360.0 }
    "#;
    std::fs::write(folder.file("two.toml"), scene).unwrap();
    let output = evis(&folder, &format!("run two.toml -o a.h5 {SMALL} --json"));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(folder.names(), ["a_0000.h5", "a_0001.h5", "two.toml"]);
    for (file, environment) in [("a_0000.h5", 0), ("a_0001.h5", 1)] {
        let info = json(&evis(&folder, &format!("info {file} --json")));
        assert_eq!((&info["complete"], &info["environment"]), (&true.into(), &environment.into()));
    }
    let again = evis(&folder, &format!("run two.toml -o a.h5 {SMALL}"));
    assert_eq!(code(&again), 2, "{}", stderr(&again));
    assert!(stderr(&again).contains("a_0000.h5"), "{}", stderr(&again));
}

/// Starts a run that would take hours and waits until its file is there.
#[cfg(unix)]
fn long_run(folder: &Folder) -> std::process::Child {
    use std::process::Stdio;
    use std::time::{Duration, Instant};

    let mut child = common::program(folder)
        .args("run spinner -o a.h5 --size 64x48 --duration 100000 --samples 1 --rate 1000".split(' '))
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let started = Instant::now();
    while !folder.file("a.h5").exists() {
        assert!(started.elapsed() < Duration::from_secs(60), "no packet came");
        assert!(child.try_wait().unwrap().is_none(), "the run ended by itself");
        std::thread::sleep(Duration::from_millis(20));
    }
    child
}

#[cfg(unix)]
#[test]
fn ctrl_c_finishes_the_file() {
    use std::io::Read;

    let folder = Folder::new("ctrl-c");
    if no_device(&folder) {
        return;
    }
    let mut child = long_run(&folder);
    std::thread::sleep(std::time::Duration::from_millis(200));
    std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let status = child.wait().unwrap();
    let mut message = String::new();
    child.stderr.take().unwrap().read_to_string(&mut message).unwrap();
    assert_eq!(status.code(), Some(130), "{message}");
    let info = json(&evis(&folder, "info a.h5 --json"));
    assert_eq!(info["complete"], true);
    assert!(info["events"].as_u64().unwrap() > 0);
}

#[cfg(unix)]
#[test]
fn a_killed_run_leaves_what_it_had_flushed() {
    let folder = Folder::new("killed");
    if no_device(&folder) {
        return;
    }
    let mut child = long_run(&folder);
    std::thread::sleep(std::time::Duration::from_millis(1500));
    child.kill().unwrap();
    child.wait().unwrap();
    let cut = json(&evis(&folder, "info a.h5 --json"));
    assert_eq!(cut["complete"], false);
    assert!(cut["events"].as_u64().unwrap() > 0, "{cut}");
    let repaired = json(&evis(&folder, "info a.h5 --repair --json"));
    assert_eq!((&repaired["repaired"]["reopened"], &repaired["events"]), (&true.into(), &cut["events"]));
}

#[test]
fn a_trace_names_the_passes_and_the_steps_of_a_run() {
    let folder = Folder::new("trace");
    if no_device(&folder) {
        return;
    }
    let line = format!("run spinner -o a.h5 {SMALL} --labels depth --trace t.json");
    let output = evis(&folder, &line);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let text = std::fs::read_to_string(folder.file("t.json")).unwrap();
    let entries: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    let with = |track: &dyn Fn(u64) -> bool, name: &str| {
        entries
            .iter()
            .filter(|e| e["ph"] == "X" && track(e["tid"].as_u64().unwrap()) && e["name"] == name)
            .map(|e| e["dur"].as_f64().unwrap())
            .collect::<Vec<_>>()
    };
    let (host, device) = (|track| track > 0, |track| track == 0);
    let steps = ["load scene", "build engine", "deliver", "prepare submission", "wait for device", "write"];
    for name in steps.into_iter().chain(["luminance", "trigger", "geometry labels"]) {
        let lengths = with(&host, name);
        assert!(!lengths.is_empty() && lengths.iter().all(|us| *us >= 0.0), "{name}: {lengths:?}");
    }
    assert!(with(&host, "no such pass").is_empty(), "canary");
    // Devices without timestamps have no track; lavapipe has one.
    let recorded = with(&host, "luminance").len();
    let timed = with(&device, "luminance");
    assert!(timed.is_empty() || timed.len() == recorded, "{} of {recorded}", timed.len());
    assert!(timed.is_empty() || timed.iter().sum::<f64>() > 0.0, "{timed:?}");

    // A trace is one more file that is not written over, and changes no event.
    let again = evis(&folder, &format!("run spinner -o b.h5 {SMALL} --trace t.json"));
    assert_eq!(code(&again), 2, "{}", stderr(&again));
    let plain = evis(&folder, &format!("run spinner -o b.h5 {SMALL} --labels depth"));
    assert_eq!(code(&plain), 0, "{}", stderr(&plain));
    let counts =
        ["a.h5", "b.h5"].map(|file| json(&evis(&folder, &format!("info {file} --json")))["events"].clone());
    assert_eq!(counts[0], counts[1]);
}

#[test]
fn a_body_of_a_scene_file_falls_and_fires_and_rests_in_silence() {
    let folder = Folder::new("rigid-body");
    let scene = r##"
duration_s = 1.0
ambient = [1, 1, 1]
background = [0.4, 0.4, 0.4]
textures = [{ name = "t", pattern = "checker", size = 64 }]
materials = [{ name = "m", texture = "t" }]
primitives = [
  { name = "floor", shape = "plane", size = [3, 3], material = "m", rigid_body = { fixed = true } },
  { name = "box", shape = "box", size = [0.3, 0.2, 0.3], material = "m", position = [0, 0.6, 0], rigid_body = {} },
]
cameras = [{ name = "eye", position = [0, 0.5, 1.6], look_at = [0, 0.3, 0], size = [64, 48] }]
"##;
    let times = |scene: &str| {
        std::fs::write(folder.file("drop.toml"), scene).unwrap();
        // Decoupled sampling needs no device.
        let output = evis(&folder, "run drop.toml -o drop.h5 --force --method decoupled --duration 1");
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let file = evis_format::read_events(&folder.file("drop.h5"), None).unwrap();
        file.events.iter().map(|event| event.t).collect::<Vec<_>>()
    };
    // It falls by half a metre in 0.32 s, and lies still.
    let fallen = times(scene);
    let early = fallen.iter().filter(|t| **t < 320_000).count();
    assert!(early > 500, "{early} events while it falls");
    assert!(fallen.iter().all(|t| *t < 500_000), "the last event is at {:?} us", fallen.last());
    let floating = times(&scene.replace("rigid_body = {} }", "rigid_body = { fixed = true } }"));
    assert!(floating.is_empty(), "canary: nothing moves where it is fixed");

    std::fs::write(folder.file("drop.toml"), scene.replace("= {} }", "= { mas = 2 } }")).unwrap();
    let wrong = evis(&folder, "run drop.toml -o wrong.h5");
    assert_eq!(code(&wrong), 2, "{}", stderr(&wrong));
    let said = stderr(&wrong);
    assert!(said.contains("unknown key 'mas' in [[primitives]] 'box', rigid_body"), "{said}");
}
