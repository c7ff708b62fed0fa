//! Which settings are measured.

use evis_core::{ConfigError, TimeGrid, TriggerRule, Warp};
use evis_render::{Antialias, Method, Quality, RunConfig};
use serde::{Deserialize, Serialize};

/// A point of the chart, as data: it may name a method that this version of the engine does not have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setting {
    /// The name that publications give it; `None` for a step of the ladder.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub published: Option<String>,
    /// Sampling method, by its name.
    pub method: String,
    /// Sampled instants per second.
    pub rate_hz: f64,
    /// Frames that are rendered per simulated second; `rate_hz` where every instant is.
    pub rendered_hz: f64,
    /// Samples per pixel and instant.
    pub samples: u32,
    /// How they are taken.
    pub antialias: Antialias,
    /// Trigger rule.
    pub trigger: TriggerRule,
    /// Pixels that anything may move between two samples of it; `None` where every pixel is sampled at `rate_hz`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adaptive_px: Option<f64>,
    /// The preset that all but the trigger comes from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<Quality>,
    /// Settings of `splat` and `evis-paper`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub splat: Option<Warp>,
}

impl Setting {
    /// Every instant is rendered.
    pub fn native(rate_hz: f64, samples: u32, antialias: Antialias, trigger: TriggerRule) -> Self {
        let method = "native".into();
        Self {
            published: None,
            method,
            rate_hz,
            rendered_hz: rate_hz,
            samples,
            antialias,
            trigger,
            adaptive_px: None,
            quality: None,
            splat: None,
        }
    }

    /// Decoupled sampling: no instants, and no samples.
    pub fn decoupled() -> Self {
        let native = Self::native(1000.0, 1, Antialias::Samples, TriggerRule::Crossing);
        Self { method: Method::Decoupled.name().into(), ..native }
    }

    fn is_decoupled(&self) -> bool {
        self.method == Method::Decoupled.name()
    }

    /// Everything is rendered when something has moved by `step_px` pixels, and at `rate_hz` at most.
    pub fn adaptive(step_px: f64, rate_hz: f64, samples: u32) -> Self {
        let native = Self::native(rate_hz, samples, Antialias::Samples, TriggerRule::Crossing);
        Self { adaptive_px: Some(step_px), ..native }
    }

    /// A preset. How many pictures it draws is known when it has run.
    pub fn quality(quality: Quality) -> Self {
        let sampling = quality.sampling();
        let crossing = TriggerRule::Crossing;
        let native = Self::native(sampling.rate_hz, sampling.samples, sampling.antialias, crossing);
        Self { adaptive_px: sampling.step_px, quality: Some(quality), ..native }
    }

    /// The same as `config` ran it, which rendered `drawn_hz` whole pictures per simulated second.
    pub fn settled(self, config: &RunConfig, drawn_hz: f64) -> Self {
        let decoupled = config.method == Method::Decoupled;
        if !decoupled && self.quality.is_none() && self.adaptive_px.is_none() {
            return self;
        }
        let rate_hz = config.rate_hz;
        let rendered_hz = if decoupled { drawn_hz } else { drawn_hz.min(rate_hz) };
        Self {
            method: config.method.name().into(),
            adaptive_px: config.adaptive_px,
            rate_hz,
            rendered_hz,
            samples: config.samples,
            ..self
        }
    }

    /// Keyframes of `samples` samples, and splatted instants between them.
    pub fn splat(splat: Warp, samples: u32, trigger: TriggerRule) -> Self {
        Self {
            published: None,
            method: Method::Splat(splat).name().into(),
            rate_hz: splat.scene_keyframe_hz() * f64::from(splat.scene_steps()),
            rendered_hz: splat.scene_keyframe_hz(),
            samples,
            antialias: Antialias::Samples,
            trigger,
            adaptive_px: None,
            quality: None,
            splat: Some(splat),
        }
    }

    /// The method, where the engine has it.
    pub fn engine_method(&self) -> Option<Method> {
        match (self.method.as_str(), self.splat) {
            ("native", None) => Some(Method::Native),
            ("decoupled", None) => Some(Method::Decoupled),
            ("splat" | "evis-paper", Some(splat)) => Some(Method::Splat(splat)),
            _ => None,
        }
    }

    /// `base` with this setting in it; `None` where the engine does not have the method.
    pub fn run_config(&self, base: &RunConfig) -> Option<RunConfig> {
        let mut config = base.clone();
        config.method = self.engine_method()?;
        config.rate_hz = self.rate_hz;
        config.samples = self.samples;
        config.antialias = self.antialias;
        config.adaptive_px = self.adaptive_px;
        config.quality = self.quality;
        config.sensor.trigger = self.trigger;
        Some(config)
    }

    /// Short and complete: `1000 Hz ×16`, `250 Hz edges`, `1000 Hz ×4 latch`, `splat 250×4 Hz latch`.
    pub fn label(&self) -> String {
        if let Some(quality) = self.quality {
            return quality.name().into();
        }
        if self.is_decoupled() {
            let step = self.adaptive_px.map_or_else(String::new, |px| format!(" {} px", number(px)));
            return format!("{}{step}", self.method);
        }
        let mut label = String::new();
        if let Some(px) = self.adaptive_px {
            let method = if self.method == "native" { String::new() } else { format!("{} ", self.method) };
            label = format!("{method}{} px up to {} Hz", number(px), number(self.rate_hz));
        } else if self.method != "native" {
            label = format!("{} ", self.method);
        }
        if self.adaptive_px.is_some() {
        } else if self.rendered_hz < self.rate_hz {
            let steps = self.rate_hz / self.rendered_hz;
            label += &format!("{}×{} Hz", number(self.rendered_hz), number(steps));
        } else {
            label += &format!("{} Hz", number(self.rate_hz));
        }
        match self.antialias {
            Antialias::Samples => label += &format!(" ×{}", self.samples),
            Antialias::Edges => label += " edges",
        }
        if self.trigger == TriggerRule::Latch {
            label += " latch";
        }
        label + &self.splat_words()
    }

    /// How a splat differs from its method's defaults: ` margin 16`.
    fn splat_words(&self) -> String {
        let margin = self.splat.and_then(|warp| warp.margin);
        margin.map_or_else(String::new, |margin| format!(" margin {margin}"))
    }

    /// What it has in common with the points that a line joins it to: all but the rate.
    pub fn family(&self) -> String {
        let trigger = match self.trigger {
            TriggerRule::Crossing => "crossing",
            TriggerRule::Latch => "latch",
            TriggerRule::Difference => "difference",
        };
        let pixel = match (self.antialias, self.samples) {
            (Antialias::Edges, _) => "edges".to_owned(),
            (Antialias::Samples, 1) => "1 sample".to_owned(),
            (Antialias::Samples, n) => format!("{n} samples"),
        };
        if self.quality.is_some() {
            "presets".into()
        } else if self.is_decoupled() {
            self.method.clone()
        } else if self.adaptive_px.is_some() {
            let method = if self.method == "native" { "adaptive" } else { &self.method };
            format!("{method}, {trigger}, {pixel}")
        } else if self.method == "native" {
            format!("{trigger}, {pixel}")
        } else {
            format!("{}{}, {trigger}, {pixel}", self.method, self.splat_words())
        }
    }

    /// The flags of `run` that differ from its defaults.
    pub fn run_flags(&self) -> String {
        if let Some(quality) = self.quality {
            return format!("--quality {}", quality.name());
        }
        if self.is_decoupled() {
            return format!("--method {}", self.method);
        }
        let mut flags = match &self.splat {
            None => match self.adaptive_px {
                None => format!("--rate {}", number(self.rate_hz)),
                Some(px) => {
                    let flags = format!("--rate {} --adaptive {}", number(self.rate_hz), number(px));
                    if self.method == "native" { flags } else { format!("--method {} {flags}", self.method) }
                }
            },
            Some(warp) => {
                let (rate, steps) = (number(warp.scene_keyframe_hz()), warp.scene_steps());
                format!("--method {} --keyframe-rate {rate} --steps {steps}", self.method)
            }
        };
        if let Some(margin) = self.splat.and_then(|warp| warp.margin) {
            flags += &format!(" --margin {margin}");
        }
        match self.antialias {
            Antialias::Samples => flags += &format!(" --samples {}", self.samples),
            Antialias::Edges => flags += " --antialias edges",
        }
        // The paper's method latches unless it is told otherwise.
        let paper = self.method == "evis-paper";
        match self.trigger {
            TriggerRule::Latch => flags += " --trigger latch",
            TriggerRule::Difference => flags += " --trigger difference",
            TriggerRule::Crossing if paper => flags += " --trigger crossing",
            TriggerRule::Crossing => {}
        }
        flags
    }

    fn same_run(&self, other: &Self) -> bool {
        Self { published: None, ..self.clone() } == Self { published: None, ..other.clone() }
    }
}

/// A number without trailing zeros, at most six decimals.
pub(crate) fn number(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Finest rate of adaptive settings.
const ADAPTIVE_HZ: f64 = 4000.0;

/// Shape of a ladder: every combination of these, and the published settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ladder {
    /// Sampled instants per second.
    pub rates_hz: Vec<f64>,
    /// Samples per pixel.
    pub samples: Vec<u32>,
    /// Also one shaded sample with the coverage of four, at each rate.
    pub edges: bool,
    /// Rates at which the trigger also latches, with each number of samples.
    pub latch_hz: Vec<f64>,
    /// Combinations of more samples per pixel and simulated second (rate times samples) are left out: the corner where
    /// both are high costs more than all the rest. `None` leaves none out.
    pub most_samples_hz: Option<f64>,
    /// Also the settings that the EVIS paper publishes.
    pub published: bool,
    /// Pixels that anything may move between two samples of it, at 4000 Hz at most, with 4 samples.
    pub adaptive_px: Vec<f64>,
    /// Presets.
    pub presets: Vec<Quality>,
    /// Also decoupled sampling.
    pub decoupled: bool,
    /// Keyframes per second and instants per gap of `splat`, with 4 samples.
    pub splat: Vec<(f64, u32)>,
    /// Also `splat` with a latch, and `evis-paper` without one, at 125 keyframes per second and 8 instants per gap.
    pub splat_triggers: bool,
}

/// What of a ladder a user chose; `None` and `false` where nothing was said.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LadderRequest {
    /// [`Ladder::quick`] instead of the default.
    pub quick: bool,
    /// Sampled instants per second. Rates or samples that are named are all measured.
    pub rates_hz: Option<Vec<f64>>,
    /// Samples per pixel.
    pub samples: Option<Vec<u32>>,
    /// Whether one shaded sample with the coverage of four is measured too.
    pub edges: Option<bool>,
    /// Rates at which the trigger also latches.
    pub latch_hz: Option<Vec<f64>>,
    /// Without the settings that the EVIS paper publishes.
    pub no_published: bool,
    /// Without `splat`.
    pub no_splat: bool,
    /// Without adaptive time, presets and decoupled sampling.
    pub no_adaptive: bool,
}

impl From<LadderRequest> for Ladder {
    fn from(asked: LadderRequest) -> Self {
        let mut ladder = if asked.quick { Self::quick() } else { Self::default() };
        if asked.rates_hz.is_some() || asked.samples.is_some() {
            ladder.most_samples_hz = None;
        }
        ladder.rates_hz = asked.rates_hz.unwrap_or(ladder.rates_hz);
        ladder.samples = asked.samples.unwrap_or(ladder.samples);
        ladder.edges = asked.edges.unwrap_or(ladder.edges);
        ladder.latch_hz = asked.latch_hz.unwrap_or(ladder.latch_hz);
        ladder.published &= !asked.no_published;
        if asked.no_splat {
            ladder.splat.clear();
            ladder.splat_triggers = false;
        }
        if asked.no_adaptive {
            ladder.adaptive_px.clear();
            ladder.presets.clear();
            ladder.decoupled = false;
        }
        ladder
    }
}

impl Default for Ladder {
    fn default() -> Self {
        Self {
            rates_hz: vec![125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0],
            samples: vec![1, 4, 16],
            edges: true,
            latch_hz: vec![1000.0],
            most_samples_hz: Some(16_000.0),
            published: true,
            adaptive_px: vec![1.0, 0.5, 0.25],
            presets: vec![Quality::Draft, Quality::Standard, Quality::High],
            decoupled: true,
            splat: vec![(30.0, 8), (60.0, 8), (125.0, 8), (250.0, 4)],
            splat_triggers: true,
        }
    }
}

impl Ladder {
    /// A third of the points, the dear ones left out.
    pub fn quick() -> Self {
        Self {
            rates_hz: vec![125.0, 500.0, 2000.0],
            samples: vec![1, 4],
            edges: false,
            latch_hz: vec![1000.0],
            most_samples_hz: Some(16_000.0),
            published: true,
            adaptive_px: vec![0.5],
            presets: vec![Quality::Draft, Quality::Standard, Quality::High],
            decoupled: true,
            splat: vec![(125.0, 8)],
            splat_triggers: false,
        }
    }

    /// The settings, each once, by method, trigger, samples and rate.
    ///
    /// # Errors
    /// A value that no run can use, or no setting at all.
    pub fn settings(&self) -> Result<Vec<Setting>, ConfigError> {
        for &rate in self.rates_hz.iter().chain(&self.latch_hz) {
            TimeGrid::new(rate).map_err(|e| ConfigError { what: "rates".into(), ..e })?;
        }
        for &samples in &self.samples {
            let base = RunConfig { samples, ..RunConfig::default() };
            base.check()?;
        }
        let mut all: Vec<Setting> = Vec::new();
        let mut add = |setting: Setting| {
            let samples_hz = setting.rate_hz * f64::from(setting.samples);
            // In adaptive time hardly anything is rendered at that rate.
            let exempt =
                setting.published.is_some() || setting.adaptive_px.is_some() || setting.is_decoupled();
            if !exempt && self.most_samples_hz.is_some_and(|most| samples_hz > most) {
                return;
            }
            match all.iter_mut().find(|s| s.same_run(&setting)) {
                Some(there) => there.published = setting.published.or(there.published.take()),
                None => all.push(setting),
            }
        };
        let samples = Antialias::Samples;
        for &count in &self.samples {
            for &rate_hz in &self.rates_hz {
                add(Setting::native(rate_hz, count, samples, TriggerRule::Crossing));
            }
        }
        for &rate_hz in self.rates_hz.iter().filter(|_| self.edges) {
            add(Setting::native(rate_hz, 4, Antialias::Edges, TriggerRule::Crossing));
        }
        for &count in &self.samples {
            for &rate_hz in &self.latch_hz {
                add(Setting::native(rate_hz, count, samples, TriggerRule::Latch));
            }
        }
        for setting in self.adaptive_px.iter().map(|px| Setting::adaptive(*px, ADAPTIVE_HZ, 4)) {
            setting.run_config(&RunConfig::default()).map_or(Ok(()), |config| config.check())?;
            add(setting);
        }
        self.presets.iter().for_each(|quality| add(Setting::quality(*quality)));
        if self.decoupled {
            add(Setting::decoupled());
        }
        for &(keyframe_hz, steps) in &self.splat {
            let warp = Warp::default().at(keyframe_hz, steps);
            warp.check_scene()?;
            add(Setting::splat(warp, 4, TriggerRule::Crossing));
        }
        if self.splat_triggers {
            add(Setting::splat(Warp::default(), 4, TriggerRule::Latch));
            add(Setting::splat(Warp::evis_paper(8), 4, TriggerRule::Crossing));
        }
        if self.published {
            published().into_iter().for_each(&mut add);
        }
        if all.is_empty() {
            return Err(ConfigError::new(
                "ladder",
                "empty",
                "at least one setting: give `rates_hz` and `samples`, or leave the published settings in",
            ));
        }
        Ok(all)
    }
}

/// The settings of the EVIS paper's table (its section on speed): every frame rendered, and four ways to warp
/// fewer of them, all with its latch. How many samples its renderer takes is not stated; 4 stands for it. The threshold
/// and eps are those of the chart, as for every other point: truth has one pixel.
pub fn published() -> Vec<Setting> {
    let warp = |rendered_hz: f64, steps: u32| Setting {
        published: Some(format!("paper {}×{steps}", number(rendered_hz))),
        ..Setting::splat(Warp::evis_paper(steps).at(rendered_hz, steps), 4, TriggerRule::Latch)
    };
    let rendered = Setting {
        published: Some("paper 1000 Hz".into()),
        ..Setting::native(1000.0, 4, Antialias::Samples, TriggerRule::Latch)
    };
    vec![rendered, warp(250.0, 4), warp(125.0, 8), warp(40.0, 8), warp(30.0, 8)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_ladder_has_every_step_once() {
        let all = Ladder::default().settings().unwrap();
        assert!(all.iter().all(|s| s.engine_method().is_some()));
        assert_eq!(all.len(), 6 * 4 - 2 + 3 + 4 + 4 + 2 + 3 + 3 + 1);
        let whole = Ladder { most_samples_hz: None, ..Ladder::default() }.settings().unwrap();
        assert_eq!(whole.len(), all.len() + 2, "2000 and 4000 Hz of 16 samples are left out");
        let mut labels: Vec<_> = all.iter().map(Setting::label).collect();
        labels.sort();
        let before = labels.len();
        labels.dedup();
        assert_eq!(labels.len(), before, "labels tell settings apart");
        let named: Vec<_> = all.iter().filter_map(|s| s.published.as_deref()).collect();
        assert_eq!(named, ["paper 1000 Hz", "paper 250×4", "paper 125×8", "paper 40×8", "paper 30×8"]);
        let draft = Setting::quality(Quality::Draft);
        assert_eq!((draft.label(), draft.run_flags()), ("draft".into(), "--quality draft".into()));
        let ran = RunConfig { rate_hz: 4000.0, samples: 4, ..RunConfig::default() };
        let settled = draft.settled(&ran, 700.0);
        assert_eq!((settled.rate_hz, settled.rendered_hz, settled.samples), (4000.0, 700.0, 4));
        let decoupled = Setting::decoupled();
        assert_eq!(
            (decoupled.label(), decoupled.run_flags()),
            ("decoupled".into(), "--method decoupled".into())
        );
        let adaptive = Setting::adaptive(0.5, 2000.0, 4);
        assert_eq!(adaptive.label(), "0.5 px up to 2000 Hz ×4");
        assert_eq!(adaptive.run_flags(), "--rate 2000 --adaptive 0.5 --samples 4");
        assert_eq!(adaptive.settled(&ran, 300.0).rendered_hz, 300.0, "by the pictures that were drawn");
        assert!(Ladder::quick().settings().unwrap().len() < all.len() / 2 + 5);
    }

    #[test]
    fn settings_become_runs_where_the_method_exists() {
        let base = RunConfig { size: Some((8, 6)), ..RunConfig::default() };
        let edges = Setting::native(250.0, 4, Antialias::Edges, TriggerRule::Crossing);
        let run = edges.run_config(&base).unwrap();
        assert_eq!((run.rate_hz, run.antialias, run.size), (250.0, Antialias::Edges, Some((8, 6))));
        assert_eq!(edges.label(), "250 Hz edges");
        assert_eq!(edges.run_flags(), "--rate 250 --antialias edges");
        let warp = &published()[1];
        assert_eq!(warp.label(), "evis-paper 250×4 Hz ×4 latch");
        assert_eq!(
            warp.run_flags(),
            "--method evis-paper --keyframe-rate 250 --steps 4 --samples 4 --trigger latch"
        );
        let crossing = Setting { trigger: TriggerRule::Crossing, ..warp.clone() };
        assert!(crossing.run_flags().ends_with("--trigger crossing"), "the paper's own is latch");
        let splat = Warp { margin: Some(16), ..Warp::default() };
        let splat = Setting::splat(splat, 4, TriggerRule::Crossing);
        assert_eq!(splat.label(), "splat 125×8 Hz ×4 margin 16");
        assert_eq!(splat.run_flags(), "--method splat --keyframe-rate 125 --steps 8 --margin 16 --samples 4");
        assert_eq!(warp.rate_hz, 1000.0);
        let unknown = Setting { method: "teleport".into(), ..edges };
        assert!(unknown.run_config(&base).is_none());
    }

    #[test]
    fn what_is_named_is_measured_whole_and_what_is_left_out_is_not() {
        let asked = |request: LadderRequest| Ladder::from(request);
        assert_eq!(asked(LadderRequest::default()), Ladder::default());
        assert_eq!(asked(LadderRequest { quick: true, ..Default::default() }), Ladder::quick());
        let named = LadderRequest { samples: Some(vec![64]), edges: Some(false), ..Default::default() };
        let expected = Ladder { samples: vec![64], edges: false, most_samples_hz: None, ..Ladder::default() };
        assert_eq!(asked(named), expected);
        let latches = LadderRequest { latch_hz: Some(vec![500.0]), ..Default::default() };
        assert_eq!(asked(latches), Ladder { latch_hz: vec![500.0], ..Ladder::default() });
        let bare = asked(LadderRequest {
            no_published: true,
            no_splat: true,
            no_adaptive: true,
            ..Default::default()
        });
        assert!(!bare.published && bare.splat.is_empty() && !bare.splat_triggers);
        assert!(bare.adaptive_px.is_empty() && bare.presets.is_empty() && !bare.decoupled);
    }

    #[test]
    fn ladders_that_cannot_run_are_refused() {
        let none = Ladder {
            rates_hz: vec![],
            samples: vec![],
            edges: false,
            latch_hz: vec![],
            most_samples_hz: None,
            published: false,
            adaptive_px: vec![],
            presets: vec![],
            decoupled: false,
            splat: vec![],
            splat_triggers: false,
        };
        assert!(none.settings().unwrap_err().to_string().contains("at least one setting"));
        for bad in [0.0, -1.0, f64::NAN, 2.0e6] {
            let error =
                Ladder { rates_hz: vec![bad], ..Ladder::default() }.settings().unwrap_err().to_string();
            assert!(error.contains("rates"), "{error}");
        }
        let error = Ladder { splat: vec![(0.0, 8)], ..Ladder::default() }.settings().unwrap_err().to_string();
        assert!(error.contains("keyframe_hz"), "{error}");
        let error = Ladder { samples: vec![0], ..Ladder::default() }.settings().unwrap_err().to_string();
        assert!(error.contains("samples is 0"), "{error}");
    }
}
