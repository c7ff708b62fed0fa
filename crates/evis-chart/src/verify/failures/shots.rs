//! The small scenes, put together by code: a shot is a scene, its sensor, and the pixels that truth is made for.
//!
//! Cameras look along -Z with [`FOCAL`] pixels per unit of tangent: one metre away, a pixel is a centimetre.

use std::f64::consts::TAU;

use evis_core::SensorConfig;
use evis_core::sensor::{Refractory, RefractoryRule};
use evis_render::Shadows;
use evis_scene::builder::{EventCamera, Placement, Sampling, SceneBuilder, ShapeSettings, still};
use evis_scene::environment::Environment;
use evis_scene::motion::{Path, PathInterpolation, WaveShape, Waveform};
use evis_scene::primitive::Shape;
use evis_scene::procedural::{Pattern, Procedural};
use evis_scene::{Image, Light, LightKind, Material, Scene, SceneError, Trs};
use evis_truth::PixelChoice;
use glam::{DQuat, DVec3};
use half::f16;

/// Pixels per unit of tangent.
pub(super) const FOCAL: f64 = 100.0;

/// Width and height of every shot.
pub(super) const SIZE: [u32; 2] = [64, 48];

/// A small scene and how it is rendered.
#[derive(Clone, Debug)]
pub(super) struct Shot {
    /// What happens in it.
    pub scene: Scene,
    /// Length in microseconds.
    pub duration_us: i64,
    /// Pixels that truth is made for.
    pub pixels: PixelChoice,
    /// The sensor.
    pub sensor: SensorConfig,
    /// `Y_ref`.
    pub reference_luminance: f32,
    /// Keyframes per second, where the method's own are not what is asked about.
    pub keyframe_hz: Option<f64>,
    /// How the engine finds shadows; `None` leaves it to the method.
    pub shadows: Option<Shadows>,
}

/// Every shot, by what sets it apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ShotId {
    /// A lit picture slides while its lamp brightens and dims.
    Burst { keyframe_hz: Option<f64> },
    /// A picture passes before another.
    Passing,
    /// A picture turns about the optical axis, by so many radians per gap of [`TURN_HZ`] keyframes.
    Turning { radians: f64 },
    /// A thin rod passes, and a ball behind a wall with slits.
    Thin,
    /// A bright square moves over a dark ground.
    Square,
    /// Stripes of 2.5 pixels slide.
    Stripes,
    /// A glossy picture slides under a lamp that stays.
    Highlight,
    /// A box's shadow moves over a still floor.
    Shadow,
    /// A still picture under a lamp that flickers.
    Lamp,
    /// The cone of a spot sweeps over a still wall.
    Sweep,
    /// The camera turns before the sky.
    Sky,
    /// Pictures a few centimetres before the camera.
    Near,
    /// A box flies through the camera, the sky behind it.
    Through,
    /// The camera flies at a wall, half of it plain, half a picture.
    Expansion,
    /// A picture slides in from the border.
    Border,
    /// A picture turns slowly; with a spot that circles fast around it.
    Slow { with_spot: bool },
    /// The camera is elsewhere from one microsecond to the next.
    Cut,
    /// A picture slides, lit by this.
    Light { luminance: f32 },
    /// A picture of little contrast slides before a keen sensor.
    LowThreshold,
    /// Squares of much and of little contrast move before a dull sensor.
    HighThreshold,
    /// The square again, before a sensor that needs a rest after each event.
    Refractory,
}

/// Keyframes per second at which rotation is measured.
pub(super) const TURN_HZ: f64 = 30.0;

/// When the camera of [`ShotId::Cut`] jumps, in microseconds: inside a gap of 125, and of 30, keyframes per second.
pub(super) const CUT_US: i64 = 44_500;

/// What a pixel of [`ShotId::Refractory`] rests for, in microseconds: three instants of 1000 Hz.
pub(super) const REST_US: u32 = 3000;

/// Pixels from the picture's middle at which the spot of [`ShotId::Slow`] circles.
pub(super) const SPOT_RADIUS: f64 = 20.0;

/// Columns of [`ShotId::Border`] that are compared.
const BORDER: u32 = 6;

impl ShotId {
    /// Puts it together.
    pub(super) fn build(self) -> Result<Shot, SceneError> {
        match self {
            Self::Burst { keyframe_hz } => burst(keyframe_hz),
            Self::Passing => passing(),
            Self::Turning { radians } => turning(radians),
            Self::Thin => thin(),
            Self::Square => square(SensorConfig::default()),
            Self::Stripes => stripes(),
            Self::Highlight => highlight(),
            Self::Shadow => shadow(),
            Self::Lamp => lamp(),
            Self::Sweep => sweep(),
            Self::Sky => sky(),
            Self::Near => near(),
            Self::Through => through(),
            Self::Expansion => expansion(),
            Self::Border => border(),
            Self::Slow { with_spot } => slow(with_spot),
            Self::Cut => cut(),
            Self::Light { luminance } => light(luminance),
            Self::LowThreshold => low_threshold(),
            Self::HighThreshold => high_threshold(),
            Self::Refractory => {
                let refractory = Refractory { period_us: REST_US, rule: RefractoryRule::Hold };
                square(SensorConfig { refractory, ..SensorConfig::default() })
            }
        }
    }
}

/// Metres, one metre away, of so many pixels.
const fn px(pixels: f64) -> f64 {
    pixels / FOCAL
}

/// A scene that looks from the origin, `near` metres and farther.
struct Stage {
    builder: SceneBuilder,
    placement: Placement,
    near: f64,
}

impl Stage {
    fn new(name: &str, background: f32) -> Result<Self, SceneError> {
        let mut builder = SceneBuilder::new(name);
        builder.background([background; 3])?;
        Ok(Self { builder, placement: Placement::default(), near: 0.01 })
    }

    fn plain(&mut self, name: &str, luminance: f32) -> Result<usize, SceneError> {
        self.builder.material(Material::unlit(name).colored([luminance; 3]))
    }

    /// A material of noise between two greys; a texel is a sixth of the board's 64th.
    fn picture(
        &mut self,
        name: &str,
        seed: u64,
        [low, high]: [f32; 2],
        lit: bool,
    ) -> Result<usize, SceneError> {
        let picture = Procedural::new(Pattern::Noise, 64, seed).with_colors([low; 3], [high; 3]);
        let picture = self.builder.procedural(name, &picture, Sampling::default())?;
        let material = if lit { Material::diffuse(name) } else { Material::unlit(name) };
        self.builder.material(material.textured(picture))
    }

    fn card(&mut self, name: &str, size: [f64; 2], material: usize, at: Placement) -> Result<(), SceneError> {
        self.builder.shape(name, Shape::Card { size }, material, at).map(|_| ())
    }

    /// A card that is wide enough for every shot, its texels some six pixels one metre away.
    fn board(&mut self, material: usize, at: Placement) -> Result<(), SceneError> {
        self.card("board", [4.0, 4.0], material, at)
    }

    fn shot(mut self, duration_ms: i64, pixels: PixelChoice) -> Result<Shot, SceneError> {
        let [width, height] = SIZE.map(f64::from);
        let camera = EventCamera::new("camera").size(SIZE[0], SIZE[1]).near(self.near);
        let camera = camera.intrinsics(FOCAL, FOCAL, width / 2.0, height / 2.0);
        self.builder.camera(camera, self.placement)?;
        Ok(Shot {
            scene: self.builder.build()?,
            duration_us: duration_ms * 1000,
            pixels,
            sensor: SensorConfig::default(),
            reference_luminance: 0.5,
            keyframe_hz: None,
            shadows: None,
        })
    }
}

/// At `at`, moving by `velocity` in metres per second.
fn sliding(at: [f64; 3], velocity: [f64; 3]) -> Placement {
    let start = Trs { translation: at.into(), ..Trs::default() };
    Placement::along(Path::ConstantVelocity { start, velocity: velocity.into() })
}

/// The same, turned by `angle` about the optical axis.
fn sliding_aslant(at: [f64; 3], velocity: [f64; 3], angle: f64) -> Placement {
    let start = Trs { translation: at.into(), rotation: DQuat::from_rotation_z(angle), ..Trs::default() };
    Placement::along(Path::ConstantVelocity { start, velocity: velocity.into() })
}

/// At `at`, turning about the optical axis.
fn spinning(at: [f64; 3], rate: f64) -> Path {
    let start = Trs { translation: at.into(), ..Trs::default() };
    Path::Spin { start, axis: DVec3::Z, rate }
}

fn sine(frequency_hz: f64, low: f64, high: f64) -> Waveform {
    Waveform { shape: WaveShape::Sine, frequency_hz, phase: 0.0, low, high }
}

fn burst(keyframe_hz: Option<f64>) -> Result<Shot, SceneError> {
    let mut s = Stage::new("burst", 0.2)?;
    let picture = s.picture("picture", 5, [0.15, 0.9], true)?;
    s.board(picture, sliding([0.013, 0.007, -1.0], [px(110.0), px(40.0), 0.0]))?;
    let lamp = Light::point("lamp", 3.0).flickering(sine(9.0, 0.5, 1.5));
    s.builder.light(lamp, Placement::at([0.3, 0.4, 0.0]))?;
    Ok(Shot { keyframe_hz, ..s.shot(134, PixelChoice::Count(250))? })
}

fn passing() -> Result<Shot, SceneError> {
    let mut s = Stage::new("passing", 0.2)?;
    let (far, near) = (s.picture("far", 5, [0.1, 0.9], false)?, s.picture("near", 9, [0.1, 0.9], false)?);
    s.board(far, Placement::at([0.02, 0.01, -2.0]))?;
    // A card of its own so small would show few texels.
    let settings = ShapeSettings::default().repeat(0.1, 0.1);
    let card = Shape::Card { size: [px(18.0), px(20.0)] };
    s.builder.shape_with(
        "card",
        card,
        near,
        settings,
        sliding([px(-20.0), 0.0, -1.0], [px(250.0), 0.0, 0.0]),
    )?;
    s.shot(100, PixelChoice::Crop { x: 6, y: 18, width: 50, height: 3 })
}

fn turning(radians: f64) -> Result<Shot, SceneError> {
    let mut s = Stage::new("turning", 0.2)?;
    let picture = s.picture("picture", 5, [0.1, 0.9], false)?;
    s.board(picture, Placement::along(spinning([0.0, 0.0, -1.0], radians * TURN_HZ)))?;
    Ok(Shot { keyframe_hz: Some(TURN_HZ), ..s.shot(100, PixelChoice::Count(150))? })
}

fn thin() -> Result<Shot, SceneError> {
    let mut s = Stage::new("thin", 0.1)?;
    let bright = s.plain("bright", 0.9)?;
    let dark = s.plain("dark", 0.1)?;
    let rod = sliding_aslant([px(-30.0), px(12.0), -1.0], [px(400.0), 0.0, 0.0], 0.1);
    s.card("rod", [px(1.2), px(18.0)], bright, rod)?;
    // The wall has the background's colour: only the ball shows that it has slits, each for some five milliseconds.
    for k in 0..5 {
        let x = px(-26.0 + 13.0 * f64::from(k));
        s.card(&format!("wall {k}"), [px(11.0), px(20.0)], dark, Placement::at([x, px(-12.0), -1.0]))?;
    }
    s.card(
        "ball",
        [2.0 * px(2.0), 2.0 * px(8.0)],
        bright,
        sliding([2.0 * px(-30.0), 2.0 * px(-12.0), -2.0], [2.0 * px(800.0), 0.0, 0.0]),
    )?;
    s.shot(90, PixelChoice::Crop { x: 8, y: 17, width: 32, height: 18 })
}

fn square(sensor: SensorConfig) -> Result<Shot, SceneError> {
    let mut s = Stage::new("square", 0.09)?;
    let bright = s.plain("bright", 0.9)?;
    let at = sliding_aslant([px(-8.0), 0.0, -1.0], [px(120.0), px(13.0), 0.0], 0.15);
    s.card("square", [px(20.0), px(20.0)], bright, at)?;
    Ok(Shot { sensor, ..s.shot(100, PixelChoice::Crop { x: 6, y: 12, width: 48, height: 6 })? })
}

fn stripes() -> Result<Shot, SceneError> {
    /// Texels per stripe and its gap.
    const PERIOD: u32 = 16;
    let mut s = Stage::new("stripes", 0.2)?;
    let texel = |i: u32| {
        let y = 0.55 + 0.4 * (TAU * f64::from(i % PERIOD) / f64::from(PERIOD)).sin();
        let y = f16::from_f64(y);
        [y, y, y, f16::ONE]
    };
    let image = Image {
        name: "stripes".into(),
        width: PERIOD,
        height: PERIOD,
        texels: (0..PERIOD * PERIOD).map(texel).collect(),
    };
    let image = s.builder.texture(image, Sampling::default())?;
    let stripes = s.builder.material(Material::unlit("stripes").textured(image))?;
    let settings = ShapeSettings::default().repeat(2.0 / px(2.5), 2.0 / px(2.5));
    let card = Shape::Card { size: [2.0, 2.0] };
    s.builder.shape_with(
        "card",
        card,
        stripes,
        settings,
        sliding([0.0, 0.0, -1.0], [px(100.0), 0.0, 0.0]),
    )?;
    s.shot(80, PixelChoice::Count(60))
}

fn highlight() -> Result<Shot, SceneError> {
    let mut s = Stage::new("highlight", 0.05)?;
    let picture = Procedural::new(Pattern::Noise, 64, 5).with_colors([0.3; 3], [0.9; 3]);
    let picture = s.builder.procedural("picture", &picture, Sampling::default())?;
    let glossy = s.builder.material(Material::glossy("glossy", 1.0, 0.2).textured(picture))?;
    s.board(glossy, sliding([0.013, 0.007, -1.0], [px(-60.0), 0.0, 0.0]))?;
    // A lamp on the way from left to right: its highlight runs against the picture.
    s.builder.light(Light::point("lamp", 0.6), sliding([px(-30.0), 0.1, -0.5], [px(450.0), 0.0, 0.0]))?;
    s.shot(100, PixelChoice::Crop { x: 4, y: 16, width: 56, height: 3 })
}

fn shadow() -> Result<Shot, SceneError> {
    let mut s = Stage::new("shadow", 0.2)?;
    let floor = s.picture("floor", 5, [0.5, 0.9], true)?;
    let grey = s.plain("grey", 0.4)?;
    s.board(floor, Placement::at([0.02, 0.01, -1.2]))?;
    let at = sliding([px(-16.0), px(14.0), -1.0], [px(200.0), 0.0, 0.0]);
    s.builder.shape("box", Shape::Box { size: [px(14.0), px(10.0), 0.02] }, grey, at)?;
    // From above: the shadow falls below the box, clear of it.
    let sun = Light::directional("sun", 2.5).with_shadow();
    s.builder.light(sun, Placement::looking_at([0.0, 1.0, 0.0], [0.05, 0.0, -1.2]))?;
    s.builder.ambient([0.15; 3])?;
    // What a map's texels do to borders is not asked about here.
    Ok(Shot {
        shadows: Some(Shadows::Rays),
        ..s.shot(100, PixelChoice::Crop { x: 6, y: 22, width: 48, height: 5 })?
    })
}

fn lamp() -> Result<Shot, SceneError> {
    let mut s = Stage::new("lamp", 0.2)?;
    let picture = s.picture("picture", 5, [0.3, 0.9], true)?;
    s.board(picture, Placement::at([0.013, 0.007, -1.0]))?;
    let lamp = Light::point("lamp", 2.0).flickering(sine(40.0, 0.4, 1.6));
    s.builder.light(lamp, Placement::at([0.2, 0.2, 0.0]))?;
    s.shot(100, PixelChoice::Count(100))
}

fn sweep() -> Result<Shot, SceneError> {
    let mut s = Stage::new("sweep", 0.2)?;
    let wall = s.picture("wall", 5, [0.6, 0.9], true)?;
    s.board(wall, Placement::at([0.0, 0.0, -1.0]))?;
    // The spot that it throws is some 16 pixels across, its border 2.
    let spot = Light { kind: LightKind::Spot { inner: 0.10, outer: 0.13 }, ..Light::point("spot", 2.0) };
    let start = Trs { rotation: DQuat::from_rotation_y(0.4), ..Trs::default() };
    let path = Path::Spin { start, axis: DVec3::Y, rate: -8.0 };
    s.builder.light(spot, Placement::along(path))?;
    s.builder.ambient([0.15; 3])?;
    s.shot(90, PixelChoice::Crop { x: 4, y: 20, width: 56, height: 6 })
}

fn sky() -> Result<Shot, SceneError> {
    let mut s = Stage::new("sky", 0.2)?;
    s.builder.environment(Environment { visible: true, ..Environment::studio() });
    let axis = DVec3::new(0.2, 1.0, 0.1).normalize();
    s.placement = Placement::along(Path::Spin { start: Trs::default(), axis, rate: 3.0 });
    // It has little contrast.
    let sensor = SensorConfig { threshold_on: 0.1, threshold_off: 0.1, ..SensorConfig::default() };
    Ok(Shot { sensor, ..s.shot(100, PixelChoice::Count(400))? })
}

fn near() -> Result<Shot, SceneError> {
    let mut s = Stage::new("near", 0.2)?;
    let (far, close) = (s.picture("far", 5, [0.1, 0.9], false)?, s.picture("close", 9, [0.1, 0.9], false)?);
    // Depths of 20 and 12 mm: 1/z is 50 and 83, and e^(12·50) no number of 32 bits.
    let settings = ShapeSettings::default().repeat(0.2, 0.2);
    let far_card = Shape::Card { size: [0.04, 0.03] };
    s.builder.shape_with(
        "far",
        far_card,
        far,
        settings,
        sliding([0.0, 0.0, -0.02], [0.02 * px(120.0), 0.0, 0.0]),
    )?;
    let settings = ShapeSettings::default().repeat(0.1, 0.1);
    let card = Shape::Card { size: [0.012 * px(20.0), 0.012 * px(20.0)] };
    let at = sliding([0.012 * px(-10.0), 0.0, -0.012], [0.012 * px(180.0), 0.0, 0.0]);
    s.builder.shape_with("close", card, close, settings, at)?;
    s.near = 0.005;
    s.shot(60, PixelChoice::Count(200))
}

fn through() -> Result<Shot, SceneError> {
    let mut s = Stage::new("through", 0.3)?;
    let picture = s.picture("picture", 5, [0.1, 0.9], false)?;
    // Past the camera's side: the near plane cuts it from the thirtieth millisecond on, then it is gone.
    let settings = ShapeSettings::default().repeat(0.1, 0.1);
    let shape = Shape::Box { size: [0.1, 0.1, 0.3] };
    s.builder.shape_with("box", shape, picture, settings, sliding([0.07, 0.01, -0.4], [0.0, 0.0, 8.0]))?;
    s.shot(100, PixelChoice::Count(150))
}

fn expansion() -> Result<Shot, SceneError> {
    let mut s = Stage::new("expansion", 0.02)?;
    let picture = s.picture("picture", 5, [0.1, 0.9], false)?;
    let plain = s.plain("plain", 0.8)?;
    s.card("plain", [4.0, 8.0], plain, Placement::at([-2.0, 0.0, -2.0]))?;
    s.card("picture", [4.0, 8.0], picture, Placement::at([2.0, 0.0, -2.0]))?;
    // To 0.4 m: in the last gap of 30 keyframes per second everything becomes twice as large.
    s.placement = sliding([0.0, 0.0, 0.0], [0.0, 0.0, -16.0]);
    Ok(Shot { keyframe_hz: Some(30.0), ..s.shot(100, PixelChoice::Count(300))? })
}

fn border() -> Result<Shot, SceneError> {
    let mut s = Stage::new("border", 0.2)?;
    let picture = s.picture("picture", 5, [0.1, 0.9], false)?;
    s.board(picture, sliding([0.013, 0.007, -1.0], [px(300.0), px(30.0), 0.0]))?;
    s.shot(100, PixelChoice::Crop { x: 0, y: 8, width: BORDER, height: 24 })
}

fn slow(with_spot: bool) -> Result<Shot, SceneError> {
    let mut s = Stage::new("slow", 0.2)?;
    let picture = s.picture("picture", 5, [0.1, 0.9], false)?;
    let bright = s.plain("bright", 0.9)?;
    s.board(picture, Placement::along(spinning([0.0, 0.0, -1.0], 1.5)))?;
    if with_spot {
        // 1200 px/s.
        let out = Trs { translation: DVec3::new(px(SPOT_RADIUS), 0.0, 0.02), ..Trs::default() };
        let path = Path::Chain(vec![spinning([0.0, 0.0, -1.0], 1200.0 / SPOT_RADIUS), still(out)]);
        s.card("spot", [px(2.0), px(2.0)], bright, Placement::along(path))?;
    }
    s.shot(100, PixelChoice::Count(200))
}

fn cut() -> Result<Shot, SceneError> {
    let mut s = Stage::new("cut", 0.2)?;
    let (wall, card) = (s.picture("wall", 5, [0.1, 0.9], false)?, s.picture("card", 9, [0.1, 0.9], false)?);
    let plain = s.plain("plain", 0.3)?;
    s.board(wall, Placement::at([0.02, 0.01, -1.5]))?;
    // Seen before and after: something that goes on moving.
    let settings = ShapeSettings::default().repeat(0.1, 0.1);
    let shape = Shape::Card { size: [px(16.0), px(16.0)] };
    let at = sliding([px(0.0), px(8.0), -1.0], [px(100.0), 0.0, 0.0]);
    s.builder.shape_with("card", shape, card, settings, at)?;
    // A sill that belongs to the camera: its light is the same before and after.
    let cut_s = CUT_US as f64 * 1e-6;
    let path = Path::Keys {
        times: vec![0.0, cut_s - 1e-6, cut_s, 1.0],
        positions: vec![
            DVec3::ZERO,
            DVec3::ZERO,
            DVec3::new(px(9.0), 0.0, 0.0),
            DVec3::new(px(9.0), 0.0, 0.0),
        ],
        rotations: vec![DQuat::IDENTITY; 4],
        velocities: vec![],
        interpolation: PathInterpolation::Linear,
    };
    s.placement = Placement::along(path.clone());
    let head = s.builder.node("head", Placement::along(path))?;
    s.card(
        "sill",
        [px(80.0), px(16.0)],
        plain,
        Placement::at([0.0, px(-12.0) * 0.5, -0.5]).scaled([0.5; 3]).on(head),
    )?;
    s.shot(100, PixelChoice::Crop { x: 18, y: 21, width: 44, height: 10 })
}

fn light(luminance: f32) -> Result<Shot, SceneError> {
    let mut s = Stage::new("light", 0.2)?;
    let picture = s.picture("picture", 5, [0.1, 0.9], true)?;
    s.board(picture, sliding([0.013, 0.007, -1.0], [px(120.0), px(30.0), 0.0]))?;
    s.builder.ambient([2.0 * luminance; 3])?;
    let sensor = SensorConfig { log_eps: 1e-6, ..SensorConfig::default() };
    Ok(Shot { sensor, reference_luminance: 1.0, ..s.shot(80, PixelChoice::Count(200))? })
}

fn low_threshold() -> Result<Shot, SceneError> {
    let mut s = Stage::new("low threshold", 0.2)?;
    let picture = s.picture("picture", 5, [0.35, 0.65], false)?;
    s.board(picture, sliding([0.013, 0.007, -1.0], [px(120.0), px(30.0), 0.0]))?;
    let sensor = SensorConfig { threshold_on: 0.02, threshold_off: 0.02, ..SensorConfig::default() };
    Ok(Shot { sensor, ..s.shot(60, PixelChoice::Count(150))? })
}

fn high_threshold() -> Result<Shot, SceneError> {
    let mut s = Stage::new("high threshold", 0.04)?;
    let (bright, dim) = (s.plain("bright", 0.9)?, s.plain("dim", 0.2)?);
    // ln(0.9 / 0.04) is 3.1, ln(0.2 / 0.04) is 1.6: one event per edge, and none.
    let at = |y: f64| sliding_aslant([px(-14.0), px(y), -1.0], [px(150.0), 0.0, 0.0], 0.1);
    s.card("bright", [px(12.0), px(14.0)], bright, at(12.0))?;
    s.card("dim", [px(12.0), px(14.0)], dim, at(-10.0))?;
    let sensor = SensorConfig { threshold_on: 2.0, threshold_off: 2.0, ..SensorConfig::default() };
    Ok(Shot { sensor, ..s.shot(160, PixelChoice::Crop { x: 8, y: 12, width: 48, height: 20 })? })
}
