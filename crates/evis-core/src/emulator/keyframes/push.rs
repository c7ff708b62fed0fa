//! Frames with depth and motion vectors: the light between two of them is warped, then goes through the sensor model.

use rayon::prelude::*;

use super::last_keyframe::Keyframe;
use super::links::Links;
use super::paths::{Fields, Paths};
use super::scratch_pool::ScratchPool;
use super::warp::{Gap, MOST_PIXELS, Pictures, Side, Warp, WarpVariant, is_motion};
use crate::emulator::frames::{BLOCK, FrameData, Frames, Source, Tables, linear_luminance};
use crate::emulator::workers::{Threads, WorkerPool};
use crate::emulator::{EmulatorReport, Environment, EventEmulator, Push};
use crate::event::Event;
use crate::sensor::ConfigError;

/// Motion per gap beyond which a report warns: on `spinner`, F1 within 4 ms falls from 0.85 at 1 px per gap to 0.6 at 2 and
/// 0.4 at 6.
pub const WARN_GAP_PX: f32 = 4.0;

/// Instants per gap where their number is not given, at most.
const MOST_STEPS: u32 = 256;

/// Motion fields per gap, at most: as many as instants that may be asked for.
const MOST_FIELDS: usize = 1000;

/// Where more of the picture's paths go elsewhere than motion vectors, a report warns.
const WARN_STRAYED: f32 = 0.5;

/// A gap in which the picture moves no farther is not divided unless asked for: light straight from one keyframe to the other
/// is then nearer to the truth than light that is read between pixels (on `spinner` at 1 px per gap, F1 within 4 ms 0.85 and
/// 0.80).
const UNDIVIDED_PX: f32 = 1.0;

/// Instants of a gap in which the picture moves by `motion_px`, so that it moves by `step_px` from one to the next.
fn steps_for(motion_px: f32, step_px: f32) -> u32 {
    if motion_px > UNDIVIDED_PX { ((motion_px / step_px).ceil() as u32).clamp(1, MOST_STEPS) } else { 1 }
}

/// Nearness of all pixels whose depth is not given; nearer than any depth.
const NO_DEPTH: f32 = 2e6;

/// Nearness that a pixel of motion adds to 1 where depth is not known, for `splat`: a pixel more or less is of one surface.
const NEARNESS_PER_PX: f32 = 0.05;

/// Nearest 1 / depth.
const LARGEST_INVERSE_DEPTH: f32 = 1e6;

/// What a renderer says of one time: one picture of each kind per environment, row-major, environments outermost.
///
/// With a margin, pictures are larger than the sensor by it at every border.
#[derive(Clone, Copy, Debug)]
pub struct Keyframes<'a> {
    /// Linear light, or integers under a transfer curve: one value per pixel, or R, G, B. NaN: unknown.
    pub light: FrameData<'a>,
    /// Values of `light` per pixel: 1 or 3.
    pub channels: usize,
    /// Planar depth in metres, +inf where nothing is. What is no depth (0, negative, NaN) counts as nothing too. Empty where
    /// it is not known, in all keyframes of a stream: what moves farther is then taken for nearer, as in the EVIS paper.
    pub depth: &'a [f32],
    /// Where each pixel's surface was at the last keyframe, seen from where it is now: (x, y) pairs in pixels, x right,
    /// y down, so that `before = here + motion`. NaN, or 16 384 pixels and more: not known. May be empty where
    /// `motion_steps` is given: it is then where that leads.
    pub motion: &'a [f32],
    /// If known: the motion within the gap before this keyframe, by K fields per environment, at even times: field k of K, the
    /// oldest first, is at the part k/K of the gap, and leads to where each pixel's surface was at the part (k - 1)/K, in the
    /// convention of `motion`. Paths are then integrated from step to step instead of straight (the dense mode of the EVIS
    /// paper), and K instants the default.
    pub motion_steps: Option<&'a [f32]>,
    /// If known: the same to where it will be at the next keyframe.
    pub motion_forward: Option<&'a [f32]>,
    /// Per environment: whether this keyframe has nothing to do with the last one. Empty: none is cut.
    pub cut: &'a [bool],
}

/// Why a gap was not warped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cut {
    /// It was.
    #[default]
    None,
    /// There is no last keyframe: the stream begins, or the last frame had no depth and motion.
    Start,
    /// The user said so: the environment was restarted.
    Declared,
    /// Nothing links the two keyframes: light went straight from one to the other.
    Detected,
}

impl Cut {
    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Start => "start",
            Self::Declared => "declared",
            Self::Detected => "detected",
        }
    }
}

/// What became of one environment's keyframe and the gap before it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KeyframeReport {
    /// Instants of the gap, the keyframe included.
    pub steps: u32,
    /// Pixels that all but a thousandth of the picture's pixels moved at most.
    pub motion_px: f32,
    /// Part of the picture whose surfaces were found in the last keyframe, by motion and depth.
    pub linked: f32,
    /// Pixels and instants at which no light was known: memory stayed.
    pub unknown: u64,
    /// Pixels with a depth that is none.
    pub bad_depth: u64,
    /// Pixels with a motion vector that is none, or whose path through `motion_steps` comes upon one or leaves the picture:
    /// there its last step goes on.
    pub bad_motion: u64,
    /// Part of the picture whose paths through `motion_steps` end more than a pixel from where its motion vectors lead, as
    /// behind other surfaces: these paths are straight.
    pub strayed: f32,
    /// Whether the gap was warped.
    pub cut: Cut,
}

impl KeyframeReport {
    /// What a user should change, in words; empty where nothing.
    pub fn warnings(&self) -> Vec<String> {
        let mut out = Vec::new();
        if self.cut == Cut::Detected {
            out.push(format!(
                "{:.0} % of the picture is linked to the last keyframe: a cut that was not declared, or motion vectors \
                 of another convention, which check_motion names",
                self.linked * 100.0
            ));
        }
        if self.strayed > WARN_STRAYED {
            out.push(format!(
                "motion_steps lead elsewhere than motion vectors for {:.0} % of the picture: check their convention and that \
                 the oldest comes first",
                self.strayed * 100.0
            ));
        }
        if self.motion_px > WARN_GAP_PX && self.cut == Cut::None {
            out.push(format!(
                "{:.1} px per gap: render faster, {:.0} times as often for {WARN_GAP_PX} px",
                self.motion_px,
                (self.motion_px / WARN_GAP_PX).ceil()
            ));
        }
        out
    }
}

/// Nearness of a planar depth, and whether it is one.
fn nearness(depth: f32) -> (f32, bool) {
    if depth > 0.0 {
        let inverse = (1.0 / depth).min(LARGEST_INVERSE_DEPTH);
        (inverse / (1.0 + 1e-3 * inverse), true)
    } else {
        (0.0, false)
    }
}

impl Keyframe {
    /// Reads the pictures of environment `index`, of `canvas` pixels, and goes back through `fields`; counts depths and motion
    /// vectors that are none.
    fn read(
        from: &Keyframes<'_>,
        codes: (&Tables, f32),
        index: usize,
        canvas: [usize; 2],
        config: &Warp,
        gap_us: i64,
        fields: Option<&Fields<'_>>,
    ) -> (Self, Paths, [u64; 2]) {
        let pixels = canvas[0] * canvas[1];
        let range = index * pixels..(index + 1) * pixels;
        let light = match from.light {
            FrameData::Linear(values) => {
                let channels = from.channels;
                linear_luminance(&values[range.start * channels..range.end * channels], channels)
            }
            _ => from_codes(from, codes, index, pixels),
        };
        let (mut nearness, bad_depth) = match from.depth.get(range.clone()) {
            Some(depths) => {
                let bad = depths.iter().filter(|depth| !nearness(**depth).1).count() as u64;
                (depths.iter().map(|depth| nearness(*depth).0).collect(), bad)
            }
            None => (vec![NO_DEPTH; pixels], 0),
        };
        let pairs = |values: &[f32]| values.as_chunks::<2>().0[range.clone()].to_vec();
        let given = (!from.motion.is_empty()).then(|| pairs(from.motion));
        let mut paths = fields.map(|fields| fields.back(given.as_deref())).unwrap_or_default();
        let mut back = given.unwrap_or_else(|| paths.ends());
        let is_broken = |at: usize| paths.broken.get(at).copied().unwrap_or(false);
        let bad = back.iter().enumerate().filter(|(at, motion)| !is_motion(**motion) || is_broken(*at));
        let bad_motion = bad.count() as u64;
        let mut forward = from.motion_forward.map(pairs).unwrap_or_default();
        let dilation = config.variant.dilation();
        if dilation > 0 {
            let nearest = dilated(&nearness, canvas, dilation);
            let pick =
                |motion: &[[f32; 2]]| nearest.iter().filter_map(|at| motion.get(*at).copied()).collect();
            back = pick(&back);
            paths.pick(&nearest);
            forward = pick(&forward);
            nearness = nearest.iter().map(|at| nearness[*at]).collect();
        }
        let margin = config.push_margin();
        (Self { margin, gap_us, light, nearness, back, forward }, paths, [bad_depth, bad_motion])
    }

    /// Whether its depth was given.
    fn has_depth(&self) -> bool {
        self.nearness.first() != Some(&NO_DEPTH)
    }

    /// The sensor's part of the light.
    fn crop(&self, pictures: &Pictures, out: &mut Vec<f32>) {
        let margin = self.margin as usize;
        let [width, height] = pictures.size;
        out.clear();
        for row in self.light.chunks_exact(pictures.canvas[0]).skip(margin).take(height) {
            out.extend_from_slice(&row[margin..margin + width]);
        }
    }
}

/// Light of the integers of environment `index`, of `pixels` pixels, through the tables, which have `Y / Y_ref`.
fn from_codes(
    from: &Keyframes<'_>,
    (tables, reference_luminance): (&Tables, f32),
    index: usize,
    pixels: usize,
) -> Vec<f32> {
    let mut light = vec![f32::NAN; pixels];
    let frames = Frames { data: from.light, channels: from.channels };
    // The tables were made for these frames.
    let Some(source) = Source::new(&frames, tables, 1.0, index, pixels) else { return light };
    for (block, out) in light.chunks_mut(BLOCK).enumerate() {
        let mut relative = [f32::NAN; BLOCK];
        source.load_light(block * BLOCK, 0.0, &mut relative);
        for (out, relative) in out.iter_mut().zip(relative) {
            *out = relative * reference_luminance;
        }
    }
    light
}

/// Per pixel, the nearest one within `reach` pixels along each axis; itself where none is nearer.
fn dilated(nearness: &[f32], [width, height]: [usize; 2], reach: usize) -> Vec<usize> {
    (0..nearness.len())
        .map(|at| {
            let (x, y) = (at % width, at / width);
            let mut nearest = at;
            for y in y.saturating_sub(reach)..(y + reach + 1).min(height) {
                for x in x.saturating_sub(reach)..(x + reach + 1).min(width) {
                    let other = y * width + x;
                    if nearness[other] > nearness[nearest] {
                        nearest = other;
                    }
                }
            }
            nearest
        })
        .collect()
}

/// What stands for nearness where depth is not known: how far pixels move.
fn by_motion_of(motion: &[[f32; 2]], variant: WarpVariant) -> Vec<f32> {
    let length = |motion: &[f32; 2]| if is_motion(*motion) { motion[0].hypot(motion[1]) } else { 0.0 };
    let of = |motion| match variant {
        WarpVariant::EvisPaper => length(motion),
        WarpVariant::Splat => 1.0 + NEARNESS_PER_PX * length(motion),
    };
    motion.iter().map(of).collect()
}

impl EventEmulator {
    /// Takes the keyframes of time `t_us` and gives the events since the last ones, one list per environment. The light of
    /// the instants between is warped along the motion vectors from both keyframes, then goes through the sensor model as by
    /// [`Self::push`]: where neither keyframe knows it, a pixel's memory stays.
    ///
    /// An environment's first keyframe makes no events, nor does one that is cut.
    ///
    /// # Errors
    /// Wrong sizes, a time that does not increase, light that is infinite or negative, settings that cannot be used.
    /// Nothing has changed then.
    pub fn push_keyframe(
        &mut self,
        keyframes: &Keyframes<'_>,
        t_us: i64,
        warp: &Warp,
    ) -> Result<Vec<Vec<Event>>, ConfigError> {
        warp.check_push()?;
        let interval_us = self.check_time(t_us)?;
        let pictures = self.check_keyframes(keyframes, warp)?;
        let frames = Frames { data: keyframes.light, channels: keyframes.channels };
        self.tables.prepare(&frames, 1.0 / self.config.reference_luminance, &self.config.sensor);
        let mut out = vec![Vec::new(); self.config.batch];
        let Self {
            config, isa, workers, tables, kernel, environments, scratch_pool, keyframe_reports, ..
        } = self;
        let pool = workers.as_ref().map(WorkerPool::pool);
        let threads = pool.map_or(1, rayon::ThreadPool::current_num_threads);
        let step = Gapped {
            push: Push {
                config,
                kernel,
                isa: *isa,
                threads: if environments.len() == 1 && threads > 1 {
                    Threads::Pool(threads)
                } else {
                    Threads::One
                },
                start_us: t_us - i64::from(interval_us),
                interval_us,
            },
            pictures,
            warp,
            at_once: threads.div_ceil(config.batch),
            scratch_pool,
            tables,
        };
        let run = |index: usize, environment: &mut Environment, out: &mut Vec<Event>| {
            step.run(environment, keyframes, index, out)
        };
        *keyframe_reports = match pool {
            Some(pool) => pool.install(|| {
                let all = environments.par_iter_mut().zip(out.par_iter_mut()).enumerate();
                all.map(|(index, (environment, out))| run(index, environment, out)).collect()
            }),
            None => {
                let all = environments.iter_mut().zip(&mut out).enumerate();
                all.map(|(index, (environment, out))| run(index, environment, out)).collect()
            }
        };
        self.note(t_us);
        let before = vec![0; out.len()];
        self.take_causes(&mut out, &before);
        Ok(out)
    }

    /// What became of the last keyframes, one report per environment; empty where the last frames were none.
    pub fn keyframe_reports(&self) -> &[KeyframeReport] {
        &self.keyframe_reports
    }

    /// Checks sizes and light.
    fn check_keyframes(&self, keyframes: &Keyframes<'_>, warp: &Warp) -> Result<Pictures, ConfigError> {
        let config = &self.config;
        let size = [config.width as usize, config.height as usize];
        let canvas = size.map(|n| n + 2 * warp.push_margin() as usize);
        let pixels = canvas[0] * canvas[1];
        if pixels >= MOST_PIXELS {
            let value = format!("{} x {}", canvas[0], canvas[1]);
            return Err(ConfigError::new("size of a keyframe", value, format!("below {MOST_PIXELS} pixels")));
        }
        let all = pixels * config.batch;
        if matches!(keyframes.light, FrameData::Log(_)) {
            let remedy = "light, or integers under a transfer curve: keyframes are blended as light";
            return Err(ConfigError::new("light of keyframes", "logarithms", remedy));
        }
        Frames { data: keyframes.light, channels: keyframes.channels }.check(all)?;
        let motion = Some(keyframes.motion);
        let motion = motion.filter(|motion| keyframes.motion_steps.is_none() || !motion.is_empty());
        for (what, values, per_pixel) in [
            ("number of depths", Some(keyframes.depth).filter(|depth| !depth.is_empty()), 1),
            ("number of values of motion", motion, 2),
            ("number of values of motion_forward", keyframes.motion_forward, 2),
        ] {
            if let Some(values) = values.filter(|values| values.len() != all * per_pixel) {
                let remedy = format!("{} (environments × height × width × {per_pixel})", all * per_pixel);
                return Err(ConfigError::new(what, values.len(), remedy));
            }
        }
        if let Some(values) = keyframes.motion_steps
            && (values.len() % (2 * all) != 0 || !(1..=MOST_FIELDS).contains(&(values.len() / (2 * all))))
        {
            let remedy =
                format!("1 to {MOST_FIELDS} times {} (environments × steps × height × width × 2)", 2 * all);
            return Err(ConfigError::new("number of values of motion_steps", values.len(), remedy));
        }
        if !keyframes.cut.is_empty() && keyframes.cut.len() != config.batch {
            let remedy = format!("{}, one per environment, or none", config.batch);
            return Err(ConfigError::new("number of cuts", keyframes.cut.len(), remedy));
        }
        let bad = |value: &f32| value.is_infinite() || *value < 0.0;
        let light = if let FrameData::Linear(values) = keyframes.light { values } else { &[] };
        if let Some(index) = light.iter().position(bad) {
            let pixel = index / keyframes.channels % pixels;
            let what = format!(
                "light of pixel ({}, {}) of environment {}",
                pixel % canvas[0],
                pixel / canvas[0],
                index / keyframes.channels / pixels
            );
            let remedy = "finite and at least 0, or NaN where unknown";
            return Err(ConfigError::new(&what, light[index], remedy));
        }
        for environment in &self.environments {
            let before = environment.keyframe.as_ref().filter(|_| environment.has_light());
            if let Some(before) = before.filter(|before| before.has_depth() == keyframes.depth.is_empty()) {
                let [value, other] = if before.has_depth() {
                    ["not given", "given, as at the last keyframe"]
                } else {
                    ["given", "left out, as at the last keyframe"]
                };
                let remedy = format!("{other}; or reset all environments first");
                return Err(ConfigError::new("depth", value, remedy));
            }
            let before = environment.keyframe.as_ref().map(|keyframe| keyframe.margin);
            if let Some(before) =
                before.filter(|before| environment.has_light() && *before != warp.push_margin())
            {
                let remedy = format!("{before}, as at the last keyframe; or reset all environments first");
                return Err(ConfigError::new("margin", warp.push_margin(), remedy));
            }
        }
        if let Some(tile) = self.environments.iter().find_map(Environment::begun) {
            tile.check(&Source::Linear { values: &[], inverse_reference: 1.0 })?;
        }
        Ok(Pictures {
            size,
            canvas,
            log_floor: config.sensor.log_eps * config.reference_luminance,
            reference_luminance: config.reference_luminance,
        })
    }
}

/// What all environments of a push of keyframes share.
struct Gapped<'a> {
    push: Push<'a>,
    pictures: Pictures,
    warp: &'a Warp,
    /// Instants that threads warp side by side.
    at_once: usize,
    scratch_pool: &'a ScratchPool,
    /// What integers mean.
    tables: &'a Tables,
}

impl Gapped<'_> {
    fn run(
        &self,
        environment: &mut Environment,
        keyframes: &Keyframes<'_>,
        index: usize,
        out: &mut Vec<Event>,
    ) -> KeyframeReport {
        let gap_us = i64::from(self.push.interval_us);
        let mut report = KeyframeReport::default();
        let declared = keyframes.cut.get(index).copied().unwrap_or(false);
        if declared {
            environment.restart();
        }
        let before = environment.keyframe.take().filter(|_| environment.has_light());
        let since = if before.is_some() { gap_us } else { 0 };
        let canvas = self.pictures.canvas;
        let codes = (self.tables, self.push.config.reference_luminance);
        let fields = keyframes.motion_steps.map(|values| {
            let share = values.len() / self.push.config.batch;
            let vectors = values[index * share..(index + 1) * share].as_chunks::<2>().0;
            Fields { vectors, canvas, shared: self.at_once > 1 }
        });
        let (mut now, paths, [bad_depth, bad_motion]) =
            Keyframe::read(keyframes, codes, index, canvas, self.warp, since, fields.as_ref());
        (report.bad_depth, report.bad_motion) = (bad_depth, bad_motion);
        let mut sum = EmulatorReport::default();
        let mut between = None;
        report.cut = match &before {
            None if declared => Cut::Declared,
            None => Cut::Start,
            Some(before) => {
                let links = Links::find(before, &now, canvas);
                (report.motion_px, report.linked) = (links.motion_px, links.linked);
                if self.warp.detects_cuts() && links.is_cut() {
                    // Its motion says nothing of how surfaces go on.
                    now.gap_us = 0;
                    Cut::Detected
                } else {
                    let forward = super::links::forward_motion(before, &now, canvas);
                    let mut steps = [Vec::new(), Vec::new()];
                    if let Some(fields) = &fields {
                        let (from, _) = fields.forward(&forward).bends(&forward);
                        let (to, strayed) = paths.bends(&now.back);
                        report.strayed = strayed as f32 / now.back.len() as f32;
                        steps = [from, to];
                    }
                    between = Some((before, forward, steps));
                    Cut::None
                }
            }
        };
        report.steps = match &between {
            None => 1,
            Some(_) => {
                let wanted = self.warp.steps.or(fields.map(|fields| fields.count() as u32));
                let wanted = wanted.unwrap_or_else(|| steps_for(report.motion_px, self.warp.push_step_px()));
                // Instants are whole microseconds.
                wanted.min(self.push.interval_us)
            }
        };
        let variant = self.warp.variant;
        let by_motion = between.as_ref().filter(|_| !now.has_depth());
        let by_motion =
            by_motion.map(|(_, forward, _)| [forward, &now.back].map(|motion| by_motion_of(motion, variant)));
        let gap = between.as_ref().map(|(before, forward, [from, to])| {
            let [nearness, nearness_now] = match &by_motion {
                Some(pictures) => pictures.each_ref(),
                None => [&before.nearness, &now.nearness],
            };
            let older = Side { light: &before.light, nearness, motion: forward, bends: from };
            let newer = Side { light: &now.light, nearness: nearness_now, motion: &now.back, bends: to };
            Gap::new(self.warp.variant, &self.pictures, older, newer)
        });
        let steps = i64::from(report.steps);
        let offset = |k: i64| (k * gap_us + steps / 2) / steps;
        let mut k = 1;
        while k <= steps {
            let last = (k + self.at_once as i64 - 1).min(steps);
            let light_at = |k: i64| {
                let (mut scratch, mut frame) = self.scratch_pool.take();
                match &gap {
                    Some(gap) if k < steps => {
                        gap.instant((offset(k) as f64 / gap_us as f64) as f32, &mut scratch, &mut frame);
                    }
                    _ => now.crop(&self.pictures, &mut frame),
                }
                (scratch, frame)
            };
            let light: Vec<_> =
                if last > k { (k..=last).into_par_iter().map(light_at).collect() } else { vec![light_at(k)] };
            for (k, made) in (k..).zip(light) {
                let start = offset(k - 1);
                let push = Push {
                    start_us: self.push.start_us + start,
                    // At most the whole interval, which is a u32.
                    interval_us: (offset(k) - start) as u32,
                    ..self.push
                };
                environment.advance(&push, &made.1, out);
                sum.add(&environment.report);
                self.scratch_pool.give(made);
            }
            k = last + 1;
        }
        report.unknown = sum.unknown;
        environment.report = sum;
        environment.keyframe = Some(Box::new(now));
        report
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instants_follow_the_motion_from_a_pixel_on() {
        for (motion_px, steps) in
            [(0.0, 1), (1.0, 1), (1.01, 4), (3.0, 10), (12.0, 40), (500.0, MOST_STEPS), (1e30, MOST_STEPS)]
        {
            assert_eq!(steps_for(motion_px, 0.3), steps, "{motion_px}");
        }
        assert_eq!((steps_for(3.0, 1.0), steps_for(3.0, 100.0), steps_for(f32::NAN, 0.3)), (3, 1, 1));
    }
}
