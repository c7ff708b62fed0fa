//! Inertial measurement units: specific force and angular rate of a node, from its exact poses.
//!
//! Derivatives are central differences of fourth order over steps of [`STEP_S`]: on a sinusoid of 10 Hz their error is
//! 1e-5 of the value. Near the ends of a recorded trajectory, within two steps, they meet its rest.

use evis_core::random::{Key, StreamId, normals};
use evis_core::{ConfigError, ImuSample, TimeGrid};
use evis_scene::{Scene, SceneState};
use glam::{DMat3, DMat4, DQuat, DVec3};
use serde::Serialize;

/// Seconds between the poses that derivatives are taken from.
const STEP_S: f64 = 1e-3;

/// Noise of an inertial measurement unit: white noise, and biases that walk. Names and units are those of Kalibr's `imu.yaml`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ImuNoise {
    /// m/s^2/sqrt(Hz).
    pub accelerometer_noise_density: f64,
    /// m/s^3/sqrt(Hz).
    pub accelerometer_random_walk: f64,
    /// rad/s/sqrt(Hz).
    pub gyroscope_noise_density: f64,
    /// rad/s^2/sqrt(Hz).
    pub gyroscope_random_walk: f64,
}

impl ImuNoise {
    /// Names of its values.
    pub const KEYS: [&str; 4] = [
        "accelerometer_noise_density",
        "accelerometer_random_walk",
        "gyroscope_noise_density",
        "gyroscope_random_walk",
    ];

    /// In the order of [`ImuNoise::KEYS`].
    pub const fn values(&self) -> [f64; 4] {
        [
            self.accelerometer_noise_density,
            self.accelerometer_random_walk,
            self.gyroscope_noise_density,
            self.gyroscope_random_walk,
        ]
    }

    /// With these values, in the order of [`ImuNoise::KEYS`].
    pub const fn of(values: [f64; 4]) -> Self {
        let [
            accelerometer_noise_density,
            accelerometer_random_walk,
            gyroscope_noise_density,
            gyroscope_random_walk,
        ] = values;
        Self {
            accelerometer_noise_density,
            accelerometer_random_walk,
            gyroscope_noise_density,
            gyroscope_random_walk,
        }
    }
}

/// An inertial measurement unit on a node of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuConfig {
    /// The node; the unit has its axes.
    pub node: usize,
    /// Index into `Scene::variants`, 0 where there are none.
    pub environment: usize,
    /// Samples per second.
    pub rate_hz: f64,
    /// None where all are 0.
    pub noise: ImuNoise,
    /// Of the world, in m/s^2.
    pub gravity: [f64; 3],
    /// Seed of its noise.
    pub seed: u64,
    /// Scene time at which stream time begins, in microseconds.
    pub start_us: i64,
}

impl ImuConfig {
    /// Without noise on `node`, 200 Hz, with standard gravity along -y.
    pub const fn new(node: usize) -> Self {
        Self {
            node,
            environment: 0,
            rate_hz: 200.0,
            noise: ImuNoise::of([0.0; 4]),
            // Standard acceleration of free fall (3rd CGPM, 1901).
            gravity: [0.0, -9.806_65, 0.0],
            seed: 0,
            start_us: 0,
        }
    }
}

/// An inertial measurement unit as it runs: sample k is at round(k 10^6 / rate) microseconds, whatever the steps are.
pub struct Imu {
    config: ImuConfig,
    grid: TimeGrid,
    key: Key,
    next: i64,
    /// Of accelerometer and gyroscope.
    bias: [DVec3; 2],
    state: SceneState,
}

impl Imu {
    /// Prepares `config` for `scene`.
    ///
    /// # Errors
    /// A node or an environment that does not exist, a rate or a noise that cannot be used.
    pub fn new(scene: &Scene, config: ImuConfig) -> Result<Self, ConfigError> {
        let nodes = scene.nodes.len();
        if config.node >= nodes {
            return Err(ConfigError::new("imu node", config.node, format!("below {nodes}")));
        }
        let environments = scene.variants.len().max(1);
        if config.environment >= environments {
            return Err(ConfigError::new(
                "imu environment",
                config.environment,
                format!("below {environments}"),
            ));
        }
        let grid = TimeGrid::new(config.rate_hz).map_err(|e| ConfigError { what: "imu rate".into(), ..e })?;
        for (what, value) in ImuNoise::KEYS.into_iter().zip(config.noise.values()) {
            if !(value.is_finite() && value >= 0.0) {
                return Err(ConfigError::new(what, value, "0 or more"));
            }
        }
        if !config.gravity.iter().all(|g| g.is_finite()) {
            return Err(ConfigError::new("gravity", format!("{:?}", config.gravity), "three finite numbers"));
        }
        let offset = scene.variants.get(config.environment).map_or(0, |variant| variant.seed_offset);
        let seed = config.seed.wrapping_add(offset);
        let key = Key::new(seed, config.environment as u32, config.node as u32);
        Ok(Self { config, grid, key, next: 0, bias: [DVec3::ZERO; 2], state: SceneState::default() })
    }

    /// The samples before stream time `until_us` that were not given yet.
    pub fn advance(&mut self, scene: &Scene, until_us: i64) -> Vec<ImuSample> {
        let mut samples = Vec::new();
        while self.grid.instant_us(self.next) < until_us {
            let t_us = self.grid.instant_us(self.next);
            let t_s = (self.config.start_us + t_us) as f64 * 1e-6;
            let [force, rate] = self.exact(scene, t_s);
            let [force_noise, rate_noise] = self.noise();
            samples.push(ImuSample {
                t_us,
                accelerometer: (force + force_noise).into(),
                gyroscope: (rate + rate_noise).into(),
            });
            self.next += 1;
        }
        samples
    }

    /// Specific force and angular rate at scene time `t_s`, in the node's axes.
    fn exact(&mut self, scene: &Scene, t_s: f64) -> [DVec3; 2] {
        let poses = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|k| self.pose(scene, t_s + k * STEP_S));
        let p = poses.map(|pose| pose.w_axis.truncate());
        let acceleration = (16.0 * (p[1] + p[3]) - (p[0] + p[4]) - 30.0 * p[2]) / (12.0 * STEP_S * STEP_S);
        let rotation = poses.map(|pose| DQuat::from_mat3(&DMat3::from_mat4(pose)));
        let here = rotation[2].inverse();
        let turn = |k: usize| {
            let turn = here * rotation[k];
            // The shorter way round.
            (if turn.w < 0.0 { -turn } else { turn }).to_scaled_axis()
        };
        let rate = (8.0 * (turn(3) - turn(1)) - (turn(4) - turn(0))) / (12.0 * STEP_S);
        [here * (acceleration - DVec3::from(self.config.gravity)), rate]
    }

    /// The rigid part of the node's pose.
    fn pose(&mut self, scene: &Scene, t_s: f64) -> DMat4 {
        scene.evaluate_variant(scene.variants.get(self.config.environment), t_s, &mut self.state);
        crate::world::transform::rigid(&self.state.world_from_node[self.config.node])
    }

    /// White noise and bias of the next sample; the bias then walks on.
    fn noise(&mut self) -> [DVec3; 2] {
        let noise = self.config.noise;
        if noise == ImuNoise::default() {
            return [DVec3::ZERO; 2];
        }
        let draw = |draw| self.key.draw(0, StreamId::Imu, self.next, draw);
        let mut normal = [0.0; 12];
        for (words, normal) in (0..6).map(draw).zip(normal.as_chunks_mut::<2>().0) {
            (normal[0], normal[1]) = normals(words[0], words[1]);
        }
        let vector = |i: usize| DVec3::new(normal[3 * i], normal[3 * i + 1], normal[3 * i + 2]);
        // A density over sqrt(Hz), sampled at a rate: times its square root; a walk, over it.
        let root = self.config.rate_hz.sqrt();
        let white = [noise.accelerometer_noise_density, noise.gyroscope_noise_density];
        let walk = [noise.accelerometer_random_walk, noise.gyroscope_random_walk];
        let values = [0, 1].map(|i| self.bias[i] + vector(i) * white[i] * root);
        for (i, (bias, walk)) in self.bias.iter_mut().zip(walk).enumerate() {
            *bias += vector(2 + i) * walk / root;
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use evis_scene::builder::{EventCamera, Placement, SceneBuilder};
    use evis_scene::motion::Path;
    use evis_scene::{Material, Trs};

    use super::*;

    /// A camera that swings, turns and moves on.
    fn scene() -> Scene {
        let mut s = SceneBuilder::new("imu");
        let white = s.material(Material::unlit("white")).unwrap();
        s.shape("wall", evis_scene::primitive::Shape::Card { size: [1.0, 1.0] }, white, Placement::default())
            .unwrap();
        let start = Trs { translation: DVec3::new(0.2, 1.0, 2.0), ..Trs::default() };
        let path = Path::Chain(vec![
            Path::ConstantVelocity { start, velocity: DVec3::new(0.3, -0.1, 0.2) },
            Path::Spin { start: Trs::default(), axis: DVec3::new(0.3, 1.0, -0.2).normalize(), rate: 2.0 },
            Path::ConstantVelocity {
                start: Trs { translation: DVec3::new(0.5, 0.0, 0.1), ..Trs::default() },
                velocity: DVec3::new(0.0, 0.2, 0.1),
            },
            Path::Spin { start: Trs::default(), axis: DVec3::X, rate: -1.3 },
        ]);
        s.camera(EventCamera::new("eye"), Placement::along(path)).unwrap();
        s.build().unwrap()
    }

    fn eye(scene: &Scene) -> usize {
        scene.cameras[0].node
    }

    fn samples(scene: &Scene, config: ImuConfig, until_us: i64) -> Vec<ImuSample> {
        Imu::new(scene, config).unwrap().advance(scene, until_us)
    }

    /// Integrates from the first pose and velocity on; returns the errors of position and rotation at the end.
    fn drift(scene: &Scene, samples: &[ImuSample], rate_hz: f64, gravity: DVec3) -> [f64; 2] {
        let mut imu = Imu::new(scene, ImuConfig::new(eye(scene))).unwrap();
        let h = 1e-4;
        let place = |imu: &mut Imu, t: f64| imu.pose(scene, t).w_axis.truncate();
        let (mut p, mut v) = (place(&mut imu, 0.0), (place(&mut imu, h) - place(&mut imu, -h)) / (2.0 * h));
        let mut q = DQuat::from_mat3(&DMat3::from_mat4(imu.pose(scene, 0.0)));
        let dt = 1.0 / rate_hz;
        // Steps of two samples, the middle of which Simpson's rule takes: errors are of fourth order.
        for s in samples.windows(3).step_by(2) {
            let [a, b, c] = [0, 1, 2].map(|i| DVec3::from(s[i].accelerometer));
            let [u, w, x] = [0, 1, 2].map(|i| DVec3::from(s[i].gyroscope));
            // Rotation over the first half and the whole, with the commutator term (Magnus).
            let half =
                DQuat::from_scaled_axis(dt * (5.0 * u + 8.0 * w - x) / 12.0 + dt * dt * u.cross(w) / 12.0);
            let whole = DQuat::from_scaled_axis(dt * (u + 4.0 * w + x) / 3.0 + dt * dt * u.cross(x) / 3.0);
            let [fa, fb, fc] = [q * a, q * half * b, q * whole * c].map(|f| f + gravity);
            p += 2.0 * dt * v + dt * dt * (2.0 * fa + 4.0 * fb) / 3.0;
            v += dt * (fa + 4.0 * fb + fc) / 3.0;
            q = (q * whole).normalize();
        }
        let end_s = (samples.len() - 1) as f64 / rate_hz;
        let pose = imu.pose(scene, end_s);
        let turned = DQuat::from_mat3(&DMat3::from_mat4(pose)).angle_between(q);
        [(p - pose.w_axis.truncate()).length(), turned]
    }

    #[test]
    fn samples_without_noise_integrate_back_to_the_trajectory() {
        let scene = scene();
        let config = ImuConfig { rate_hz: 1000.0, ..ImuConfig::new(eye(&scene)) };
        // An odd number of samples.
        let samples = samples(&scene, config, 2_000_001);
        assert_eq!(samples.len(), 2001);
        let gravity = DVec3::from(config.gravity);
        let [position, rotation] = drift(&scene, &samples, 1000.0, gravity);
        assert!(position < 1e-5 && rotation < 1e-6, "after 2 s: {position} m, {rotation} rad");
        let [wrong, _] = drift(&scene, &samples, 1000.0, gravity * 1.001);
        assert!(wrong > 1e-2, "canary, another gravity: {wrong} m");
        let turned: Vec<ImuSample> =
            samples.iter().map(|s| ImuSample { gyroscope: s.gyroscope.map(|w| -w), ..*s }).collect();
        assert!(drift(&scene, &turned, 1000.0, gravity)[1] > 0.1, "canary, rates of the other sign");
    }

    #[test]
    fn a_unit_at_rest_feels_gravity_alone() {
        let mut scene = scene();
        let node = scene.add_node(evis_scene::Node {
            motion: evis_scene::Motion::Fixed(DMat4::from_rotation_z(TAU / 4.0)),
            ..Default::default()
        });
        let samples = samples(&scene, ImuConfig::new(node), 20_000);
        assert_eq!(samples.iter().map(|s| s.t_us).collect::<Vec<_>>(), [0, 5000, 10_000, 15_000]);
        for sample in samples {
            // World up is the node's +x.
            let force = DVec3::from(sample.accelerometer);
            assert!((force - DVec3::new(9.806_65, 0.0, 0.0)).length() < 1e-6, "{force}");
            assert!(DVec3::from(sample.gyroscope).length() < 1e-9);
        }
    }

    #[test]
    fn noise_has_its_densities_and_does_not_depend_on_steps() {
        let scene = scene();
        let noise = ImuNoise {
            accelerometer_noise_density: 2e-3,
            accelerometer_random_walk: 3e-3,
            gyroscope_noise_density: 1.7e-4,
            gyroscope_random_walk: 2e-4,
        };
        let rate_hz = 100.0;
        let quiet = ImuConfig { rate_hz, ..ImuConfig::new(eye(&scene)) };
        let until_us = 400_000_000;
        let noisy = ImuConfig { noise, seed: 5, ..quiet };
        let found = samples(&scene, noisy, until_us);
        let mut imu = Imu::new(&scene, noisy).unwrap();
        let mut stepped = Vec::new();
        for t_us in [1, 40_000, 77_777, 5_000_000, until_us] {
            stepped.extend(imu.advance(&scene, t_us));
        }
        assert!(found == stepped, "steps change nothing");
        assert!(found != samples(&scene, ImuConfig { seed: 6, ..noisy }, until_us), "canary: another seed");

        let exact = samples(&scene, quiet, until_us);
        type Axes = fn(&ImuSample) -> [f64; 3];
        let kinds: [(Axes, f64, f64); 2] = [
            (|s| s.accelerometer, noise.accelerometer_noise_density, noise.accelerometer_random_walk),
            (|s| s.gyroscope, noise.gyroscope_noise_density, noise.gyroscope_random_walk),
        ];
        for (axes, density, walk) in kinds {
            let errors: Vec<[f64; 3]> =
                found.iter().zip(&exact).map(|(a, b)| [0, 1, 2].map(|k| axes(a)[k] - axes(b)[k])).collect();
            // Variance of the difference of means over m samples, as the model has it: white noise falls with m, the walk
            // grows with it. Twice the Allan variance at m / rate.
            let check = |m: usize, density: f64, walk: f64| {
                let means: Vec<f64> = (0..3)
                    .flat_map(|k| {
                        errors.chunks_exact(m).map(move |c| c.iter().map(|e| e[k]).sum::<f64>() / m as f64)
                    })
                    .collect();
                let pairs: Vec<f64> = means.as_chunks::<2>().0.iter().map(|[a, b]| b - a).collect();
                let n = pairs.len() as f64;
                let variance = pairs.iter().map(|d| d * d).sum::<f64>() / n;
                let size = m as f64;
                let white = 2.0 * density * density * rate_hz / size;
                // Of a walk of steps s: s^2 (2 m^2 + 1) / (3 m).
                let step = walk * walk / rate_hz;
                let expected = white + step * (2.0 * size * size + 1.0) / (3.0 * size);
                // A sum of n squares of normals; differences two by two share nothing but the walk's steps within them.
                (variance / expected - 1.0) / (2.0 / n).sqrt()
            };
            for m in [1, 10, 200] {
                let z = check(m, density, walk);
                assert!(z.abs() < 4.0, "{m} samples: {z} standard errors (two-sided p 6e-5 each)");
            }
            assert!(check(1, 1.05 * density, walk).abs() > 4.0, "canary: density 5 % off");
            assert!(check(200, density, 1.6 * walk).abs() > 4.0, "canary: walk 60 % off");
        }
    }

    #[test]
    fn what_no_unit_can_have_is_refused() {
        let scene = scene();
        let refused = |config: ImuConfig| Imu::new(&scene, config).err().unwrap().to_string();
        let base = ImuConfig::new(eye(&scene));
        assert!(refused(ImuConfig::new(99)).contains("99"));
        assert!(refused(ImuConfig { rate_hz: -3.0, ..base }).contains("-3"));
        assert!(refused(ImuConfig { environment: 1, ..base }).contains("environment"));
        let noise = ImuNoise { gyroscope_random_walk: f64::NAN, ..ImuNoise::default() };
        assert!(refused(ImuConfig { noise, ..base }).contains("gyroscope_random_walk"));
    }
}
