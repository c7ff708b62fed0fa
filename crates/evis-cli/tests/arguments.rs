//! Bad input: exit code 2, a message that names value and remedy, and nothing left behind.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{Folder, code, evis, json, stderr, stdout, write_recording};

/// Runs `line`, which must be refused with exit code 2, tell every one of `told`, and leave no file.
fn refused(folder: &Folder, line: &str, told: &[&str]) {
    let before = folder.names();
    let output = evis(folder, line);
    let message = stderr(&output);
    assert_eq!(code(&output), 2, "{line}\n{message}");
    for words in told {
        assert!(message.contains(words), "{line}: the message lacks '{words}':\n{message}");
    }
    assert!(!message.contains("panicked"), "{line}\n{message}");
    assert_eq!(folder.names(), before, "{line} left something behind");
}

#[test]
fn impossible_numbers_name_flag_value_and_remedy() {
    let folder = Folder::new("numbers");
    let second = "a number of seconds";
    for (arguments, told) in [
        ("--duration -1", ["--duration", "'-1'", second]),
        ("--duration 0", ["--duration", "'0'", second]),
        ("--duration nan", ["--duration", "'nan'", second]),
        ("--duration 1e300", ["--duration", "'1e300'", second]),
        ("--duration soon", ["--duration", "'soon'", second]),
        ("--start -0.5", ["--start", "'-0.5'", second]),
        ("--start inf", ["--start", "'inf'", second]),
        ("--size 0x480", ["--size", "'0x480'", "640x480"]),
        ("--size 640x0", ["--size", "'640x0'", "640x480"]),
        ("--size 99999x99999", ["--size", "'99999x99999'", "8192"]),
        ("--size 640", ["--size", "'640'", "640x480"]),
        ("--rate 0", ["--rate", "'0'", "above 0"]),
        ("--rate -30", ["--rate", "'-30'", "above 0"]),
        ("--rate nan", ["--rate", "'nan'", "above 0"]),
        ("--label-rate 0", ["--label-rate", "'0'", "above 0"]),
        ("--threshold-on 0", ["--threshold-on", "'0'", "0.2"]),
        ("--threshold-off -0.2", ["--threshold-off", "'-0.2'", "0.2"]),
        ("--threshold-on nan", ["--threshold-on", "'nan'", "0.2"]),
        ("--log-eps 0", ["--log-eps", "'0'", "above 0"]),
        ("--reference-luminance -1", ["--reference-luminance", "'-1'", "above 0"]),
        ("--samples 0", ["--samples", "'0'", "from 1 to 256"]),
        ("--samples 257", ["--samples", "'257'", "from 1 to 256"]),
        ("--seed -1", ["--seed", "'-1'", "from 0"]),
        ("--method splat --steps 0", ["--steps", "'0'", "from 1 to 1000"]),
        ("--method splat --margin -1", ["--margin", "'-1'", "from 0 to 512"]),
        ("--method splat --keyframe-rate 200000", ["steps", "8", "at most 5"]),
        ("--method splat --rate 500", ["--rate", "500", "--keyframe-rate"]),
        ("--keyframe-rate 30", ["--keyframe-rate", "--method splat", "keyframes"]),
        ("--trigger lazy", ["--trigger", "'lazy'", "crossing, latch"]),
        ("--quality high --method splat", ["quality", "high", "splat"]),
        ("--quality fine", ["--quality", "'fine'", "draft"]),
        ("--settings no.toml", ["no.toml", "cannot", "read"]),
        ("--adaptive 0", ["--adaptive", "0", "above 0"]),
        ("--adaptive nan", ["--adaptive", "NaN", "above 0"]),
        ("--samples 6 --antialias edges", ["samples", "6", "36"]),
        ("--adaptive 0.3 --method splat", ["--adaptive", "0.3", "native"]),
        ("--method fast", ["--method", "'fast'", "native"]),
        ("--labels depth,color", ["--labels", "'color'", "hdr"]),
        ("--sensor v2f", ["did you mean 'v2e'", "v2f", "gen4-like"]),
        ("--set noise.shot_rate_hz=1", ["--set", "noise.shot_rate_hz=1", "did you mean 'noise.shot_hz'"]),
        ("--set threshold_on=-1", ["--threshold-on", "-1", "above 0"]),
        ("--labels dept", ["'dept'", "depth", "a similar value exists"]),
        ("--sensor v2e --sensor evis", ["--sensor evis", "all cameras", "one of them"]),
        ("--sensor camera=v2f", ["--sensor", "v2f", "gen4-like"]),
        ("--sensor nobody=v2e", ["'nobody'", "no camera", "there is"]),
        ("--sensor no/such.toml", ["--sensor", "no/such.toml", "cannot be read"]),
        ("--sensor v2e --rate 0.001", ["rate", "every 1000 s", "268"]),
        ("--frame-rate 0", ["--frame-rate", "'0'", "above 0"]),
        ("--frame-rate 30 --exposure-ms 40", ["exposure", "40000 us", "33332"]),
        ("--exposure-ms 5", ["--exposure-ms", "5", "--frame-rate"]),
    ] {
        refused(&folder, &format!("run spinner -o x.h5 {arguments}"), &told);
    }
}

#[test]
fn a_scenes_sensor_that_cannot_be_is_named_with_file_key_and_value() {
    let folder = Folder::new("scene-sensor");
    let write = |name: &str, sensor: &str| {
        let wall = "[[primitives]]\nname = \"wall\"\nshape = \"box\"\nsize = [1, 1, 1]\nmaterial = \"white\"\n[[materials]]\nname = \"white\"\n";
        let text = format!("{wall}[[cameras]]\nname = \"front\"\n{sensor}\n");
        std::fs::write(folder.file(name), text).unwrap();
    };
    write("preset.toml", "sensor = \"davis345\"");
    refused(
        &folder,
        "run preset.toml -o x.h5",
        &["preset.toml", "'front'", "sensor", "davis345", "davis346"],
    );
    write("value.toml", "sensor = { threshold_on = -0.2 }");
    refused(
        &folder,
        "run value.toml -o x.h5",
        &["value.toml", "'front'", "sensor", "threshold_on", "-0.2", "above 0"],
    );
    write("file.toml", "sensor = \"sensors/none.toml\"");
    refused(
        &folder,
        "run file.toml -o x.h5",
        &["file.toml", "'front'", "sensors/none.toml", "cannot be read"],
    );
    write("kind.toml", "sensor = 7");
    refused(&folder, "run kind.toml -o x.h5", &["kind.toml", "'front'", "sensor", "7", "preset"]);
    // It is what is taken: noise cannot wait for a thousand seconds. Canary: not where --sensor comes before it.
    write("good.toml", "sensor = \"v2e\"");
    refused(&folder, "run good.toml -o x.h5 --rate 0.001", &["rate", "more than thresholds"]);
    for other in ["--sensor ideal", "--sensor front=ideal"] {
        refused(
            &folder,
            &format!("run good.toml -o x.h5 --rate 0.001 {other} --device none-such"),
            &["none-such"],
        );
    }
    refused(
        &folder,
        "run good.toml -o x.h5 --sensor front=evis --sensor front=v2e",
        &["front=v2e", "'front'"],
    );
}

#[test]
fn sensor_files_name_the_stage_that_is_wrong() {
    let folder = Folder::new("sensors");
    for (text, told) in [
        ("[noise]\nleak_hz = -1", ["s.toml", "line 2: noise.leak_hz", "-1"]),
        ("base = \"v2e\"\nthreshold_on = \"a\"", ["s.toml", "line 2", "expected a number"]),
        ("[noise]\nleek_hz = 1", ["s.toml", "line 2", "did you mean 'leak_hz'"]),
        ("[refractory]\nrule = \"wait\"", ["s.toml", "wait", "hold"]),
        ("[photoreceptor]\ncutoff_hz = 1e6", ["s.toml", "photoreceptor.cutoff_hz", "500000"]),
        ("[readout]\nrow_ns = 2000000", ["s.toml", "readout.row_ns", "1000000"]),
    ] {
        std::fs::write(folder.file("s.toml"), text).unwrap();
        refused(&folder, "run spinner -o x.h5 --sensor s.toml", &told);
    }
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_any_work() {
    let folder = Folder::new("outputs");
    std::fs::write(folder.file("old.h5"), "precious").unwrap();
    std::fs::create_dir(folder.file("folder.h5")).unwrap();
    refused(&folder, "run spinner -o old.h5", &["old.h5", "--force"]);
    refused(&folder, "run spinner -o no/such/x.h5", &["no/such", "create it"]);
    refused(&folder, "run spinner -o folder.h5", &["folder.h5", "file name"]);
    refused(&folder, "run spinner -o x.txt", &["x.txt", ".h5"]);
    refused(&folder, "run spinner -o x.h5 --report no/r.json", &["--report", "no/r.json"]);
    // Nothing is a report's place that is another file's.
    std::fs::write(folder.file("own.toml"), "precious").unwrap();
    for (line, words) in [
        ("run spinner -o x.h5 --report old.h5", ["--report", "--force"]),
        ("run spinner -o x.h5 --report x.h5", ["--report", "--output"]),
        ("run spinner -o x.h5 --trace old.h5", ["--trace", "--force"]),
        ("run spinner -o x.h5 --trace x.h5", ["--trace", "--output"]),
        ("run spinner -o x.h5 --report r.json --trace r.json", ["--trace", "--report"]),
        ("run spinner -o x.h5 --trace t.json --sensor v2f", ["did you mean", "v2f"]),
        ("video own.toml -o x.h5 --fps 10 --trace own.toml --force", ["--trace", "the input"]),
        ("run spinner -o old.h5 --report ./old.h5 --force", ["--report", "--output"]),
        ("run own.toml -o x.h5 --report own.toml --force", ["--report", "the scene"]),
        ("run spinner -o x.h5 --settings p.toml --report ./p.toml", ["--report", "--settings"]),
        ("video own.toml -o x.h5 --fps 10 --report own.toml --force", ["--report", "the input"]),
        ("video own.toml -o x.h5 --fps 10 --report old.h5", ["--report", "--force"]),
    ] {
        refused(&folder, line, &words);
    }
    for kept in ["old.h5", "own.toml"] {
        assert_eq!(std::fs::read(folder.file(kept)).unwrap(), b"precious", "{kept}");
    }
}

#[test]
fn scenes_and_cameras_that_do_not_exist_are_listed() {
    let folder = Folder::new("scenes");
    std::fs::write(folder.file("broken.glb"), "not a glb").unwrap();
    let known = json(&evis(&folder, "scenes --json"));
    let known: Vec<_> = known.as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert!(!known.is_empty());
    refused(&folder, "run werehouse -o x.h5", &["werehouse", known[0], ".glb", "did you mean 'warehouse'"]);
    refused(&folder, "run in.mp4 -o x.h5", &["in.mp4", "is a film", "`video in.mp4"]);
    refused(&folder, "video spinner -o x.h5", &["spinner is a scene", "`run spinner"]);
    refused(&folder, "video broken.glb -o x.h5", &["broken.glb is a scene", "`run broken.glb"]);
    refused(&folder, "run none.glb -o x.h5", &["none.glb"]);
    refused(&folder, "run none.toml -o x.h5", &["none.toml"]);
    refused(&folder, "run broken.glb -o x.h5", &["broken.glb"]);
    refused(&folder, &format!("run {} -o x.h5 --camera nobody", known[0]), &["camera", "nobody"]);
}

#[test]
fn near_misses_are_answered_with_what_was_meant() {
    let folder = Folder::new("near");
    for (line, told) in [
        ("run spinner -o x.h5 --labels depth flow", "--labels depth,flow"),
        ("run --labels depth flow instance spinner -o x.h5", "--labels depth,flow,instance"),
        ("rnu spinner -o x.h5", "'run'"),
        ("rn spinner -o x.h5", "'run'"),
        ("evalute reconstruct a.h5", "'evaluate'"),
        ("plot a.h5 -o x.png", "`evis plot` is a command of the Python package"),
    ] {
        refused(&folder, line, &["tip: ", told]);
    }
    // Canaries: nothing is near, one label is no list.
    for line in ["xyzzy", "run spinner extra -o x.h5 --labels depth"] {
        let output = evis(&folder, line);
        assert!(code(&output) == 2 && !stderr(&output).contains("tip: "), "{}", stderr(&output));
    }
}

#[test]
fn a_forced_run_that_cannot_start_keeps_the_old_file() {
    let folder = Folder::new("forced");
    std::fs::write(folder.file("old.h5"), "precious").unwrap();
    refused(&folder, "run spinner -o old.h5 --force --device no-such-device", &[]);
    assert_eq!(std::fs::read(folder.file("old.h5")).unwrap(), b"precious");
}

#[test]
fn recordings_that_cannot_be_read_are_refused() {
    let folder = Folder::new("recordings");
    std::fs::write(folder.file("not.h5"), "not HDF5").unwrap();
    std::fs::write(folder.file("empty.h5"), "").unwrap();
    write_recording(&folder.file("good.h5"), false, true);
    for file in ["missing.h5", "not.h5", "empty.h5"] {
        refused(&folder, &format!("info {file}"), &[file]);
        refused(&folder, &format!("info --repair {file}"), &[file]);
        refused(&folder, &format!("preview {file} -o x.png"), &[file]);
    }
    refused(&folder, "preview good.h5 -o x.bmp", &["x.bmp", ".gif"]);
    refused(&folder, "preview good.h5 -o no/x.png", &["no/x.png"]);
    refused(&folder, "preview good.h5 -o x.png --camera middle", &["middle", "left, right"]);
    refused(&folder, "preview good.h5 -o x.png --camera rigth", &["rigth", "did you mean 'right'"]);
    refused(&folder, "info good.h5 --camera middle", &["'middle'", "there is left, right"]);
    refused(&folder, "info good.h5 --camera rigth", &["'rigth'", "did you mean 'right'"]);
    refused(&folder, "info spinner --camera middle", &["middle", "spinner is a scene"]);
    refused(&folder, "convert good.h5 x.raw --start 5 --end 1", &["--end is 1", "--start 5"]);
    refused(&folder, "tune spinner -o x.toml --target-f1 2", &["--target-f1 is 2", "above 0 and below 1"]);
    refused(&folder, "compare good.h5 good.h5 -o x.foo", &["--output is x.foo", ".svg"]);
    refused(&folder, "video good.h5 -o x.h5", &["good.h5 holds events", "`info good.h5`"]);
    refused(&folder, "preview good.h5 -o x.png --at 5", &["--at", "5"]);
    refused(&folder, "preview good.h5 -o x.png --scale 3/2", &["--scale", "3/2"]);
    refused(&folder, "preview good.h5 -o x.png --label smell", &["--label", "'smell'", "depth"]);
    refused(&folder, "preview good.h5 -o x.png --window-ms 0", &["--window-ms", "'0'"]);
    refused(&folder, "preview good.h5 -o x.gif --fps 0", &["--fps", "'0'"]);
    // Canary: the same line with sound values is taken.
    let output = evis(&folder, "preview good.h5 -o x.png --at 0.1");
    assert_eq!(code(&output), 0, "{}", stderr(&output));
}

#[test]
fn help_shows_the_name_that_the_program_was_called_by() {
    let folder = Folder::new("help");
    let help = stdout(&evis(&folder, "run --help"));
    assert!(help.contains("Usage: evis-rs run"), "{help}");
    for word in ["640x480", "1000", "0.2", "0.001", "native", "[default: 50]", "[default: 0]"] {
        assert!(help.contains(word), "the help lacks '{word}'");
    }
    #[cfg(unix)]
    {
        let link = folder.file("evis");
        std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_evis-rs"), &link).unwrap();
        let output = std::process::Command::new(link).arg("--version").output().unwrap();
        assert!(stdout(&output).starts_with("evis "), "{}", stdout(&output));
    }
}

#[test]
fn short_help_completions_sensors_and_the_command_of_v2e_are_printed() {
    let folder = Folder::new("printed");
    let short = stdout(&evis(&folder, "run -h"));
    assert!(short.contains("Examples:\n  evis-rs run ") && short.lines().count() <= 30, "{short}");
    assert!(!short.contains("--texture-taps"), "{short}");
    let short = stdout(&evis(&folder, "-h"));
    assert!(short.contains("Examples:\n  evis-rs run ") && short.lines().count() <= 30, "{short}");
    for shell in ["bash", "zsh", "fish"] {
        let script = stdout(&evis(&folder, &format!("completions {shell}")));
        assert!(script.contains("evis-rs") && script.contains("label-rate"), "{shell}");
    }
    let sensors = json(&evis(&folder, "sensors --json"));
    let v2e = sensors.as_array().unwrap().iter().find(|sensor| sensor["name"] == "v2e").unwrap();
    assert!(v2e["source"].as_str().unwrap().contains("command-line defaults"), "{v2e}");
    assert!(v2e["models"].to_string().contains("leak (0.01 Hz)"), "{v2e}");
    let output = evis(&folder, "from-v2e -- v2e.py -i in.mp4 --pos_thres 0.15 --crop (1,1,0,0)");
    assert_eq!(
        stdout(&output).trim(),
        "evis-rs video in.mp4 -o events.h5 --like v2e --set threshold_on=0.15"
    );
    assert!(stderr(&output).contains("--crop is left out"), "{}", stderr(&output));
    refused(&folder, "from-v2e -- -i in.mp4 --pos_tres 1", &["--pos_tres", "did you mean '--pos_thres'"]);
    let version = stdout(&evis(&folder, "--version"));
    assert!(version.starts_with(&format!("evis-rs {}", env!("CARGO_PKG_VERSION"))), "{version}");
}

/// Opening a pipe waits for its writer, and a device may have no end: neither is read, whatever names it.
#[cfg(unix)]
#[test]
fn pipes_and_devices_are_refused_wherever_a_file_is_named() {
    let folder = Folder::new("pipes");
    for ending in
        ["npy", "npz", "h5", "raw", "dat", "aedat4", "csv", "bag", "mp4", "png", "toml", "gltf", "json"]
    {
        let made = std::process::Command::new("mkfifo").arg(folder.file(&format!("p.{ending}"))).status();
        assert!(made.unwrap().success());
    }
    let still = "materials = [{ name = 'grey' }]\nprimitives = [{ name = 'box', shape = 'box', size = [1, 1, 1], material = 'grey' }]";
    std::fs::write(folder.file("still.toml"), still).unwrap();
    let events = ["npy", "npz", "h5", "raw", "dat", "aedat4", "csv", "bag"];
    let of_events = events.into_iter().flat_map(|ending| {
        let file = format!("p.{ending}");
        [format!("info {file}"), format!("convert {file} o.npy")]
    });
    let others = [
        "compare p.h5 p.npy",
        "info --check p.h5",
        "info --repair p.h5",
        "preview p.h5 -o o.png",
        "score --truth p.h5 p.h5",
        "calibrate p.h5 -o o.toml",
        "info p.toml",
        "run p.gltf -o o.h5",
        "run spinner -o o.h5 --sensor p.toml",
        "run spinner -o o.h5 --settings p.toml",
        "run spinner -o o.h5 --settings p.h5",
        "run still.toml -o o.h5 --camera-motion p.csv",
        "video p.npy -o o.h5 --fps 30",
        "video p.mp4 -o o.h5",
        "chart --from p.json -o o.png",
    ];
    // At once, and ended where one waits.
    let lines = of_events.chain(others.map(String::from)).enumerate();
    // They run side by side: each has an output of its own.
    let lines: Vec<String> = lines.map(|(k, line)| line.replace(" o.", &format!(" o{k}."))).collect();
    let mut started: Vec<_> = lines
        .iter()
        .map(|line| {
            let mut command = common::program(&folder);
            command.args(line.split_whitespace()).stderr(std::process::Stdio::piped());
            (line, command.spawn().unwrap())
        })
        .collect();
    let until = std::time::Instant::now() + std::time::Duration::from_secs(60);
    while started.iter_mut().any(|(_, child)| child.try_wait().unwrap().is_none()) {
        if std::time::Instant::now() > until {
            started.iter_mut().for_each(|(_, child)| drop(child.kill()));
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    for (line, child) in started {
        let output = child.wait_with_output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{line}: {told}");
        assert!(told.contains("only regular files are read"), "{line}: {told}");
    }
}
