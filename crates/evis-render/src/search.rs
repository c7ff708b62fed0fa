//! Settings for a target, found on the scene: a [pilot](crate::pilot) lets some tiles fire with the finest settings and with
//! cheaper ones, and the cheapest that have what the target asks for are taken.

use std::cell::RefCell;
use std::sync::Arc;

use evis_scene::Scene;
use serde::{Deserialize, Serialize};

use crate::auto::{Rung, Site, Target};
use crate::config::{Antialias, Between, Method, RunConfig, Shadows};
use crate::error::EngineError;
use crate::gpu::Gpu;
use crate::pilot::{Fired, PLACES, Pilot};
use crate::plan::{Settings, Told};

pub use crate::pilot::Agreement;

/// What `exact` is to be as near to the finest settings as: `native`, everything at this rate, with so many samples.
const NATIVE_HZ: f64 = 2000.0;
const NATIVE_SAMPLES: u32 = 16;
/// By how much F1 within 100 us may be below its, and how many times its median time error may be. The goal is 0.01 and 1.1:
/// the rest is left for tiles and times that were not looked at.
const F1_BELOW: f64 = 0.008;
/// By how much it must be above instead where samples are taken as the finest settings take them, and up to where: such
/// settings share errors with those, and were better beside them than beside the truth by 0.047, 0.062 and 0.035 on
/// `spinner`, `desk` and `street`, all compared with `native`.
const F1_ABOVE: f64 = 0.05;
const F1_ENOUGH: f64 = 0.99;
const MEDIAN_TIMES: f64 = 1.05;

/// What settings must have beside the finest ones, to be taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Wanted {
    /// F1 within 1 ms of at least so much.
    F1(f64),
    /// F1 within 100 us and a median time error like those of `native`.
    AsNative,
}

impl Wanted {
    /// Whether settings that agree so have it; `native`: how that agrees, where it counts.
    fn is_met(self, tried: &Tried, native: Option<&Agreement>) -> bool {
        let own = &tried.agreement;
        match (self, native) {
            (Self::F1(least), _) => own.f1_1ms >= least,
            (Self::AsNative, None) => false,
            (Self::AsNative, Some(native)) => {
                let in_time = match (own.median_us, native.median_us) {
                    (Some(own), Some(native)) => own <= MEDIAN_TIMES * native,
                    (own, None) => own.is_some(),
                    (None, Some(_)) => false,
                };
                let least = match tried.as_finest {
                    false => native.f1_100us - F1_BELOW,
                    true => (native.f1_100us + F1_ABOVE).min(F1_ENOUGH),
                };
                in_time && own.f1_100us >= least
            }
        }
    }
}

/// What was looked at on a scene, and how it agreed with the finest settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Looked {
    /// Tiles, at all times together.
    pub tiles: usize,
    /// The finest settings, with which all others were compared: [`Settings::in_words`].
    pub finest: String,
    /// What was tried, the cheapest first.
    pub tried: Vec<Tried>,
    /// How `native` at a fixed rate agrees, where settings must be as near.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub native: Option<Agreement>,
}

/// Settings that were tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tried {
    /// [`Settings::in_words`].
    pub what: String,
    /// Whether they take samples as the finest settings do.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub as_finest: bool,
    /// How they agree.
    #[serde(flatten)]
    pub agreement: Agreement,
}

impl Looked {
    /// Which of those tried are taken: the first that has what is wanted. `None`: the finest settings are.
    pub(crate) fn taken(&self, wanted: Wanted) -> Option<usize> {
        self.tried.iter().position(|tried| wanted.is_met(tried, self.native.as_ref()))
    }

    /// Which settings these figures ask for, in words; what is wrong, if a look for `target` cannot have found them.
    pub(crate) fn asks_for(&self, target: Target) -> Result<&str, String> {
        let name = target.name();
        let wanted = target.wanted().ok_or_else(|| format!("{name} looks at nothing"))?;
        match (wanted, &self.native) {
            (Wanted::F1(_), Some(_)) => return Err(format!("{name} asks for nothing of native")),
            (Wanted::AsNative, None) => return Err("what native has is missing".into()),
            _ => {}
        }
        if self.tried.is_empty() {
            return Err("nothing was tried".into());
        }
        let tried = self.tried.iter().map(|tried| (tried.what.as_str(), &tried.agreement));
        for (what, of) in tried.chain(self.native.iter().map(|of| ("native", of))) {
            for (figure, value, most) in [
                ("F1 (1 ms)", of.f1_1ms, 1.0),
                ("F1 (100 us)", of.f1_100us, 1.0),
                ("median time error", of.median_us.unwrap_or_default(), f64::MAX),
            ] {
                if !(0.0..=most).contains(&value) {
                    return Err(format!("{figure} of '{what}' is {value}"));
                }
            }
        }
        Ok(self.taken(wanted).map_or(&self.finest, |taken| &self.tried[taken].what))
    }
}

/// The cheapest settings that fire as the finest do.
pub(crate) struct Search {
    /// What makes them good enough.
    pub wanted: Wanted,
    /// What is tried, the cheapest first; it also tells how many tiles it takes to see something.
    pub candidates: Vec<Rung>,
    /// What all are compared with, and what is taken where none of them will do.
    pub finest: Rung,
}

/// What was settled on.
pub(crate) struct Found {
    pub rung: Rung,
    /// What comes before why its rate.
    pub why: String,
    pub expects: String,
    /// `None` where nothing was found.
    pub looked: Option<Looked>,
}

impl Search {
    /// `None` where too little fires to tell settings apart.
    pub fn run(
        &self,
        gpu: &Gpu,
        scene: &Arc<Scene>,
        config: &RunConfig,
        site: &Site<'_>,
        told: &Told<'_>,
    ) -> Result<Option<Found>, EngineError> {
        let doing = RefCell::new((String::new(), 0.0));
        let stop = || {
            let doing = doing.borrow();
            !told(&doing.0, doing.1)
        };
        let mut pilot = Pilot::new(gpu, scene, config, site, &stop)?;
        // Beside the candidates: the first once more, the finest, and native.
        let count = self.candidates.len() + 2 + usize::from(self.wanted == Wanted::AsNative);
        let mut done = 0;
        let mut fire = |pilot: &mut Pilot<'_>, what: String, settled: &RunConfig| {
            *doing.borrow_mut() = (what, f64::from(done) / count as f64);
            done += 1;
            pilot.fire(settled)
        };
        // Tiles are looked at as sensors of thresholds see them, and what runs is told as their own sensors take it.
        let looks = |rung: &Rung| site.settled_for_thresholds(rung, config).0;
        let runs = |rung: &Rung| Settings::of(&site.settled(rung, config).0).in_words();

        let Some(first) = self.candidates.first().map(looks) else { return Ok(None) };
        let probe = fire(&mut pilot, words(&first), &first)?;
        pilot.adjust(&probe);
        let finest = looks(&self.finest);
        let finer = fire(&mut pilot, words(&finest), &finest)?;
        let mut looked =
            Looked { tiles: pilot.tiles(), finest: runs(&self.finest), tried: Vec::new(), native: None };
        if self.wanted == Wanted::AsNative {
            let fired = fire(&mut pilot, native_in_words(), &native(config))?;
            looked.native = pilot.agreement(&fired, &finer)?;
        }
        let mut tried = Vec::new();
        for rung in &self.candidates {
            let settled = looks(rung);
            let fired: Fired = fire(&mut pilot, words(&settled), &settled)?;
            let Some(agreement) = pilot.agreement(&fired, &finer)? else { return Ok(None) };
            tried.push(format!("{} ({})", self.figures(&agreement), words(&settled)));
            let as_finest = rung.antialias == self.finest.antialias;
            looked.tried.push(Tried { what: runs(rung), as_finest, agreement });
            if looked.taken(self.wanted).is_some() {
                let expects = match self.wanted {
                    Wanted::F1(_) => format!("F1 (1 ms) {:.3}", agreement.f1_1ms),
                    Wanted::AsNative => format!("F1 (100 us) {:.3}", agreement.f1_100us),
                };
                return Ok(Some(Found {
                    rung: *rung,
                    why: self.why(&looked, &tried, &words(&finest)),
                    expects: format!("{expects}, as beside the finest settings in those tiles"),
                    looked: Some(looked),
                }));
            }
        }
        Ok(Some(Found {
            rung: self.finest,
            why: self.why(&looked, &tried, &words(&finest)) + "so the finest settings are taken; ",
            expects: self.finest.expects.into(),
            looked: Some(looked),
        }))
    }

    /// `0.812, 20 us`: what counts of how some settings agree.
    fn figures(&self, of: &Agreement) -> String {
        match (self.wanted, of.median_us) {
            (Wanted::F1(_), _) => format!("{:.3}", of.f1_1ms),
            (Wanted::AsNative, Some(median_us)) => format!("{:.3}, {median_us:.1} us", of.f1_100us),
            (Wanted::AsNative, None) => format!("{:.3}, no time error", of.f1_100us),
        }
    }

    fn why(&self, looked: &Looked, tried: &[String], finest: &str) -> String {
        let (asked, figure) = match (self.wanted, &looked.native) {
            (Wanted::F1(f1), _) => (f1.to_string(), "F1 (1 ms)"),
            (Wanted::AsNative, native) => {
                let has = native.map_or_else(String::new, |native| format!(" ({})", self.figures(&native)));
                (format!("what {} has{has}", native_in_words()), "F1 (100 us) and median time error")
            }
        };
        format!(
            "{asked} is asked for; {figure} beside {finest}, in {} tiles at {PLACES} times of the scene: {}; ",
            looked.tiles,
            tried.join(", ")
        )
    }
}

/// `0.4 px, 100 samples, rays`.
fn words(config: &RunConfig) -> String {
    let whole = if config.antialias == Antialias::Samples { " whole" } else { "" };
    let rays = if config.shadows == Some(Shadows::Rays) { ", rays" } else { "" };
    format!("{} px, {}{whole} samples{rays}", config.adaptive_px.unwrap_or_default(), config.samples)
}

fn native_in_words() -> String {
    format!("native at {NATIVE_HZ} Hz with {NATIVE_SAMPLES} whole samples")
}

/// What `config` renders, by `native` at a fixed rate; what the user says of shadows stays.
///
/// Where nothing may move at all between two samples, adaptive time looks at every instant of what changes, and fires what
/// the fixed rate does: but it draws those tiles alone that are looked at.
pub(crate) fn native(config: &RunConfig) -> RunConfig {
    RunConfig {
        method: Method::Native,
        rate_hz: NATIVE_HZ,
        adaptive_px: Some(f64::MIN_POSITIVE),
        between: Between::Line,
        antialias: Antialias::Samples,
        samples: NATIVE_SAMPLES,
        texture_taps: Some(4),
        shadows: Some(config.shadows.unwrap_or(Shadows::Maps)),
        ..config.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn agreement(f1_1ms: f64, f1_100us: f64, median_us: f64) -> Agreement {
        Agreement { f1_1ms, f1_100us, median_us: Some(median_us) }
    }

    #[test]
    fn the_first_that_has_what_is_wanted_is_taken() {
        let with = |as_finest: bool, tried: &[Agreement], native: Option<Agreement>, wanted: Wanted| {
            let tried = tried
                .iter()
                .map(|agreement| Tried { what: String::new(), as_finest, agreement: *agreement })
                .collect();
            Looked { tiles: 1, finest: String::new(), tried, native }.taken(wanted)
        };
        let of = |tried: &[Agreement], native, wanted| with(false, tried, native, wanted);
        let tried =
            [(0.94, 0.9, 5.0), (0.96, 0.7, 8.0), (0.98, 0.6, 30.0)].map(|(a, b, c)| agreement(a, b, c));
        assert_eq!(of(&tried, None, Wanted::F1(0.95)), Some(1));
        assert_eq!(of(&tried, None, Wanted::F1(0.98)), Some(2));
        assert_eq!(of(&tried, None, Wanted::F1(0.981)), None);
        // Both count, each with its own margin.
        let near = |own, native| of(&[own], Some(native), Wanted::AsNative).is_some();
        let native = agreement(0.97, 0.8, 100.0);
        assert!(near(native, native));
        assert!(near(agreement(0.5, 0.7921, 104.9), native), "what counts is not F1 within 1 ms");
        assert!(!near(agreement(0.99, 0.7919, 50.0), native));
        // What shares the finest settings' errors must do better.
        let alike = |own, native| with(true, &[own], Some(native), Wanted::AsNative).is_some();
        assert!(!alike(agreement(0.99, 0.849, 50.0), native) && alike(agreement(0.99, 0.851, 50.0), native));
        assert!(alike(agreement(0.99, 0.991, 1.0), agreement(0.99, 0.98, 1.0)));
        assert!(!near(agreement(0.99, 0.9, 105.1), native));
        let without = |of: Agreement| Agreement { median_us: None, ..of };
        assert!(!near(without(native), native) && near(native, without(native)));
        assert_eq!(of(&tried, None, Wanted::AsNative), None, "nothing to be as near as");
    }
}
