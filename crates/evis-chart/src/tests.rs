//! Whole pictures, from made-up measurements.

use crate::draw::{png, svg};
use crate::made_up::scene_chart;
use crate::result::{ChartResult, Criteria};

fn charging(render_ms: f64) -> Criteria {
    Criteria { render_ms, ..Criteria::default() }
}

/// Texts of an SVG, in order.
fn texts(svg: &str) -> Vec<String> {
    let inner = svg.split("<text").skip(1).filter_map(|t| t.split_once('>')?.1.split_once("</text"));
    inner.map(|(text, _)| text.trim().replace("&apos;", "'")).collect()
}

#[test]
fn the_svg_says_everything() {
    let chart = ChartResult::new(vec![scene_chart("spinner"), scene_chart("warehouse")]);
    let svg = svg(&chart, charging(10.0)).unwrap();
    if let Some(folder) = std::env::var_os("EVIS_LOOK") {
        let folder = std::path::PathBuf::from(folder);
        std::fs::write(folder.join("two.svg"), &svg).unwrap();
        std::fs::write(folder.join("two.png"), png(&chart, charging(10.0)).unwrap()).unwrap();
        let four = ["spinner", "warehouse", "street", "desk"].map(scene_chart).to_vec();
        std::fs::write(folder.join("four.png"), png(&ChartResult::new(four), charging(0.0)).unwrap())
            .unwrap();
        let one = ChartResult::new(vec![scene_chart("spinner")]);
        std::fs::write(folder.join("one.png"), png(&one, charging(0.0)).unwrap()).unwrap();
    }
    assert!(svg.contains("font-family=\"Ubuntu, Helvetica, Arial, sans-serif\""));
    let texts = texts(&svg);
    let all = texts.join("\n");
    for said in [
        "Speed against accuracy",
        "warehouse",
        "160×120 pixels, 0.25 s, threshold 0.2",
        "1 − F1 within 1 ms",
        "error of voxel grids",
        "charged 10 ms",
        "crossing, 16 samples",
        "latch, 4 samples",
        "Not measured: paper 250×4, paper 125×8, paper 40×8, paper 30×8 (method evis-paper",
        "A device, 2 cores",
    ] {
        assert!(all.contains(said), "the picture lacks '{said}':\n{all}");
    }
    let count = |text: &str| texts.iter().filter(|t| *t == text).count();
    assert_eq!((count("paper 1000 Hz"), count("real time"), count("truth's own error")), (4, 4, 4));
    assert_eq!(count("paper 250×4"), 0, "canary: what was not measured is no point");
    for scene in &chart.scenes {
        for i in scene.front(crate::Measure::Voxel, charging(10.0)) {
            let label = scene.points[i].setting.label();
            let label = scene.points[i].setting.published.clone().unwrap_or(label);
            assert!(count(&label) >= 1, "the front's {label} has no label");
        }
    }
}

#[test]
fn the_png_decodes_and_is_twice_the_svgs_size() {
    let chart = ChartResult::new(vec![scene_chart("spinner")]);
    let bytes = png(&chart, charging(0.0)).unwrap();
    let picture = image::load_from_memory(&bytes).unwrap().to_rgb8();
    let svg = svg(&chart, charging(0.0)).unwrap();
    let size = format!("width=\"{}\" height=\"{}\"", picture.width() / 2, picture.height() / 2);
    assert!(svg.contains(&size), "{size}");
    let inked = picture.pixels().filter(|p| p.0.iter().all(|c| *c < 100)).count();
    let all = (picture.width() * picture.height()) as usize;
    assert!(inked > all / 1000 && inked < all / 4, "{inked} of {all} pixels are dark");
}

#[test]
fn odd_measurements_still_make_a_picture() {
    let mut scene = scene_chart("odd");
    scene.points[0].score.voxel_l1 = None;
    scene.points[1].score.tolerances[0].scaled.f1 = 1.0;
    scene.points[2].score.tolerances.clear();
    scene.truth.floor = None;
    let mut lone = scene_chart("lone");
    lone.points.truncate(1);
    lone.repetitions = 1;
    let chart = ChartResult::new(vec![scene, lone]);
    assert!(texts(&svg(&chart, charging(0.0)).unwrap()).iter().any(|t| t == "lone"));
    let none = ChartResult::new(vec![]);
    assert!(svg(&none, charging(0.0)).unwrap_err().to_string().contains("no measured setting"));
    assert!(svg(&chart, charging(-1.0)).unwrap_err().to_string().contains("render_ms is -1"));
    let many = ChartResult::new(vec![scene_chart("x"); 25]);
    assert!(svg(&many, charging(0.0)).unwrap_err().to_string().contains("at most 24"));
}
