//! A stream of events from a thread of its own: several views of a scene, block by block.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use evis_core::random::Key;
use evis_core::{Event, SensorConfig};
use evis_scene::Scene;

use crate::run::device::{Devices, Loaded};
use crate::run::pixels::{self, Pixels, Turn};
use crate::run::settings::{Report, Settings};
use crate::run::simulate::{picture, reference_luminance};
use crate::scene::holes::Holes;
use crate::scene::world::World;
use crate::shading::light::{Lighting, Shared};
use crate::visibility::blocks::Blocks;
use crate::{Error, unsupported};

/// How often a reader that waits looks whether it should stop.
const LOOK: Duration = Duration::from_millis(20);

/// Pieces that are simulated ahead of a slow reader, beside the one in work.
const AHEAD: usize = 2;

/// Pixels of views that a device follows together, at most: lists of all of them are there at a time.
const MOST_PIXELS: f64 = 4e6;

/// One camera of one environment.
#[derive(Clone, Debug)]
pub struct View {
    /// Index into [`Scene::cameras`].
    pub camera: usize,
    /// Index into [`Scene::variants`]; `None` is the scene as it is.
    pub variant: Option<usize>,
    /// Its sensor; without an exposure where a host gives poses, since that ends after a step.
    pub sensor: SensorConfig,
    /// Of all that is random in it.
    pub key: Key,
}

/// What a stream shows.
#[derive(Clone, Debug)]
pub struct StreamSettings {
    /// Width and height in pixels of every view; `None` takes each camera's own.
    pub size: Option<(u32, u32)>,
    /// Scene time at which the stream starts, in microseconds.
    pub start_us: i64,
    /// `Y_ref`; `None` takes the luminance that brings the log-mean of the first view's picture at the start to 0.18.
    pub reference_luminance: Option<f32>,
    /// See [`Settings::step_px`].
    pub step_px: f64,
    /// See [`Settings::rate_hz`].
    pub rate_hz: f64,
    /// Where a host moves nodes: microseconds, of which everything that is wanted is a multiple.
    pub pose_step_us: i64,
    /// Per view, row by row: in which tiles of [`crate::scene::tiles::TILE`] pixels anything may fire; everywhere in a view of which it says nothing.
    pub only: Vec<Vec<bool>>,
    /// See [`Settings::devices`].
    pub devices: Option<Arc<dyn Devices>>,
}

impl Default for StreamSettings {
    fn default() -> Self {
        let Settings { size, start_us, step_px, rate_hz, .. } = Settings::default();
        let (reference_luminance, pose_step_us, only, devices) = (None, 10_000, Vec::new(), None);
        Self { size, start_us, step_px, rate_hz, reference_luminance, pose_step_us, only, devices }
    }
}

impl StreamSettings {
    /// Those of one of `views`.
    fn of(&self, views: &[View], view: usize) -> Settings {
        let View { sensor, camera, key, .. } = views[view].clone();
        let Self { size, start_us, step_px, rate_hz, .. } = *self;
        // Many views have many sensors.
        let sensor_threads = usize::from(views.len() > 1);
        Settings {
            sensor,
            key,
            camera,
            size,
            start_us,
            step_px,
            rate_hz,
            sensor_threads,
            devices: self.devices.clone(),
            ..Settings::default()
        }
    }
}

/// Events of one view, as far as they are known.
#[derive(Debug)]
pub struct Piece {
    /// Index of the view.
    pub view: usize,
    /// Stream time before which all its events are there, in microseconds.
    pub complete_us: i64,
    /// Those that are new, in canonical order, marked with their causes ([`evis_core::event::take_causes`]). At the time where the last
    /// piece ended there may be more.
    pub events: Vec<Event>,
    /// What the view took since the stream began.
    pub report: Report,
}

/// Seconds of work per second of stream, of all its views together, by what its first usual block took: known before any event
/// of that block is sent.
#[derive(Clone, Debug, Default)]
pub struct Cost(Arc<OnceLock<f64>>);

impl Cost {
    /// The estimate; `None` as long as nothing was measured. A stream that follows some tiles only, or what a host moves, has
    /// none, nor has one that is cut into pieces far shorter than usual.
    pub fn get(&self) -> Option<f64> {
        self.0.get().copied()
    }
}

/// What the thread is told.
enum Order {
    /// Events are wanted up to this stream time.
    Until(i64),
    /// See [`Stream::restart`].
    Restart(Vec<(usize, Key)>),
    /// See [`Stream::set_sensor`].
    Sensor(usize, Box<SensorConfig>),
}

/// Events of several views of a scene.
pub struct Stream {
    /// To the thread.
    wanted: Option<Sender<Order>>,
    /// The latest of them.
    horizon_us: i64,
    pieces: Option<Receiver<Result<Piece, Error>>>,
    reference_luminance: f32,
    cost: Cost,
    abort: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Stream {
    /// Prepares `views` of `scene`; nothing is simulated yet.
    ///
    /// # Errors
    /// A setting or a camera that cannot be used, and a scene that this method cannot show.
    pub fn new(scene: Arc<Scene>, views: Vec<View>, settings: &StreamSettings) -> Result<Self, Error> {
        for index in 0..views.len() {
            settings.of(&views, index).check()?;
        }
        if let Some(limit) = unsupported(&scene) {
            return Err(Error::Unsupported(limit));
        }
        let settings = settings.clone();
        let (wanted, orders) = channel();
        let (send, pieces) = sync_channel(AHEAD);
        let (ready, prepared) = channel();
        let abort = Arc::new(AtomicBool::new(false));
        let aborted = Arc::clone(&abort);
        let cost = Cost::default();
        let measured = cost.clone();
        let work = move || {
            let failed = follow(&scene, &views, &settings, &ready, &orders, &send, &aborted, &measured).err();
            if let Some(error) = failed {
                // Whoever waits for neither has gone.
                let _ = ready.send(Err(error.clone()));
                let _ = send.send(Err(error));
            }
        };
        let thread = std::thread::Builder::new()
            .name("evis-decoupled".into())
            .spawn(work)
            .map_err(|e| Error::Thread(e.to_string()))?;
        let reference_luminance = prepared.recv().unwrap_or_else(|_| Err(Error::Thread(BROKEN.into())))?;
        Ok(Self {
            wanted: Some(wanted),
            horizon_us: 0,
            pieces: Some(pieces),
            reference_luminance,
            cost,
            abort,
            thread: Some(thread),
        })
    }

    /// The `Y_ref` in force.
    pub fn reference_luminance(&self) -> f32 {
        self.reference_luminance
    }

    /// How fast it goes.
    pub fn cost(&self) -> &Cost {
        &self.cost
    }

    /// Requests everything before `until_us` of stream time; the thread simulates no block that begins later.
    pub fn want(&mut self, until_us: i64) {
        if until_us > self.horizon_us {
            self.horizon_us = until_us;
            // A thread that is gone has left an error.
            let _ = self.wanted.as_ref().map(|wanted| wanted.send(Order::Until(until_us)));
        }
    }

    /// Resets the pixels of `views` where the poses that a host has given end: what they see then is their reference, wherever
    /// things were before, and all that is random follows from the key. Everything up to there has been wanted, and taken.
    pub fn restart(&mut self, views: Vec<(usize, Key)>) {
        let _ = self.wanted.as_ref().map(|wanted| wanted.send(Order::Restart(views)));
    }

    /// Gives view `view` another sensor, with which its pixels begin at the next [`Stream::restart`].
    pub fn set_sensor(&mut self, view: usize, sensor: SensorConfig) {
        let order = Order::Sensor(view, Box::new(sensor));
        let _ = self.wanted.as_ref().map(|wanted| wanted.send(order));
    }

    /// The next piece; waits for it. `None` where `stop` is set meanwhile: the piece comes with a later call.
    ///
    /// # Errors
    /// A camera that loses its pose.
    pub fn next(&mut self, stop: &AtomicBool) -> Result<Option<Piece>, Error> {
        let Some(pieces) = &self.pieces else { return Ok(None) };
        while !stop.load(Ordering::Relaxed) {
            match pieces.recv_timeout(LOOK) {
                Ok(piece) => return piece.map(Some),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(Error::Thread(BROKEN.into())),
            }
        }
        Ok(None)
    }
}

const BROKEN: &str = "it stopped with an internal error; please report what it printed";

impl Drop for Stream {
    fn drop(&mut self) {
        self.abort.store(true, Ordering::Relaxed);
        self.wanted = None;
        // The thread must not wait for a reader that is gone.
        self.pieces = None;
        if let Some(thread) = self.thread.take() {
            // A panic there was a broken invariant; it has printed itself.
            let _ = thread.join();
        }
    }
}

/// Which views are followed next, of those whose events are `complete` up to a time before `horizon_us`: the one that is behind all
/// others, and those whose block begins before its own ends (`end_us`), as far as `room` holds their pixels (`counts`).
fn behind(
    (complete, counts): (&[i64], &[f64]),
    end_us: impl Fn(usize) -> i64,
    horizon_us: i64,
    room: f64,
) -> Vec<bool> {
    let mut chosen = vec![false; complete.len()];
    let last = (0..complete.len()).min_by_key(|view| complete[*view]);
    let Some(last) = last.filter(|view| complete[*view] < horizon_us) else { return chosen };
    chosen[last] = true;
    let (until_us, mut room) = (end_us(last).min(horizon_us), room - counts[last]);
    for (view, chosen) in chosen.iter_mut().enumerate() {
        if !*chosen && complete[view] < until_us && counts[view] <= room {
            *chosen = true;
            room -= counts[view];
        }
    }
    chosen
}

/// The thread: follows the view that is behind the others, as far as is wanted.
#[expect(clippy::too_many_arguments, reason = "the ends of its channels")]
fn follow(
    scene: &Scene,
    views: &[View],
    settings: &StreamSettings,
    ready: &Sender<Result<f32, Error>>,
    orders: &Receiver<Order>,
    pieces: &SyncSender<Result<Piece, Error>>,
    abort: &AtomicBool,
    cost: &Cost,
) -> Result<(), Error> {
    let start_us = settings.start_us;
    let most_us: Vec<i64> = (0..views.len()).map(|view| settings.of(views, view).most_us()).collect();
    let holes = Holes::of(scene, settings.size)?;
    let mut worlds: Vec<World> = Vec::with_capacity(views.len());
    for v in views {
        let variant = v.variant.and_then(|i| scene.variants.get(i));
        worlds.push(World::of_variant(scene, variant, v.camera, settings.size, &holes, &worlds)?);
    }
    let shared = Shared::new(scene);
    let mut lightings: Vec<Lighting> = worlds.iter().map(|world| Lighting::new(world, &shared)).collect();
    let mut blocks: Vec<Blocks> = worlds
        .iter()
        .zip(&most_us)
        .map(|(world, most_us)| Blocks::new(world, start_us, *most_us, settings.pose_step_us))
        .collect();
    // The first view as it begins; `None` where nobody asks.
    let mut seen = None;
    if let (None, Some(lighting)) = (settings.reference_luminance, lightings.first_mut()) {
        let first = blocks[0].peek();
        // Where a host moves nodes, what comes after the start is not known yet, and no cell may be kept of it.
        let mut apart = scene.host_poses.is_some().then(|| Lighting::new(&worlds[0], &shared));
        let lighting = apart.as_mut().unwrap_or(lighting);
        seen = Some((picture(&worlds[0], lighting, first, first.start_us)?, first.start_us));
    }
    let measured = || seen.as_ref().map_or(1.0, |(picture, _)| reference_luminance(picture) as f32);
    let reference = settings.reference_luminance.unwrap_or_else(measured);
    let mut views = views.to_vec();
    let new_pixels = |views: &[View], view: usize| {
        let only = settings.only.get(view).map_or(&[][..], Vec::as_slice);
        Pixels::new((&worlds[view], view), &settings.of(views, view), f64::from(reference), only)
    };
    let new = |view: usize| new_pixels(&views, view);
    let mut all_pixels: Vec<Pixels> = (0..views.len()).map(new).collect::<Result<_, _>>()?;
    if let Some((picture, t_us)) = seen.filter(|_| scene.host_poses.is_none()) {
        all_pixels[0].begin(&worlds[0], &picture, t_us);
    }
    let own: Vec<_> = all_pixels.iter().map(|pixels| pixels.own().clone()).collect();
    let mut device = Loaded::open(settings.devices.as_ref(), (scene, &shared), &own)?;
    // Nobody waits for it: then the wanted times end, too.
    let _ = ready.send(Ok(reference));

    let complete_us = |pixels: &Pixels, blocks: &Blocks| {
        pixels.complete_us().unwrap_or(blocks.start_us().floor() as i64 - start_us)
    };
    let pixel_count = |world: &World| f64::from(world.lens.width) * f64::from(world.lens.height);
    let counts: Vec<f64> = worlds.iter().map(pixel_count).collect();
    let whole = scene.host_poses.is_none() && settings.only.is_empty();
    let mut horizon_us = 0;
    loop {
        let complete: Vec<i64> =
            all_pixels.iter().zip(&blocks).map(|(pixels, blocks)| complete_us(pixels, blocks)).collect();
        // The processor follows one view after the other, a device several together.
        let room = if device.is_some() { MOST_PIXELS } else { 0.0 };
        let end_us = |view: usize| blocks[view].peek().end_us.floor() as i64 - start_us;
        let chosen = behind((&complete, &counts), end_us, horizon_us, room);
        let began = Instant::now();
        let mut turns = Vec::new();
        let each = worlds.iter().zip(&mut lightings).zip(&mut all_pixels).zip(&mut blocks);
        for (((((world, lighting), pixels), blocks), is_chosen), view) in each.zip(&chosen).zip(0..) {
            if *is_chosen && let Some(block) = blocks.pop() {
                let jumps_next = blocks.next_jumps();
                turns.push((view, Turn { world, lighting, pixels, block, jumps_next }));
            }
        }
        if turns.is_empty() {
            match orders.recv() {
                Ok(Order::Until(until_us)) => horizon_us = horizon_us.max(until_us),
                Ok(Order::Restart(again)) => {
                    for (view, key) in again {
                        views[view].key = key;
                        all_pixels[view] = new_pixels(&views, view)?;
                        blocks[view].jump();
                    }
                }
                Ok(Order::Sensor(view, sensor)) => views[view].sensor = *sensor,
                Err(_) => return Ok(()),
            }
            continue;
        }
        let (own, turns): (Vec<usize>, Vec<Turn>) = turns.into_iter().unzip();
        // A short block takes more than its part of a usual one.
        let is_usual = |(turn, view): (&Turn, &usize)| {
            2.0 * turn.block.length_us() >= turn.world.block_us(most_us[*view]) as f64
        };
        let usual = turns.iter().zip(&own).all(is_usual);
        let work: f64 = turns.iter().map(|turn| pixel_count(turn.world) * turn.block.length_us()).sum();
        let Some(found) = pixels::follow(turns, device.as_mut(), abort)? else { return Ok(()) };
        if whole && usual {
            // Only the first is kept.
            let _ = cost.0.set(began.elapsed().as_secs_f64() * 1e6 * counts.iter().sum::<f64>() / work);
        }
        for (view, events) in own.into_iter().zip(found) {
            let complete_us = complete_us(&all_pixels[view], &blocks[view]);
            let report = all_pixels[view].report(&lightings[view]);
            if pieces.send(Ok(Piece { view, complete_us, events, report })).is_err() {
                return Ok(());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_behind_go_on_together_as_far_as_there_is_room() {
        let next = |complete: &[i64], horizon_us, room| {
            let chosen = behind((complete, &[10.0; 4]), |view| complete[view] + 30, horizon_us, room);
            (0..4).filter(|view| chosen[*view]).collect::<Vec<_>>()
        };
        assert_eq!(next(&[50, 20, 40, 60], 1000, 100.0), [1, 2]);
        assert_eq!(next(&[50, 20, 40, 49], 1000, 100.0), [1, 2, 3]);
        assert_eq!(next(&[20, 20, 20, 20], 1000, 30.0), [0, 1, 2]);
        assert_eq!(next(&[20, 20, 20, 20], 1000, 0.0), [0], "one after the other");
        assert_eq!(next(&[50, 20, 40, 60], 40, 100.0), [1], "beyond what is wanted");
        assert_eq!(next(&[50, 40, 40, 60], 40, 100.0), [0_usize; 0]);
    }
}
