//! `verify`: closed forms without a device, and a tiny scene with one.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{Folder, code, evis, json, no_device, stderr, stdout};

#[test]
fn closed_forms_are_verified_and_drawn() {
    let folder = Folder::new("verify");
    let output = evis(&folder, "verify -o a.svg -o a.png");
    assert_eq!(code(&output), 0, "{}{}", stdout(&output), stderr(&output));
    let told = stdout(&output);
    assert!(
        told.contains("sinusoid") && told.contains("18 of 18 rows PASS") && !told.contains("FAIL"),
        "{told}"
    );
    assert!(std::fs::read_to_string(folder.file("a.svg")).unwrap().contains("edge at 20 degrees"));
    assert!(image::open(folder.file("a.png")).unwrap().width() > 1000);
    let report = json(&evis(&folder, "verify --json"));
    assert_eq!(report["checks"].as_array().unwrap().len(), 18);
    assert_eq!(report["checks"][1]["theory"]["order"]["order"], 2.0);
}

#[test]
fn bad_input_is_told_before_any_work() {
    let folder = Folder::new("verify-input");
    for (line, told) in [
        ("verify -o x.pdf", ["x.pdf", ".svg"]),
        ("verify -o no/x.png", ["no/x.png", "create it"]),
        ("verify --size 32x24", ["--scene", "required"]),
        ("verify --scene spiner", ["spiner", "spinner"]),
        ("verify --scene spinner --camera nobody", ["camera", "nobody"]),
        ("verify --scene spinner --rates 0", ["--rates", "'0'"]),
        ("verify --scene spinner --samples 1,0", ["--samples", "'0'"]),
        ("verify --scene spinner --triggers swing", ["--triggers", "crossing, latch"]),
        ("verify --scene spinner --duration 0", ["--duration", "'0'"]),
        ("verify --failures --scene spinner", ["--scene", "cannot be used"]),
        ("verify --failures --size 32x24", ["--size", "cannot be used"]),
        ("verify --failures --methods teleport", ["teleport", "native"]),
        ("verify --failures --only cuts", ["cuts", "cracks"]),
        ("verify --only cut", ["--failures", "required"]),
        ("verify --light spiner", ["spiner", "spinner"]),
        ("verify --light spinner --samples 4,16", ["--samples", "takes one"]),
        ("verify --light spinner --rates 100", ["--rates", "cannot be used"]),
        ("verify --failures --rates 100", ["--rates", "cannot be used"]),
        ("verify --scene spinner --only cut", ["--only", "cannot be used"]),
        ("verify --scene spinner --at 5", ["--at", "cannot be used"]),
        ("verify --at 5", ["--light", "required"]),
    ] {
        let output = evis(&folder, line);
        let message = stderr(&output);
        assert_eq!(code(&output), 2, "{line}\n{message}");
        for words in told {
            assert!(message.contains(words), "{line}: the message lacks '{words}':\n{message}");
        }
        assert!(folder.names().is_empty(), "{line} left something behind");
    }
}

#[test]
fn failure_modes_are_measured_and_light_is_compared() {
    let folder = Folder::new("verify-failures");
    if no_device(&folder) {
        return;
    }
    let line = "verify --failures --methods native,no-aa --only borders --cache cache";
    let output = evis(&folder, &format!("{line} --json -o a.svg"));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    assert_eq!(
        (report["report"].as_str(), report["cells"].as_array().map(Vec::len)),
        (Some("failures"), Some(2))
    );
    assert!(report["cells"][0]["limit"]["reason"].is_string() && report["cells"][1]["limit"].is_null());
    assert!(std::fs::read_to_string(folder.file("a.svg")).unwrap().contains("borders without margin"));

    let line = "verify --light spinner --size 32x24 --samples 4 --at 0.02 --shadows rays -o b.png";
    let output = evis(&folder, line);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let told = stdout(&output);
    for words in
        ["spinner: 32x24 pixels at 20 ms, 4 samples, shadows by rays", "interior", "worst pixels", "b.png"]
    {
        assert!(told.contains(words), "the table lacks '{words}':\n{told}");
    }
    assert!(image::open(folder.file("b.png")).unwrap().width() > 1000);
}

#[test]
fn a_scene_is_verified() {
    let folder = Folder::new("verify-scene");
    if no_device(&folder) {
        return;
    }
    // The built-in sensor is not keen, so that a picture of 32x24 needs time to fire.
    let line = "verify --scene spinner --size 32x24 --duration 0.04 --truth-pixels 100 --rates 250,1000 --samples 4 \
                --triggers crossing,latch --cache cache";
    let output = evis(&folder, &format!("{line} --json -o a.svg"));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    assert_eq!((report["report"].as_str(), report["chart"]["width"].as_u64()), (Some("scene"), Some(32)));
    assert_eq!(report["chart"]["points"].as_array().unwrap().len(), 4);
    assert_eq!(report["chart"]["points"][0]["setting"]["trigger"], "crossing");
    assert!(std::fs::read_to_string(folder.file("a.svg")).unwrap().contains("crossing, 4 samples"));
}
