//! What an emulator remembers, as bytes.

use std::hash::Hasher as _;

use bytemuck::Pod;

use super::ideal::{Memory as IdealMemory, Pixels};
use super::keyframe::Keyframe;
use super::warp::MOST_MARGIN;
use super::{Chain, Diffuse, EmulatorReport, Environment, EventEmulator, Kernel, Memory, Tile};
use crate::event::Event;
use crate::fnv::Fnv;
use crate::sensor::ConfigError;

/// Begins every state; the last digit is the layout's version.
const MAGIC: &[u8; 8] = b"EVISEMU4";

/// Writes or reads the same things in the same order.
enum Pass<'a> {
    Write(&'a mut Vec<u8>),
    Read(&'a [u8]),
}

/// The bytes end too early, or hold what cannot be.
struct Broken;

impl Pass<'_> {
    fn one<T: Pod>(&mut self, value: &mut T) -> Result<(), Broken> {
        self.all(std::slice::from_mut(value))
    }

    fn all<T: Pod>(&mut self, values: &mut [T]) -> Result<(), Broken> {
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(values);
        match self {
            Self::Write(out) => out.extend_from_slice(bytes),
            Self::Read(rest) => {
                let (own, later) = rest.split_at_checked(bytes.len()).ok_or(Broken)?;
                bytes.copy_from_slice(own);
                *rest = later;
            }
        }
        Ok(())
    }

    fn list<T: Pod>(&mut self, values: &mut Vec<T>) -> Result<(), Broken> {
        let mut length = values.len() as u64;
        self.one(&mut length)?;
        if let Self::Read(rest) = self {
            if length > rest.len() as u64 {
                return Err(Broken);
            }
            values.resize(length as usize, T::zeroed());
        }
        self.all(values)
    }

    const fn reads(&self) -> bool {
        matches!(self, Self::Read(_))
    }
}

impl EventEmulator {
    /// Everything that the next events depend on, apart from the settings; see [`Self::restore`].
    pub fn state(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let mut now = (u64::from(self.now_us.is_some()), self.now_us.unwrap_or_default());
        let mut total = self.total;
        let mut environments = self.environments.clone();
        let mut pass = Pass::Write(&mut out);
        // Writing cannot fail.
        let _ = self.walk(&mut pass, &mut now, &mut total, &mut environments);
        out
    }

    /// Takes up where [`Self::state`] was called, on an emulator of the same settings; the number of threads may differ.
    ///
    /// # Errors
    /// Bytes that are no state, or one of other settings. Nothing has changed then.
    pub fn restore(&mut self, state: &[u8]) -> Result<(), ConfigError> {
        let mut now = (0, 0);
        let mut total = EmulatorReport::default();
        let mut environments = self.environments.clone();
        let mut pass = Pass::Read(state);
        let read = self.walk(&mut pass, &mut now, &mut total, &mut environments);
        let whole = matches!(pass, Pass::Read([]));
        if read.is_err() || !whole {
            let value = format!("{} bytes that cannot be read", state.len());
            return Err(ConfigError::new("state", value, "what an emulator of the same settings gave"));
        }
        self.now_us = (now.0 != 0).then_some(now.1);
        self.total = total;
        self.last = EmulatorReport::default();
        self.environments = environments;
        Ok(())
    }

    /// Settings that a state belongs to.
    fn identity(&self) -> u64 {
        let config = &self.config;
        let text = format!(
            "{} {} {} {} {} {} {}",
            config.width,
            config.height,
            config.batch,
            config.seed,
            config.camera,
            config.reference_luminance,
            config.sensor.to_toml()
        );
        let mut fnv = Fnv::default();
        fnv.write(text.as_bytes());
        fnv.finish()
    }

    fn walk(
        &self,
        pass: &mut Pass<'_>,
        now: &mut (u64, i64),
        total: &mut EmulatorReport,
        environments: &mut [Environment],
    ) -> Result<(), Broken> {
        let mut magic = *MAGIC;
        let mut identity = self.identity();
        pass.all(&mut magic)?;
        pass.one(&mut identity)?;
        if magic != *MAGIC || identity != self.identity() {
            return Err(Broken);
        }
        pass.one(&mut now.0)?;
        pass.one(&mut now.1)?;
        let EmulatorReport { events, unknown, clamped, suppressed, dropped } = total;
        for count in [events, unknown, clamped, suppressed, dropped] {
            pass.one(count)?;
        }
        for environment in environments {
            let mut started = u64::from(environment.started);
            pass.one(&mut started)?;
            environment.started = started != 0;
            pass.list(&mut environment.wire.waiting)?;
            pass.one(&mut environment.wire.free_ns)?;
            pass.one(&mut environment.wire.window)?;
            pass.one(&mut environment.wire.used)?;
            if pass.reads() && environment.wire.waiting.iter().any(|event: &Event| event.p as u16 > 1) {
                return Err(Broken);
            }
            if let Some(light) = &mut environment.exposing {
                let mut since = (u64::from(light.since_us.is_some()), light.since_us.unwrap_or_default());
                pass.one(&mut since.0)?;
                pass.one(&mut since.1)?;
                light.since_us = (since.0 != 0).then_some(since.1);
                if light.since_us.is_some() {
                    pass.all(&mut light.last)?;
                    pass.all(&mut light.sum)?;
                }
            }
            if !environment.has_light() {
                continue;
            }
            self.walk_keyframe(pass, &mut environment.keyframe)?;
            if !environment.started {
                continue;
            }
            let key = environment.key;
            for tile in &mut environment.tiles {
                self.walk_tile(pass, key, tile)?;
            }
        }
        Ok(())
    }

    fn walk_keyframe(&self, pass: &mut Pass<'_>, keyframe: &mut Option<Box<Keyframe>>) -> Result<(), Broken> {
        let mut is_there = u64::from(keyframe.is_some());
        pass.one(&mut is_there)?;
        if is_there == 0 {
            *keyframe = None;
            return Ok(());
        }
        let keyframe = keyframe.get_or_insert_default();
        pass.one(&mut keyframe.margin)?;
        if keyframe.margin > MOST_MARGIN {
            return Err(Broken);
        }
        pass.one(&mut keyframe.gap_us)?;
        pass.list(&mut keyframe.light)?;
        pass.list(&mut keyframe.nearness)?;
        pass.list(&mut keyframe.back)?;
        pass.list(&mut keyframe.forward)?;
        let margin = 2 * u64::from(keyframe.margin);
        let size = (u64::from(self.config.width) + margin) * (u64::from(self.config.height) + margin);
        let pixels = keyframe.light.len();
        let whole =
            pixels as u64 == size && keyframe.nearness.len() == pixels && keyframe.back.len() == pixels;
        if !whole || !matches!(keyframe.forward.len(), n if n == 0 || n == pixels) {
            return Err(Broken);
        }
        Ok(())
    }

    fn walk_tile(&self, pass: &mut Pass<'_>, key: crate::random::Key, tile: &mut Tile) -> Result<(), Broken> {
        let pixels = tile.end - tile.first;
        let mut kind: u64 = match &tile.memory {
            Memory::None => 0,
            Memory::Ideal(Pixels::Light(_)) => 1,
            Memory::Ideal(Pixels::Log(_)) => 2,
            Memory::Ideal(Pixels::U8(_)) => 3,
            Memory::Ideal(Pixels::U16(_)) => 4,
            Memory::Chain(_) => 5,
            Memory::Diffusion(_) => 6,
        };
        pass.one(&mut kind)?;
        if pass.reads() {
            tile.memory = match (kind, &self.kernel) {
                (1..=4, Kernel::Ideal) => Memory::Ideal(Pixels::of_kind(kind, pixels)),
                (5, Kernel::Chain(plan)) => {
                    Memory::Chain(Box::new(Chain::new(plan, key, tile.first, pixels)))
                }
                (6, Kernel::Diffusion) => Memory::Diffusion(Diffuse::new(pixels)),
                _ => return Err(Broken),
            };
        }
        match &mut tile.memory {
            Memory::None => Err(Broken),
            Memory::Ideal(Pixels::Light(memory) | Pixels::Log(memory)) => walk_ideal(pass, memory),
            Memory::Ideal(Pixels::U8(memory)) => walk_ideal(pass, memory),
            Memory::Ideal(Pixels::U16(memory)) => walk_ideal(pass, memory),
            Memory::Chain(chain) => {
                pass.one(&mut chain.base_us)?;
                pass.all(&mut chain.reference)?;
                for values in [
                    &mut chain.now.input,
                    &mut chain.now.first,
                    &mut chain.now.second,
                    &mut chain.now.light,
                    &mut chain.slope,
                ] {
                    pass.all(values)?;
                }
                pass.all(&mut chain.moved)?;
                pass.all(&mut chain.fired)?;
                pass.all(&mut chain.polarity)
            }
            Memory::Diffusion(diffuse) => {
                pass.all(&mut diffuse.level)?;
                pass.all(&mut diffuse.light)?;
                pass.all(&mut diffuse.fired)
            }
        }
    }
}

fn walk_ideal<T: Pod>(pass: &mut Pass<'_>, memory: &mut IdealMemory<T>) -> Result<(), Broken> {
    pass.all(&mut memory.reference)?;
    pass.all(&mut memory.last)?;
    pass.all(&mut memory.low)?;
    pass.all(&mut memory.high)
}
