//! Light on one pixel: the mean of luminance over the pixel's area, as exactly as asked for.
//!
//! A lattice of samples gives the mean of what is smooth. Where an edge runs through the pixel (between objects, flat
//! faces, or light and shadow) it gives the mean of each *kind* of surface only, and the area that each kind covers
//! is found along lines, on which the edge itself is bisected.

use std::collections::BTreeMap;

use crate::clock::Moment;
use crate::lattice::{LEVELS, Lattice};
use crate::rays::Beam;
use crate::rays::caster::Kind;

/// Places per line at which the kind is looked up before edges are bisected, and where some kind covers less than
/// [`SLIVER`] of the pixel.
const LINE_STEPS: [usize; 2] = [16, 64];
const SLIVER: f64 = 0.15;

/// Halvings of a step of a line: an edge is known to better than a ten-thousandth of a pixel, with any sign.
const BISECTIONS: u32 = 10;

/// How the error of a lattice of n samples is estimated: this, times the spread of luminance within the pixel over its
/// mean, over n^(3/4) (the discrepancy of convex sets), in log light. The measured errors of edges in all directions
/// have this as their 90th percentile; see the test.
const LATTICE_ERROR: f64 = 0.7;

/// Corners and middles of the sides: an edge that has just come in covers one of them.
const BORDER: [[f64; 2]; 8] =
    [[-0.5, -0.5], [0.0, -0.5], [0.5, -0.5], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5], [-0.5, 0.5], [-0.5, 0.0]];

/// Mean light, and how well it is known.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// Mean luminance over the pixel's area.
    pub luminance: f64,
    /// Estimated standard error, relative.
    pub error: f64,
}

/// Samples of one family, prepared.
pub struct Sampler {
    lattice: Lattice,
    offsets: [Vec<[f64; 2]>; LEVELS],
}

/// Sums over the samples of one kind.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Sums {
    fn add(&mut self, luminance: f64) {
        self.count += 1.0;
        self.sum += luminance;
        self.squares += luminance * luminance;
    }

    fn join(mut self, other: &Self) -> Self {
        self.count += other.count;
        self.sum += other.sum;
        self.squares += other.squares;
        self
    }

    /// The mean, as well as a lattice of `n` samples knows it.
    fn reading(&self, n: f64) -> Reading {
        Reading { luminance: self.mean(), error: estimated_error(self.variance().sqrt(), self.mean(), n) }
    }

    fn mean(&self) -> f64 {
        self.sum / self.count.max(1.0)
    }

    fn variance(&self) -> f64 {
        (self.squares / self.count.max(1.0) - self.mean().powi(2)).max(0.0)
    }
}

impl Sampler {
    /// The samples of `lattice`.
    pub fn new(lattice: Lattice) -> Self {
        Self { lattice, offsets: [0, 1, 2].map(|level| lattice.offsets(level)) }
    }

    /// Points of the smallest lattice.
    pub fn points(&self) -> &[[f64; 2]] {
        &self.offsets[0]
    }

    /// Mean light on pixel (x, y) from the smallest lattice.
    pub fn coarse(&self, moment: &Moment, x: u16, y: u16) -> Reading {
        let n = self.offsets[0].len() as f64;
        let beam = beam(moment, x, y);
        let mut all = Sums::default();
        for o in &self.offsets[0] {
            let (luminance, _) = beam.look(at(x, y, *o));
            all.add(luminance);
        }
        all.reading(n)
    }

    /// Mean light on pixel (x, y), with as many samples as a relative error of `wanted` needs.
    pub fn fine(&self, moment: &Moment, x: u16, y: u16, wanted: f64) -> Reading {
        let mut reading = Reading { luminance: 0.0, error: f64::INFINITY };
        let beam = beam(moment, x, y);
        for level in 0..LEVELS {
            let mut kinds: BTreeMap<Kind, Sums> = BTreeMap::new();
            for o in &self.offsets[level] {
                let (luminance, kind) = beam.look(at(x, y, *o));
                kinds.entry(kind).or_default().add(luminance);
            }
            // A sliver along the border that no sample of the lattice met yet.
            for o in BORDER {
                let (luminance, kind) = beam.look(at(x, y, o));
                kinds.entry(kind).or_insert_with(|| {
                    let mut sums = Sums::default();
                    sums.add(luminance);
                    sums
                });
            }
            let n = self.offsets[level].len() as f64;
            reading = if kinds.len() > 1 {
                self.with_edges(&beam, x, y, &kinds, n)
            } else {
                kinds.into_values().next().unwrap_or_default().reading(n)
            };
            if reading.error <= wanted {
                break;
            }
        }
        reading
    }

    /// The mean of the kinds' means, weighted by the area that each covers. Lines run along x and along y: those that
    /// cross the edges change little from one to the next, those that run along an edge jump where they pass it: the ones
    /// that change less are taken.
    fn with_edges(&self, beam: &Beam, x: u16, y: u16, kinds: &BTreeMap<Kind, Sums>, n: f64) -> Reading {
        let steps = LINE_STEPS[usize::from(kinds.values().any(|s| s.count < SLIVER * n))];
        let overall = kinds.values().fold(Sums::default(), Sums::join);
        let spread = overall.variance().sqrt();
        let mean_of = |kind: &Kind| kinds.get(kind).map_or(overall.mean(), Sums::mean);
        let (mut best, mut least) = (Areas::default(), f64::INFINITY);
        for axis in 0..2 {
            let (areas, step) = self.areas(beam, x, y, axis, steps, &mean_of);
            if step < least {
                (best, least) = (areas, step);
            }
        }
        let total = best.total();
        let luminance = best.0.iter().map(|(kind, area)| mean_of(kind) * area).sum::<f64>() / total;
        let variance: f64 =
            best.0.iter().filter_map(|(kind, area)| Some(kinds.get(kind)?.variance() * area)).sum::<f64>()
                / total;
        // A kind that only the lines or only the lattice met counts with all of its area.
        let unknown: f64 =
            best.0.iter().filter(|(k, _)| !kinds.contains_key(k)).map(|(_, a)| a / total).sum();
        let unmet: f64 =
            kinds.iter().filter(|(k, _)| !best.0.contains_key(k)).map(|(_, s)| s.count / n).sum();
        let lines = self.lattice.lines() as f64;
        // Between two lines their light may change anywhere; half of the largest change at half of their distance.
        let edges = 0.25 * least / lines + spread * (unknown + unmet);
        let within = estimated_error(variance.sqrt(), luminance, n);
        Reading { luminance, error: within.hypot(edges / luminance.max(f64::MIN_POSITIVE)) }
    }

    /// What each kind covers of the lines along `axis` (0: x), the edges bisected, and the largest change of light from
    /// one line to the next.
    fn areas(
        &self,
        beam: &Beam,
        x: u16,
        y: u16,
        axis: usize,
        steps: usize,
        mean_of: &dyn Fn(&Kind) -> f64,
    ) -> (Areas, f64) {
        let (mut all, mut change, mut previous) = (Areas::default(), 0.0_f64, None);
        let lines = self.lattice.lines();
        for line in 0..lines {
            let side = (line as f64 + 0.5) / lines as f64 - 0.5;
            let kind_at = |s: f64| {
                let offset = if axis == 0 { [s, side] } else { [side, s] };
                beam.kind(at(x, y, offset))
            };
            let place = |step: usize| step as f64 / steps as f64 - 0.5;
            let mut own = Areas::default();
            let covered = &mut own.0;
            let (mut start, mut kind) = (-0.5, kind_at(-0.5));
            for step in 1..=steps {
                let next = kind_at(place(step));
                if next == kind {
                    continue;
                }
                let (mut low, mut high) = (place(step - 1), place(step));
                for _ in 0..BISECTIONS {
                    let middle = 0.5 * (low + high);
                    if kind_at(middle) == kind { low = middle } else { high = middle }
                }
                let edge = 0.5 * (low + high);
                *covered.entry(kind).or_default() += edge - start;
                (start, kind) = (edge, next);
            }
            *covered.entry(kind).or_default() += 0.5 - start;
            let light: f64 = own.0.iter().map(|(kind, length)| mean_of(kind) * length).sum();
            change = change.max(previous.map_or(0.0, |before: f64| (light - before).abs()));
            previous = Some(light);
            for (kind, length) in own.0 {
                *all.0.entry(kind).or_default() += length;
            }
        }
        (all, change)
    }
}

/// Length of lines that each kind covers.
#[derive(Debug, Default)]
struct Areas(BTreeMap<Kind, f64>);

impl Areas {
    fn total(&self) -> f64 {
        self.0.values().sum::<f64>().max(f64::MIN_POSITIVE)
    }
}

/// All rays of pixel (x, y).
fn beam<'m>(moment: &'m Moment, x: u16, y: u16) -> Beam<'m, 'm> {
    Beam::new(&moment.caster, &moment.camera, at(x, y, [-0.5; 2]), at(x, y, [0.5; 2]))
}

/// Image point at `offset` from the centre of pixel (x, y).
pub fn at(x: u16, y: u16, offset: [f64; 2]) -> [f64; 2] {
    [f64::from(x) + 0.5 + offset[0], f64::from(y) + 0.5 + offset[1]]
}

fn estimated_error(spread: f64, mean: f64, n: f64) -> f64 {
    LATTICE_ERROR * spread / mean.max(f64::MIN_POSITIVE) / n.powf(0.75)
}

#[cfg(test)]
mod tests {
    use evis_core::closed_form::{Edge, Signal};
    use evis_scene::{Camera, Lens, Material, Mesh, Motion, Node, Primitive, Scene, ShadingModel};
    use glam::{DMat4, DVec3};

    use super::*;
    use crate::clock::Clock;
    use crate::rays::Textures;
    use crate::settings::TruthSettings;

    /// A dark half plane before a bright wall: its side runs through the middle pixel of a 3x3 picture, `offset` pixels
    /// from its centre along `angle`.
    fn half_plane(angle: f64, offset: f64) -> Scene {
        let mut scene = Scene::default();
        let node = scene.add_node(Node::default());
        scene.cameras.push(Camera {
            width: Some(3),
            height: Some(3),
            ..Camera::new("camera", node, Lens::Intrinsics { fx: 100.0, fy: 100.0, cx: 1.5, cy: 1.5 })
        });
        for (i, luminance) in [0.1, 1.0].into_iter().enumerate() {
            let right = if i == 0 { 0.0 } else { 9.0 };
            scene.materials.push(Material {
                model: ShadingModel::Unlit,
                base_color: [luminance, luminance, luminance, 1.0],
                ..Material::default()
            });
            scene.meshes.push(Mesh {
                primitives: vec![Primitive {
                    material: i,
                    positions: vec![
                        [-9.0, -9.0, 0.0],
                        [right, -9.0, 0.0],
                        [right, 9.0, 0.0],
                        [-9.0, 9.0, 0.0],
                    ],
                    normals: vec![[0.0, 0.0, 1.0]; 4],
                    indices: vec![0, 1, 2, 0, 2, 3],
                    ..Primitive::default()
                }],
                ..Mesh::default()
            });
            let place =
                DVec3::new(offset * angle.cos() / 100.0, -offset * angle.sin() / 100.0, -1.0 - i as f64);
            let motion = Motion::Fixed(DMat4::from_translation(place) * DMat4::from_rotation_z(-angle));
            scene.add_node(Node { mesh: Some(i), motion, ..Node::default() });
        }
        scene
    }

    #[test]
    fn edges_of_all_directions_cover_their_area() {
        let (mut coarse_errors, mut worst_fine) = (Vec::new(), 0.0_f64);
        for i in 0..150 {
            let angle = f64::from(i) * 2.399_963;
            let offset = 0.68 * ((f64::from(i) * 0.618_034).fract() - 0.5);
            let scene = half_plane(angle, offset);
            let textures = Textures::new(&scene);
            let clock = Clock::new(&scene, &textures, 0, &TruthSettings::default()).unwrap();
            let moment = clock.at(0.0);
            let edge = Edge {
                light_behind: f64::from(0.1_f32),
                light_ahead: 1.0,
                angle_radians: angle,
                position_px: 1.5 * (angle.cos() + angle.sin()) + offset,
                speed_px_per_s: 1.0,
            };
            let truth = edge.luminance(1.5, 1.5, 0.0);
            let sampler = Sampler::new([Lattice::First, Lattice::Second][i as usize % 2]);
            let coarse = sampler.coarse(&moment, 1, 1);
            coarse_errors.push((coarse.luminance / truth - 1.0).abs() / coarse.error.max(1e-9));
            let fine = sampler.fine(&moment, 1, 1, 1e-3);
            let error = (fine.luminance / truth - 1.0).abs();
            worst_fine = worst_fine.max(error);
            // An edge's place is bisected, no better.
            assert!(error < 2e-5 + 3.0 * fine.error, "{angle} {offset}: {error} of {}", fine.error);
        }
        coarse_errors.sort_by(f64::total_cmp);
        // What is estimated is about one standard error: two thirds lie below it, hardly any beyond three.
        let (middle, high) = (coarse_errors[75], coarse_errors[142]);
        println!(
            "coarse error over its estimate: median {middle:.2}, 95 % {high:.2}; worst fine {worst_fine:.1e}"
        );
        assert!((0.1..1.0).contains(&middle) && high < 3.0, "{middle} {high}");
        assert!(worst_fine < 5e-4, "{worst_fine}");
    }
}
