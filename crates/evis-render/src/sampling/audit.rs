//! Audits of what is skipped: a hashed few of the tiles that a block leaves out, or samples less often, are rendered at one of
//! the instants at which they are not, and compared with the samples around it on the device. For a tenth of them all three
//! are rendered again with samples at other places, which see what moves between those of the stream.
//!
//! Which ones are audited is a function of absolute block, view and tile. The work stays below a fixed share of the block's
//! own. No event depends on it.

use evis_core::random::mix;
use serde::Serialize;

use crate::cpu::audit::unpack;
use crate::world::tiles::TILE;

/// The largest share of a block's own work that its audits may take.
const MOST_WORK: f64 = 0.02;

/// Of so many audits one is rendered with other samples.
const OTHERS_ONE_IN: u64 = 10;

/// Audits of a submission, at most: each takes three layers of a texture, of which every device has 256.
pub const MOST_AUDITS: usize = 64;

/// An audited tile.
#[derive(Clone, Debug)]
pub struct AuditedTile {
    /// Index of the view in the engine.
    pub view: usize,
    /// Upper left pixel.
    pub corner: [u32; 2],
    /// Stream time of the instant, in microseconds.
    pub t_us: i64,
    /// The node of the nearest object that may be seen in the tile.
    pub node: Option<usize>,
    /// Whether the block leaves the tile out.
    pub skipped: bool,
    /// Whether samples at other places are compared.
    pub other_samples: bool,
}

/// A tile that is audited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chosen {
    /// Its index.
    pub tile: usize,
    /// The instant within its block, from 1 on.
    pub number: u32,
    /// Whether it is rendered with samples at other places, at the instants around this one too.
    pub other_samples: bool,
}

/// The audits of a submission, and where their results come.
pub struct AuditRun {
    /// In order of their slots.
    pub entries: Vec<AuditedTile>,
    /// A word per entry.
    pub staging: wgpu::Buffer,
}

/// Light that changed in a tile between two of its samples.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Environment.
    pub environment: usize,
    /// Name of the camera.
    pub camera: String,
    /// Pixel.
    pub pixel: [u32; 2],
    /// Stream time in microseconds.
    pub t_us: i64,
    /// Name of the node of the nearest object that may be seen there.
    pub object: Option<String>,
    /// Whether the tile was left out of the block, or sampled less often than at every instant.
    pub skipped: bool,
    /// Whether it was seen by samples at other places than those of the stream.
    pub other_samples: bool,
    /// By how much log luminance lies beyond the samples before and after.
    pub change: f32,
}

impl Finding {
    /// For the user.
    pub fn warning(&self) -> String {
        let Self { environment, camera, pixel: [x, y], t_us, change, .. } = self;
        let seen = if self.other_samples { ", as samples between its own see it," } else { "" };
        let object = self.object.as_ref().map_or("nothing".into(), |name| format!("'{name}'"));
        let how = if self.skipped { "was skipped" } else { "was sampled less often" };
        format!(
            "camera '{camera}' of environment {environment}, pixel ({x}, {y}) at {t_us} us: the tile {how}, but its log \
             luminance{seen} changed by {change:.3} ({object} is seen there); sample more often with a smaller `adaptive_px` or a higher `quality`, \
             and report it if the tile was skipped"
        )
    }
}

impl AuditRun {
    /// What came back: the change of each entry, in log luminance, and the pixel of the picture.
    pub fn changes<'a>(&'a self, words: &'a [u32]) -> impl Iterator<Item = (&'a AuditedTile, f32, [u32; 2])> {
        self.entries.iter().zip(words).map(|(entry, word)| {
            let (change, at) = unpack(*word);
            (entry, change, [0, 1].map(|i| entry.corner[i] + at[i]))
        })
    }
}

/// A word from numbers.
fn hash(numbers: [u64; 4]) -> u64 {
    numbers
        .into_iter()
        .fold(0x9e37_79b9_7f4a_7c15, |state, number| mix(state ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
}

/// The tiles of a view that are audited in absolute block `block`: the `share` of the `audited` ones, one in ten with other
/// samples. `own_work` is what the block takes without them. `pick` gives for a tile and a hashed number the instant, if there
/// is one, and what the tile takes there.
pub fn choose(
    share: f64,
    (environment, camera): (usize, usize),
    block: i64,
    audited: &[bool],
    own_work: f64,
    mut pick: impl FnMut(usize, u64) -> Option<(u32, f64)>,
) -> Vec<Chosen> {
    let identity = (environment as u64) << 32 | camera as u64;
    let most = share.clamp(0.0, 1.0) * 2f64.powi(64);
    let mut spent = 0.0;
    let mut chosen = Vec::new();
    for (tile, _) in audited.iter().enumerate().filter(|(_, audited)| **audited) {
        let word = hash([identity, block as u64, tile as u64, 0]);
        if word as f64 >= most {
            continue;
        }
        let Some((number, cost)) = pick(tile, hash([identity, block as u64, tile as u64, 1])) else {
            continue;
        };
        let other_samples = hash([identity, block as u64, tile as u64, 2]).is_multiple_of(OTHERS_ONE_IN);
        let cost = if other_samples { 3.0 * cost } else { cost };
        if spent + cost <= MOST_WORK * own_work {
            spent += cost;
            chosen.push(Chosen { tile, number, other_samples });
        }
    }
    chosen
}

/// The numbers of the samples around instant `number` of a tile that is sampled every `2^rate` instants of a block of `length`,
/// or at its end where that is more; 0 is the end of the block before.
pub const fn around(rate: u8, length: u32, number: u32) -> [u32; 2] {
    let every = if rate as u32 >= length.trailing_zeros() { length } else { 1 << rate };
    let before = number / every * every;
    [before, before + every]
}

/// Upper left pixel of tile `index` in a picture of `columns` tiles.
pub const fn corner(index: usize, columns: u32) -> [u32; 2] {
    [index as u32 % columns * TILE, index as u32 / columns * TILE]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn audits_are_a_share_of_the_tiles_and_of_the_work() {
        let all = vec![true; 10_000];
        let one = |_: usize, word: u64| Some(((word % 16) as u32, 1.0));
        let free = |share| choose(share, (0, 0), 3, &all, f64::INFINITY, one);
        let count = free(0.05).len();
        assert!((400..600).contains(&count), "{count}");
        assert_eq!((free(0.0).len(), free(1.0).len()), (0, 10_000));
        assert!((0..16).all(|number| free(1.0).iter().any(|chosen| chosen.number == number)));
        let others = free(1.0).iter().filter(|chosen| chosen.other_samples).count();
        assert!((900..1100).contains(&others), "{others}");
        let paid = choose(1.0, (0, 0), 3, &all, 1000.0, one);
        let cost: usize = paid.iter().map(|chosen| if chosen.other_samples { 3 } else { 1 }).sum();
        assert!((18..=20).contains(&cost), "2 % of the work: {cost}");
        assert!(choose(1.0, (0, 0), 3, &all, 1000.0, |_, _| None).is_empty(), "no instant between two");
        assert_ne!(free(0.05), choose(0.05, (0, 0), 4, &all, f64::INFINITY, one));
        assert_ne!(free(0.05), choose(0.05, (1, 0), 3, &all, f64::INFINITY, one));
        let half: Vec<bool> = (0..10_000).map(|tile| tile % 2 == 0).collect();
        assert!(choose(0.5, (0, 0), 3, &half, f64::INFINITY, one).iter().all(|chosen| chosen.tile % 2 == 0));
    }

    #[test]
    fn the_samples_around_an_instant_are_those_of_its_tile() {
        for (rate, number, samples) in
            [(1, 1, [0, 2]), (1, 15, [14, 16]), (2, 5, [4, 8]), (4, 7, [0, 16]), (u8::MAX, 7, [0, 16])]
        {
            assert_eq!(around(rate, 16, number), samples, "{rate} {number}");
        }
    }
}
