//! `chart`: bad input without a device, and a tiny chart with one.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{Folder, code, evis, json, no_device, stderr, stdout};
use evis_core::Truth;

const TINY: &str = "--size 32x24 --duration 0.02 --rates 100,500 --samples 4 --no-edges --repetitions 2 \
                    --truth-pixels 120 --no-floor --cache cache --threshold-on 0.05 --threshold-off 0.05";

fn refused(folder: &Folder, line: &str, told: &[&str]) {
    let before = folder.names();
    let output = evis(folder, line);
    let message = stderr(&output);
    assert_eq!(code(&output), 2, "{line}\n{message}");
    for words in told {
        assert!(message.contains(words), "{line}: the message lacks '{words}':\n{message}");
    }
    assert_eq!(folder.names(), before, "{line} left something behind");
}

#[test]
fn bad_input_is_told_before_any_work() {
    let folder = Folder::new("chart-input");
    std::fs::write(folder.file("newer.json"), "{\"evis_chart\": 99, \"scenes\": []}").unwrap();
    std::fs::write(folder.file("none.json"), "{\"evis_chart\": 1, \"scenes\": []}").unwrap();
    std::fs::write(folder.file("other.json"), "[1, 2]").unwrap();
    refused(&folder, "chart", &["SCENE"]);
    refused(&folder, "chart spiner -o x.png", &["spiner", "spinner"]);
    refused(&folder, "chart spinner -o x.pdf", &["x.pdf", ".svg"]);
    refused(&folder, "chart spinner -o no/x.png", &["no/x.png", "create it"]);
    refused(&folder, "chart spinner -o x.png --report no/r.json", &["--report", "no/r.json"]);
    refused(&folder, "chart spinner --camera nobody", &["nobody"]);
    refused(&folder, "chart spinner --from newer.json", &["--from"]);
    refused(&folder, "chart --from newer.json --size 32x24", &["--from", "--size"]);
    refused(&folder, "chart --from newer.json --animation up", &["--from", "--animation"]);
    refused(&folder, "chart --from newer.json -o x.png", &["newer.json", "version 99"]);
    refused(&folder, "chart --from none.json", &["none.json", "no scene"]);
    refused(&folder, "chart --from other.json", &["other.json", "no chart"]);
    refused(&folder, "chart --from missing.json", &["missing.json"]);
    for (arguments, told) in [
        ("--budget 0", ["--budget", "'0'", "1000"]),
        ("--target-f1 1.5", ["--target-f1", "'1.5'", "0.98"]),
        ("--render-ms -1", ["--render-ms", "'-1'", "from 0"]),
        ("--f1 2ms", ["--f1", "'2ms'", "100us, 300us, 1ms"]),
        ("--rates 100,0", ["--rates", "'0'", "above 0"]),
        ("--samples 0", ["--samples", "'0'", "from 1 to 256"]),
        ("--repetitions 0", ["--repetitions", "'0'", "from 1"]),
        ("--truth-pixels none", ["--truth-pixels", "'none'", "all"]),
    ] {
        refused(&folder, &format!("chart spinner {arguments}"), &told);
    }
}

#[test]
fn a_scene_is_charted_and_drawn_again() {
    let folder = Folder::new("chart");
    if no_device(&folder) {
        return;
    }
    let output = evis(
        &folder,
        &format!("chart spinner -o a.png -o a.svg --report r.json --no-splat --no-adaptive {TINY}"),
    );
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let told = stdout(&output);
    assert!(
        told.contains("real time") && told.contains("F1 0.98"),
        "both usual goals are spoken of:\n{told}"
    );
    let svg = std::fs::read_to_string(folder.file("a.svg")).unwrap();
    assert!(svg.contains("32×24 pixels") && svg.contains("paper 1000 Hz"));
    assert!(image::open(folder.file("a.png")).unwrap().width() > 1000);
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(folder.file(name)).unwrap()).unwrap()
    };
    let points = read("r.json")["scenes"][0]["points"].as_array().unwrap().len();
    // Two rates, and the five published settings.
    assert_eq!(points, 7);

    // The same as JSON on standard output, and nothing beside it.
    let printed = evis(&folder, "chart --from r.json --json");
    assert_eq!(json(&printed), read("r.json"));

    // A heavier renderer, from the same measurement.
    let output = evis(&folder, "chart --from r.json -o b.svg --render-ms 10 --budget 1e9");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(std::fs::read_to_string(folder.file("b.svg")).unwrap().contains("charged 10 ms"));
    let command = stdout(&output).lines().last().unwrap().trim().to_owned();
    assert!(command.starts_with("evis-rs run spinner -o events.h5 --size 32x24 --rate "), "{command}");
    assert!(command.ends_with("--threshold-on 0.05 --threshold-off 0.05"), "{command}");

    // The command that is recommended runs.
    let line = command.strip_prefix("evis-rs ").unwrap();
    let output = evis(&folder, &format!("{line} --duration 0.01 --json"));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(json(&output)["instants"].as_u64().unwrap() > 0);

    let poor = evis(&folder, "chart --from r.json --budget 0.0001");
    assert_eq!(code(&poor), 2);
    assert!(stderr(&poor).contains("the cheapest is"), "{}", stderr(&poor));
}

#[test]
fn a_scene_in_which_little_or_nothing_fires_says_so() {
    let folder = Folder::new("chart-quiet");
    if no_device(&folder) {
        return;
    }
    let scene = |motion: &str| {
        format!(
            "[[materials]]\nname = \"white\"\nmodel = \"unlit\"\n[[primitives]]\nname = \"card\"\nshape = \"card\"\n\
             size = [0.3, 0.3]\nmaterial = \"white\"\nposition = [0.0, 0.1, 0.0]\n{motion}[[cameras]]\nname = \"eye\"\n\
             position = [0.0, 0.0, 3.0]\n"
        )
    };
    let moving = "motion = { kind = \"constant_velocity\", velocity = [1.0, 0.0, 0.0] }\n";
    std::fs::write(folder.file("still.toml"), scene("")).unwrap();
    std::fs::write(folder.file("small.toml"), scene(moving)).unwrap();
    let settings = "--size 64x48 --duration 0.05 --rates 100 --samples 1 --no-splat --no-adaptive --no-edges \
                    --repetitions 1 --truth-pixels 400";

    let still = evis(&folder, &format!("chart still.toml {settings}"));
    assert_eq!(code(&still), 2, "{}", stderr(&still));
    let told = stderr(&still);
    assert!(told.contains("none of the 4") && told.contains("fires within 0.05 s"), "{told}");
    assert!(!told.contains("truth once more"), "it ends before the second truth: {told}");

    // The hundred pixels that tell truth's own error meet nothing, the four hundred do.
    let small = evis(&folder, &format!("chart small.toml {settings} --report r.json"));
    assert_eq!(code(&small), 0, "{}", stderr(&small));
    let report: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.file("r.json")).unwrap()).unwrap();
    let truth = &report["scenes"][0]["truth"];
    assert!(truth["events"].as_u64().unwrap() > 0 && truth["floor"].is_null(), "{truth}");
    let count = |key: &str| truth[key].as_u64().unwrap();
    assert!((1..=count("events")).contains(&count("firing")), "{truth}");
    let told = format!(
        "figures are rough: truth has few events ({}, at {} of its {} pixels,",
        count("events"),
        count("firing"),
        count("pixels")
    );
    let warned = stderr(&small);
    assert!(warned.contains(&told) && warned.contains("--truth-pixels "), "{warned}");
}

#[test]
fn truth_becomes_a_file_that_scores_a_run() {
    let folder = Folder::new("truth");
    let small = "--size 32x24 --duration 0.02 --threshold-on 0.05 --threshold-off 0.05";
    for (arguments, told) in [
        ("truth spinner -o t.txt", ["t.txt", ".h5"]),
        ("truth spiner -o t.h5", ["spiner", "spinner"]),
        ("truth spinner -o t.h5 --camera nobody --cache cache", ["camera", "nobody"]),
        ("truth spinner -o t.h5 --crop 1,2,3", ["--crop", "such as 40,30,80,60"]),
        ("truth spinner -o t.h5 --crop 0,0,9,9 --truth-pixels 5", ["--crop", "--truth-pixels"]),
        ("truth spinner -o t.h5 --sampled 0", ["--sampled", "such as 1000"]),
        ("truth spinner -o t.h5 --trigger latch", ["--trigger", "--sampled"]),
    ] {
        std::fs::create_dir_all(folder.file("cache")).unwrap();
        refused(&folder, arguments, &told);
    }
    let output = evis(&folder, &format!("truth spinner -o t.h5 {small} --crop 8,6,16,12 --cache cache"));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert!(stdout(&output).contains("192 pixels"), "{}", stdout(&output));
    refused(&folder, "truth spinner -o t.h5", &["t.h5", "--force"]);

    // Exact light at a rate is scored as a stream is, and named where it stands for truth.
    let line = format!("truth spinner -o s.h5 {small} --crop 8,6,16,12 --cache cache --sampled 2000");
    let output = evis(&folder, &line);
    assert!(stdout(&output).contains("sampled at 2000 Hz"), "{}{}", stdout(&output), stderr(&output));
    assert!(!stdout(&output).contains("audit"), "{}", stdout(&output));
    let output = evis(&folder, "score s.h5 --truth t.h5 --json");
    assert_eq!((code(&output), stderr(&output).as_str()), (0, ""));
    let tolerances = &json(&output)["score"]["tolerances"];
    let [wide, narrow] =
        [&tolerances[0]["scaled"], &tolerances[2]["plain"]].map(|t| t["f1"].as_f64().unwrap());
    assert!(
        wide > 0.9 && (0.5..1.0).contains(&narrow),
        "{}",
        stdout(&evis(&folder, "score s.h5 --truth t.h5"))
    );
    let output = evis(&folder, "score t.h5 --truth s.h5");
    assert!(
        stderr(&output).contains("s.h5 is no truth but exact light sampled at 2000 Hz"),
        "{}",
        stderr(&output)
    );
    if no_device(&folder) {
        return;
    }
    let output = evis(&folder, &format!("run spinner -o e.h5 {small} --rate 1000 --samples 16"));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let output = evis(&folder, "score e.h5 --truth t.h5 --json");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    assert_eq!(json(&output)["score"]["pixels"], 192);
}

#[test]
fn truth_has_the_thresholds_of_the_scene_s_own_sensor() {
    let folder = Folder::new("truth-sensor");
    let scene = r#"
[[materials]]
name = "white"
[[primitives]]
name = "wall"
shape = "box"
size = [1, 1, 1]
material = "white"
[[cameras]]
name = "left"
[cameras.sensor]
threshold_on = 0.31
log_eps = 0.02
noise = { shot_hz = 2 }
refractory = { period_us = 100 }
[[cameras]]
name = "right"
[cameras.sensor]
threshold_off = 0.17
"#;
    std::fs::write(folder.file("scene.toml"), scene).unwrap();
    let made = |flags: &str| {
        let line =
            "truth scene.toml -o t.h5 --force --size 8x6 --duration 0.001 --truth-pixels 2 --cache cache";
        let output = evis(&folder, &format!("{line} {flags}"));
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let sensor = Truth::read(&folder.file("t.h5")).unwrap().sensor;
        ([sensor.threshold_on, sensor.threshold_off, sensor.log_eps], stderr(&output))
    };
    let (numbers, told) = made("");
    assert_eq!(numbers, [0.31, 0.2, 0.02]);
    assert!(told.contains("'left'") && told.contains("(noise, refractory)"), "{told}");
    assert_eq!(made("--threshold-on 0.4 --log-eps 0.001").0, [0.4, 0.2, 0.001]);
    let (numbers, told) = made("--camera right");
    assert_eq!(numbers, [0.2, 0.17, 1e-3]);
    assert!(!told.contains("'right'") && told.contains("nothing moves"), "{told}");
}
