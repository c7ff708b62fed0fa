//! What an emulator remembers, as bytes.

use std::hash::Hasher as _;

use bytemuck::Pod;

use super::chain::{LONG_AGO, REBASE_US};
use super::ideal::{Memory as IdealMemory, Pixels};
use super::keyframes::{Keyframe, MOST_MARGIN};
use super::numbering::Numbering;
use super::order::MAX_INTERVAL_US;
use super::{Chain, Diffuse, EmulatorReport, Environment, EventEmulator, Kernel, Memory, Tile};
use crate::event::{Event, MOST_T_US};
use crate::fnv::Fnv;
use crate::sensor::ConfigError;

/// Begins every state; the last digit is the layout's version.
const MAGIC: &[u8; 8] = b"EVISEMU5";

/// Bytes of the hash that ends every state.
const HASH_BYTES: usize = 8;

/// Larger logarithms of light mean nothing: those of all numbers that light can have are below 200.
const MOST_LOG: f32 = 1e6;

/// No stream has more events, and what is added to it stays a number.
const MOST_COUNT: u64 = 1 << 62;

/// FNV-1a with words of eight bytes in the place of bytes: states have millions. The last word is filled up with zeros.
fn hash(bytes: &[u8]) -> u64 {
    let (words, rest) = bytes.as_chunks::<8>();
    let mut last = [0; 8];
    last[..rest.len()].copy_from_slice(rest);
    words.iter().chain([&last]).fold(0xcbf2_9ce4_8422_2325, |hash: u64, word| {
        // Upper bits of a word reach the lower ones of the product only when they are turned.
        (hash ^ u64::from_le_bytes(*word)).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29)
    })
}

/// Refuses what cannot be.
fn require(possible: bool) -> Result<(), Broken> {
    if possible { Ok(()) } else { Err(Broken) }
}

/// Whether all values are within `least` and `most`, or NaN: not known.
fn known_within(values: &[f32], least: f32, most: f32) -> bool {
    values.iter().all(|value| value.is_nan() || (least..=most).contains(value))
}

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
        let hash = hash(&out);
        out.extend_from_slice(&hash.to_le_bytes());
        out
    }

    /// Takes up where [`Self::state`] was called, on an emulator of the same settings; the number of threads may differ.
    ///
    /// # Errors
    /// Bytes that are no state, a damaged one, or one of other settings. Nothing has changed then.
    pub fn restore(&mut self, state: &[u8]) -> Result<(), ConfigError> {
        let mut now = (0, 0);
        let mut total = EmulatorReport::default();
        let mut environments = self.environments.clone();
        let refused = |what: &str| {
            let value = format!("{} bytes {what}", state.len());
            Err(ConfigError::new("state", value, "what an emulator of the same settings gave"))
        };
        let content = match state.split_last_chunk::<HASH_BYTES>() {
            Some((content, stored)) if u64::from_le_bytes(*stored) == hash(content) => content,
            _ if state.starts_with(MAGIC) => return refused("that are damaged"),
            _ => return refused("that cannot be read"),
        };
        let mut pass = Pass::Read(content);
        let read = self.walk(&mut pass, &mut now, &mut total, &mut environments);
        let whole = matches!(pass, Pass::Read([]));
        // An interval since no time would be empty, and pixels would fire in it.
        let timeless = now.0 == 0 && environments.iter().any(Environment::has_light);
        if read.is_err() || !whole || timeless {
            return refused("that cannot be read");
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
        require(now.0 <= 1 && (-MOST_T_US..=MOST_T_US).contains(&now.1))?;
        let now_us = now.1;
        let EmulatorReport { events, unknown, clamped, suppressed, dropped } = total;
        for count in [events, unknown, clamped, suppressed, dropped] {
            pass.one(count)?;
            require(*count <= MOST_COUNT)?;
        }
        for environment in environments {
            let mut started = u64::from(environment.started);
            pass.one(&mut started)?;
            require(started <= 1)?;
            environment.started = started != 0;
            pass.list(&mut environment.queue.waiting)?;
            pass.one(&mut environment.queue.free_ns)?;
            pass.one(&mut environment.queue.window)?;
            pass.one(&mut environment.queue.used)?;
            if pass.reads() {
                let queue = &environment.queue;
                let fits = |event: &Event| {
                    u32::from(event.x) < self.config.width
                        && u32::from(event.y) < self.config.height
                        && (0..=1).contains(&event.p)
                        && event.has_cause()
                        && (-MOST_T_US..=MOST_T_US).contains(&event.t)
                };
                require(queue.waiting.iter().all(fits) && queue.waiting.is_sorted_by_key(Event::order))?;
                let times = -MOST_T_US..=MOST_T_US;
                require(times.contains(&(queue.free_ns / 1000)) && times.contains(&queue.window))?;
                require(queue.used <= u64::from(u32::MAX))?;
            }
            if let Some(light) = &mut environment.exposing {
                let mut since = (u64::from(light.since_us.is_some()), light.since_us.unwrap_or_default());
                pass.one(&mut since.0)?;
                pass.one(&mut since.1)?;
                require(since.0 <= 1 && (-MOST_T_US..=now_us.max(0)).contains(&since.1))?;
                light.since_us = (since.0 != 0).then_some(since.1);
                if light.since_us.is_some() {
                    pass.all(&mut light.last)?;
                    pass.all(&mut light.sum)?;
                    require(known_within(&light.last, 0.0, f32::MAX))?;
                    require(light.sum.iter().all(|sum| sum.is_nan() || (0.0..=f64::MAX).contains(sum)))?;
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
                self.walk_tile(pass, key, tile, now_us)?;
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

    fn walk_tile(
        &self,
        pass: &mut Pass<'_>,
        key: crate::random::Key,
        tile: &mut Tile,
        now_us: i64,
    ) -> Result<(), Broken> {
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
                    Memory::Chain(Box::new(Chain::new(plan, key, Numbering::run(tile.first), pixels)))
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
                pass.all(&mut chain.polarity)?;
                if !pass.reads() {
                    return Ok(());
                }
                // A tile's clock starts at a frame that it has seen, and is moved on before the next one where that is long ago.
                let age_us = now_us.checked_sub(chain.base_us).ok_or(Broken)?;
                require((0..=REBASE_US + MAX_INTERVAL_US).contains(&age_us))?;
                let ages = chain.moved.iter().chain(&chain.fired);
                require(ages.into_iter().all(|us| *us >= LONG_AGO && i64::from(*us) <= age_us))?;
                require(chain.polarity.iter().all(|polarity| *polarity <= 2))?;
                require(known_within(&chain.now.light, 0.0, f32::MAX))?;
                let held = |value: &f32| value.is_infinite() || known_within(&[*value], -MOST_LOG, MOST_LOG);
                require(chain.reference.iter().all(held))?;
                let signals = [&chain.now.input, &chain.now.first, &chain.now.second, &chain.slope];
                require(signals.into_iter().all(|values| known_within(values, -MOST_LOG, MOST_LOG)))
            }
            Memory::Diffusion(diffuse) => {
                pass.all(&mut diffuse.level)?;
                pass.all(&mut diffuse.light)?;
                pass.all(&mut diffuse.fired)?;
                require(
                    !pass.reads()
                        || diffuse.fired.iter().all(|fired| (i64::MIN / 2..=now_us).contains(fired)),
                )?;
                require(
                    known_within(&diffuse.level, -1.0, 1.0) && known_within(&diffuse.light, 0.0, f32::MAX),
                )
            }
        }
    }
}

fn walk_ideal<T: Pod>(pass: &mut Pass<'_>, memory: &mut IdealMemory<T>) -> Result<(), Broken> {
    pass.all(&mut memory.reference)?;
    pass.all(&mut memory.last)?;
    pass.all(&mut memory.low)?;
    pass.all(&mut memory.high)?;
    require(!pass.reads() || known_within(&memory.reference, -MOST_LOG, MOST_LOG))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::emulator::{EmulatorConfig, FrameData, Frames};
    use crate::sensor::{Readout, SensorConfig};

    const WIDTH: u32 = 24;
    const HEIGHT: u32 = 16;

    fn emulator(sensor: &SensorConfig) -> EventEmulator {
        EventEmulator::new(EmulatorConfig {
            width: WIDTH,
            height: HEIGHT,
            sensor: sensor.clone(),
            threads: 1,
            ..EmulatorConfig::default()
        })
        .unwrap()
    }

    fn push(emulator: &mut EventEmulator, k: i64, t_us: i64) -> Result<Vec<Vec<Event>>, ConfigError> {
        let light: Vec<f32> =
            (0..WIDTH * HEIGHT).map(|i| 0.2 + ((i64::from(i) * 7 + k * 13) % 11) as f32).collect();
        emulator.push(&Frames { data: FrameData::Linear(&light), channels: 1 }, t_us)
    }

    fn sensors() -> Vec<SensorConfig> {
        let bus = Readout { row_ns: 30_000, event_ns: 700, ..Readout::default() };
        let ideal = SensorConfig::default();
        let with = |name: &str| SensorConfig::preset(name).unwrap();
        vec![ideal.clone(), with("v2e-noisy"), with("davis346"), SensorConfig { readout: bus, ..ideal }]
    }

    #[test]
    fn every_flipped_bit_of_a_state_is_noticed() {
        for sensor in sensors() {
            let mut one = emulator(&sensor);
            for k in 0..3 {
                push(&mut one, k, k * 1000).unwrap();
            }
            let state = one.state();
            emulator(&sensor).restore(&state).unwrap();
            for at in (0..state.len()).step_by(7) {
                let mut damaged = state.clone();
                damaged[at] ^= 1 << (at % 8);
                assert!(one.restore(&damaged).is_err(), "byte {at} of {}", state.len());
            }
            assert_eq!(one.state(), state, "what is refused changes nothing");
        }
    }

    #[test]
    fn light_that_was_seen_at_no_time_is_refused() {
        for sensor in sensors() {
            let mut one = emulator(&sensor);
            push(&mut one, 0, 1000).unwrap();
            let state = one.state();
            // Behind magic and identity: whether there is a time.
            for (flag, is_taken) in [(0, false), (1, true)] {
                let mut changed = state[..state.len() - HASH_BYTES].to_vec();
                changed[16] = flag;
                let sum = hash(&changed);
                changed.extend(sum.to_le_bytes());
                assert_eq!(emulator(&sensor).restore(&changed).is_ok(), is_taken);
            }
        }
    }

    #[test]
    fn clocks_at_the_ends_of_their_type_are_refused() {
        let sensor = SensorConfig::preset("v2e-noisy").unwrap();
        let mut one = emulator(&sensor);
        push(&mut one, 0, 1000).unwrap();
        let state = one.state();
        let mut refused = 0;
        // Every place that may hold a clock: counts, and what a tile begins with.
        for (at, far) in (16..400).flat_map(|at| [(at, i64::MIN), (at, i64::MAX)]) {
            let mut damaged = state[..state.len() - HASH_BYTES].to_vec();
            damaged[at..at + 8].copy_from_slice(&far.to_le_bytes());
            let sum = hash(&damaged);
            damaged.extend(sum.to_le_bytes());
            refused += usize::from(emulator(&sensor).restore(&damaged).is_err());
        }
        assert!(refused > 100, "{refused}");
    }

    #[test]
    fn states_made_to_harm_are_refused_or_do_none() {
        let (mut taken, mut refused) = (0, 0);
        let mut word = 9_u64;
        let mut random = |below: usize| {
            word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (word >> 33) as usize % below
        };
        for sensor in sensors() {
            let mut one = emulator(&sensor);
            for k in 0..3 {
                push(&mut one, k, k * 1000).unwrap();
            }
            let state = one.state();
            for _ in 0..400 {
                let mut damaged = state[..state.len() - HASH_BYTES].to_vec();
                // Not what it belongs to; its clock and counts, which are short, as often as all the rest.
                let end = [72, damaged.len()][random(2)];
                let at = 16 + random(end - 16);
                match random(4) {
                    0 => damaged[at] = [0, 0x7f, 0x80, 0xff][random(4)],
                    1 => {
                        let end = damaged.len().min(at + 8);
                        damaged[at..end].fill([0, 0x7e, 0xff][random(3)]);
                    }
                    _ => damaged[at] ^= 1 << random(8),
                }
                let sum = hash(&damaged);
                damaged.extend(sum.to_le_bytes());
                let mut other = emulator(&sensor);
                if other.restore(&damaged).is_err() {
                    refused += 1;
                    continue;
                }
                taken += 1;
                for k in 3..6 {
                    let now_us = other.now_us().unwrap_or(0);
                    // A time that is too far away is refused as any other one would be.
                    let Ok(lists) = push(&mut other, k, now_us.max(2000) + 1000) else { break };
                    for event in lists.iter().flatten() {
                        assert!(u32::from(event.x) < WIDTH && u32::from(event.y) < HEIGHT, "{event:?}");
                        assert!((0..=1).contains(&event.p), "{event:?}");
                    }
                }
            }
        }
        assert!(taken > 200 && refused > 200, "{taken} taken, {refused} refused");
    }
}
