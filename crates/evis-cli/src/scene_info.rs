//! `info` of a scene: what is in it, how large it is, and what its loader ignored.

use std::path::Path;

use evis_core::format::hdf5::BodyInfo;
use evis_render::Bodies;
use evis_scene::Scene;
use evis_scene::source::Opening;
use serde::Serialize;

use crate::{scene_source, text};

#[derive(Serialize)]
struct SceneInfo {
    scene: String,
    /// Lowest and highest corner at time 0, metres; none where nothing has a surface.
    bounds_m: Option<[[f64; 3]; 2]>,
    /// Of the motion; none where it has no natural end.
    duration_s: Option<f64>,
    environments: usize,
    nodes: usize,
    triangles: usize,
    cameras: Vec<String>,
    /// Semantic classes of what is drawn that have a name.
    classes: Vec<ClassLine>,
    lights: usize,
    /// Of a glTF file; the one that plays is marked.
    animations: Vec<AnimationLine>,
    materials: Vec<String>,
    textures: usize,
    /// What its loader had to say, and what stands out.
    notes: Vec<String>,
}

/// An animation of a glTF file.
#[derive(Serialize)]
struct AnimationLine {
    name: String,
    plays: bool,
}

/// A semantic class, in images of labels and by name.
#[derive(Serialize)]
pub(crate) struct ClassLine {
    id: u32,
    name: String,
}

impl ClassLine {
    /// The classes of `bodies`.
    pub(crate) fn of(bodies: &[BodyInfo]) -> Vec<Self> {
        let line = |(id, name): (u32, &str)| Self { id, name: name.to_owned() };
        BodyInfo::classes(bodies).into_iter().map(line).collect()
    }

    /// `1 floor, 2 crate`; `None` where no class has a name.
    pub(crate) fn in_words(classes: &[Self]) -> Option<String> {
        let words: Vec<_> = classes.iter().map(|class| format!("{} {}", class.id, class.name)).collect();
        (!words.is_empty()).then(|| words.join(", "))
    }
}

/// Whether `input` names a scene: a built-in one that no file has the name of, or a file with a scene's ending.
pub(crate) fn is_scene(input: &Path) -> bool {
    let ending = input.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    let by_ending = ending.is_some_and(|ending| ["glb", "gltf", "toml"].contains(&ending.as_str()));
    let name = input.to_string_lossy();
    by_ending || (!input.exists() && scene_source::builtins().iter().any(|(builtin, _)| *builtin == name))
}

/// Describes the scene `input`, of which `animation` plays.
pub(crate) fn info(input: &Path, animation: Option<&str>, json: bool) -> anyhow::Result<i32> {
    let opening = Opening { animation: animation.map(str::to_owned), ..Opening::default() };
    let scene = scene_source::open(&input.to_string_lossy(), &opening)?;
    let info = describe(&input.display().to_string(), &scene)?;
    if json {
        text::say_json(&info)?;
    } else {
        text::say(&lines(&info).join("\n"));
    }
    Ok(0)
}

fn describe(name: &str, scene: &Scene) -> anyhow::Result<SceneInfo> {
    let bounds_m = scene.bounds(0.0).map(|(low, high)| [low.to_array(), high.to_array()]);
    let mut notes = scene.warnings.clone();
    notes.extend(scene.unlikely_size());
    notes.extend((0..scene.cameras.len()).filter_map(|camera| scene.enclosed_camera(camera, 0.0)));
    notes.extend(scene_source::at_rest(scene, &[]));
    let bodies = Bodies::new(scene, [], 0, 0)?;
    Ok(SceneInfo {
        scene: name.to_owned(),
        bounds_m,
        duration_s: scene.duration_s,
        environments: scene.variants.len().max(1),
        nodes: scene.nodes.len(),
        triangles: scene_source::triangles(scene),
        cameras: scene.cameras.iter().map(|camera| camera.name.clone()).collect(),
        classes: ClassLine::of(bodies.infos()),
        lights: scene.lights.len(),
        animations: scene
            .animations
            .iter()
            .map(|name| AnimationLine { name: name.clone(), plays: scene.animation.as_ref() == Some(name) })
            .collect(),
        materials: scene.materials.iter().map(|material| material.name.clone()).collect(),
        textures: scene.textures.len(),
        notes,
    })
}

fn lines(info: &SceneInfo) -> Vec<String> {
    let mut lines = vec![format!("{}  scene", info.scene)];
    lines.push(match info.bounds_m {
        Some([low, high]) => {
            let sides = [0, 1, 2].map(|axis| high[axis] - low[axis]);
            // Three digits of the largest side at least, so that a small model has a size.
            let largest = sides.into_iter().fold(0.0_f64, f64::max);
            let decimals =
                if largest > 0.0 { (2.0 - largest.log10().floor()).clamp(3.0, 9.0) as usize } else { 3 };
            let metres = |length: f64| format!("{length:.decimals$}");
            let [x, y, z] = sides.map(metres);
            let corner = |corner: [f64; 3]| corner.map(metres).join(", ");
            format!("size      {x} x {y} x {z} m, from ({}) to ({})", corner(low), corner(high))
        }
        None => "size      nothing has a surface".into(),
    });
    lines.push(match info.duration_s {
        Some(seconds) => format!("duration  {seconds:.3} s"),
        None => "duration  the motion has no natural end".into(),
    });
    if info.environments > 1 {
        lines.push(format!("variants  {}", info.environments));
    }
    lines.push(format!("nodes     {}, {} triangles", info.nodes, text::grouped(info.triangles as u64)));
    lines.push(format!("cameras   {}", info.cameras.join(", ")));
    lines.extend(ClassLine::in_words(&info.classes).map(|classes| format!("classes   {classes}")));
    lines.push(format!("lights    {}", info.lights));
    let animations = info.animations.iter().map(|animation| {
        let plays = if animation.plays && info.animations.len() > 1 { " (plays)" } else { "" };
        format!("{}{plays}", animation.name)
    });
    if !info.animations.is_empty() {
        lines.push(format!(
            "animations {}: {}",
            info.animations.len(),
            animations.collect::<Vec<_>>().join(", ")
        ));
    }
    let unnamed = info.materials.iter().filter(|name| name.is_empty()).count();
    let mut names: Vec<&str> =
        info.materials.iter().map(String::as_str).filter(|name| !name.is_empty()).collect();
    names.dedup();
    let names = if names.is_empty() { String::new() } else { format!(": {}", names.join(", ")) };
    let unnamed = if unnamed > 0 { format!(", {unnamed} of them without a name") } else { String::new() };
    lines.push(format!("materials {}{unnamed}{names}; {} textures", info.materials.len(), info.textures));
    lines.extend(info.notes.iter().map(|note| format!("note      {note}")));
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_told_from_recordings_by_name_and_ending() {
        for scene in ["spinner", "a/b.glb", "a.GLTF", "scene.toml"] {
            assert!(is_scene(Path::new(scene)), "{scene}");
        }
        for other in ["a.h5", "events.raw", "spinnner", "folder"] {
            assert!(!is_scene(Path::new(other)), "{other}");
        }
    }

    #[test]
    fn animations_are_listed_and_what_plays_is_marked() -> anyhow::Result<()> {
        let mut scene = scene_source::describe("desk")?;
        let told = |scene: &Scene| -> anyhow::Result<Vec<String>> {
            let lines = lines(&describe("desk", scene)?);
            Ok(lines.into_iter().filter(|line| line.starts_with("animations")).collect())
        };
        assert_eq!(told(&scene)?, [""; 0]);
        scene.animations = vec!["Survey".into(), "Walk".into()];
        scene.animation = Some("Walk".into());
        assert_eq!(told(&scene)?, ["animations 2: Survey, Walk (plays)"]);
        Ok(())
    }

    #[test]
    fn a_scene_has_its_size_and_what_is_in_it() -> anyhow::Result<()> {
        let info = describe("desk", &scene_source::describe("desk")?)?;
        let [low, high] = info.bounds_m.unwrap_or_default();
        assert!(
            (0..3).all(|axis| high[axis] > low[axis] && high[axis] - low[axis] < 100.0),
            "{low:?} {high:?}"
        );
        assert!(info.triangles > 100 && info.lights > 0 && !info.cameras.is_empty() && info.notes.is_empty());
        let told = lines(&info).join("\n");
        for part in ["desk  scene", "size ", " m, from (", "cameras   ", "classes   1 ground, ", "materials "]
        {
            assert!(told.contains(part), "{part}\n{told}");
        }
        Ok(())
    }
}
