//! EVT 3.0: 16-bit words, of which time, row and column each have their own.

use std::hint::select_unpredictable;

use evis_core::{Event, Polarity};

use crate::packet::Trigger;

const ADDR_Y: u16 = 0x0;
const ADDR_X: u16 = 0x2;
const VECT_BASE_X: u16 = 0x3;
const VECT_12: u16 = 0x4;
const VECT_8: u16 = 0x5;
const TIME_LOW: u16 = 0x6;
const CONTINUED_4: u16 = 0x7;
const TIME_HIGH: u16 = 0x8;
const EXT_TRIGGER: u16 = 0xA;
const OTHERS: u16 = 0xE;
const CONTINUED_12: u16 = 0xF;

/// Microseconds after which the 24-bit time starts again.
const WRAP_US: i64 = 1 << 24;
/// Latest time: silence takes a word per 4096 us, and these 19 hours are 32 MiB of it.
pub(super) const LATEST_US: i64 = (1 << 36) - 1;
/// Events of one row and time that are worth a vector: four words hold up to 32.
const VECTOR_EVENTS: usize = 4;
/// Pixels that a vector covers.
const VECTOR_WIDTH: u16 = 32;
/// Most events that a word holds.
const VECTOR_BITS: usize = 12;
/// Words that are decoded before their events join the list.
const PART: usize = 64;
/// Words of an encoder's buffer.
const BUFFER: usize = 1024;

/// What the words so far mean for the next one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Decoder {
    width: u16,
    height: u16,
    /// Where the place of each type of word ends: the types without one, but for TIME_LOW, take none.
    ends: [u16; 16],
    /// Start of the current run of 24-bit times.
    epoch_us: i64,
    /// The last TIME_HIGH, in units of 4096 us; before the first one there is no time.
    high: Option<u16>,
    t: i64,
    y: u16,
    base_x: u16,
    vector_polarity: Polarity,
    /// Near which the next TIME_HIGH lies, where that is known from elsewhere.
    expected_us: Option<i64>,
}

impl Decoder {
    pub fn new(width: u16, height: u16) -> Self {
        let mut ends = [0; 16];
        (ends[usize::from(ADDR_X)], ends[usize::from(ADDR_Y)]) = (width, height);
        ends[usize::from(TIME_LOW)] = u16::MAX;
        Self {
            width,
            height,
            ends,
            epoch_us: 0,
            high: None,
            t: 0,
            y: 0,
            base_x: 0,
            vector_polarity: Polarity::Off,
            expected_us: None,
        }
    }

    /// Takes the next TIME_HIGH for the one nearest to `t_us`, however often the time has started again.
    pub const fn expect(&mut self, t_us: i64) {
        self.expected_us = Some(t_us);
    }

    /// The latest time that an event so far may have.
    pub const fn now_us(&self) -> i64 {
        self.t
    }

    /// Decodes whole words; the error names the word, and what is wrong with it.
    pub fn decode(
        &mut self,
        bytes: &[u8],
        events: &mut Vec<Event>,
        triggers: &mut Vec<Trigger>,
    ) -> Result<(), (usize, String)> {
        let words = bytes.as_chunks().0;
        // Most events take two or three words; what vectors add grows the list.
        events.reserve(words.len());
        let mut found = [Event::default(); PART * VECTOR_BITS];
        for (index, part) in words.chunks(PART).enumerate() {
            let mut count = 0;
            let decoded = self.part(part, &mut found, &mut count, triggers);
            events.extend_from_slice(found.get(..count).unwrap_or_default());
            decoded.map_err(|(word, what)| (index * PART + word, what))?;
        }
        Ok(())
    }

    /// Decodes up to [`PART`] words into the start of `found`, and counts what it holds.
    fn part(
        &mut self,
        words: &[[u8; 2]],
        found: &mut [Event],
        count: &mut usize,
        triggers: &mut Vec<Trigger>,
    ) -> Result<(), (usize, String)> {
        let mut at = 0;
        while let Some(word) = words.get(at).map(|word| u16::from_le_bytes(*word)) {
            let low = word & 0x0FFF;
            if matches!(word >> 12, ADDR_X | ADDR_Y | TIME_LOW) {
                let taken = self.scattered(words.get(at..).unwrap_or_default(), found, count);
                at += taken;
                if taken > 0 {
                    continue;
                }
            }
            match word >> 12 {
                VECT_BASE_X => {
                    self.base_x = word & 0x07FF;
                    self.vector_polarity = polarity(word);
                }
                VECT_12 => self.vector(at, low, 12, found, count)?,
                VECT_8 => self.vector(at, low & 0xFF, 8, found, count)?,
                TIME_HIGH => self.time_high(low),
                EXT_TRIGGER => {
                    if self.high.is_some() {
                        triggers.push(Trigger::new(self.t, (low >> 8) as i16, low & 1 == 1));
                    }
                }
                CONTINUED_4 | OTHERS | CONTINUED_12 => {}
                ADDR_X => return Err(self.outside(at, word & 0x07FF)),
                ADDR_Y => {
                    let (y, height) = (word & 0x07FF, self.height);
                    return Err((at, format!("row {y} lies outside of {height} rows")));
                }
                reserved => return Err((at, format!("a word is of the reserved type {reserved}"))),
            }
            at += 1;
        }
        Ok(())
    }

    /// Decodes times, rows and columns up to the first word that is another or lies outside of the sensor;
    /// returns their number.
    ///
    /// In a stream of scattered pixels nothing tells which of the three comes next, and a branch that the
    /// processor guesses wrong takes longer than three words. So they share one way without a branch: each
    /// word writes an event, and only a column keeps it.
    fn scattered(&mut self, words: &[[u8; 2]], found: &mut [Event], count: &mut usize) -> usize {
        let (mut t, mut y, mut n) = (self.t, self.y, *count);
        let timed = self.high.is_some();
        let mut taken = 0;
        for word in words {
            let word = u16::from_le_bytes(*word);
            let kind = word >> 12;
            let (is_x, is_y, is_time) = (kind == ADDR_X, kind == ADDR_Y, kind == TIME_LOW);
            // Bit 11 of a row tells which camera of two; both see the same pixels.
            let place = word & 0x07FF;
            let Some(event) = found.get_mut(n) else { break };
            if place >= self.ends[usize::from(kind)] {
                break;
            }
            y = select_unpredictable(is_y, place, y);
            t = select_unpredictable(is_time, (t & !0x0FFF) | i64::from(word & 0x0FFF), t);
            *event = Event::new(t, place, y, polarity(word));
            n += usize::from(is_x & timed);
            taken += 1;
        }
        (self.t, self.y, *count) = (t, y, n);
        taken
    }

    fn time_high(&mut self, high: u16) {
        if let Some(before) = self.high
            // Time that goes back by a little is a fault of the sensor; by a lot, a wrap.
            && before > high
            && before - high > 2048
        {
            self.epoch_us += WRAP_US;
        }
        if let Some(t_us) = self.expected_us.take() {
            let offset = t_us - (i64::from(high) << 12) + WRAP_US / 2;
            self.epoch_us = offset.div_euclid(WRAP_US).max(0) * WRAP_US;
        }
        // The low part starts again: TIME_LOW follows, and until then the earliest time is the safest.
        self.t = self.epoch_us + (i64::from(high) << 12);
        self.high = Some(high);
    }

    fn vector(
        &mut self,
        index: usize,
        mut mask: u16,
        pixels: u16,
        found: &mut [Event],
        count: &mut usize,
    ) -> Result<(), (usize, String)> {
        while mask != 0 {
            let x = self.base_x.wrapping_add(mask.trailing_zeros() as u16);
            if x >= self.width {
                return Err(self.outside(index, x));
            }
            if self.high.is_some()
                && let Some(event) = found.get_mut(*count)
            {
                *event = Event::new(self.t, x, self.y, self.vector_polarity);
                *count += 1;
            }
            mask &= mask.wrapping_sub(1);
        }
        self.base_x = self.base_x.wrapping_add(pixels);
        Ok(())
    }

    #[cold]
    fn outside(&self, index: usize, x: u16) -> (usize, String) {
        (index, format!("column {x} lies outside of {} columns", self.width))
    }
}

/// Bit 11 of a word with a column.
const fn polarity(word: u16) -> Polarity {
    if word & 0x0800 == 0 { Polarity::Off } else { Polarity::On }
}

/// What the words so far said.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Encoder {
    width: u16,
    /// The time that was sent last; none before the first.
    high: Option<i64>,
    t: i64,
    y: Option<u16>,
}

impl Encoder {
    pub const fn new(width: u16) -> Self {
        Self { width, high: None, t: -1, y: None }
    }

    /// Begins at `t_us` without words for the time before: what reads it knows from elsewhere.
    pub const fn starting_at(width: u16, t_us: i64) -> Self {
        Self { width, high: Some((t_us >> 12) - 1), t: -1, y: None }
    }

    /// Sends time `t`: TIME_HIGH where it changed, then TIME_LOW.
    fn time(&mut self, t: i64, words: &mut Vec<u16>) {
        let high = t >> 12;
        if self.high != Some(high) {
            // Readers count wraps themselves, from the start of the file, and most of them see a wrap only
            // where each value comes, as cameras send them.
            let first = self.high.map_or(0, |sent| sent + 1);
            words.extend((first..=high).map(|high| word(TIME_HIGH, high as u16)));
            self.high = Some(high);
            // Every reader accepts a row after a time; some forget it at TIME_HIGH.
            self.y = None;
        }
        words.push(word(TIME_LOW, t as u16));
        self.t = t;
    }

    pub fn trigger(&mut self, trigger: &Trigger, words: &mut Vec<u16>) {
        if trigger.t != self.t {
            self.time(trigger.t, words);
        }
        words.push(word(EXT_TRIGGER, (trigger.id as u16) << 8 | trigger.p as u16));
    }

    /// Encodes events that were checked.
    ///
    /// Whether the next event needs a time and a row cannot be told from those before it, and a branch that
    /// the processor guesses wrong takes longer than the words. So all three are written, each over the one
    /// before it where that was not needed.
    pub fn events(&mut self, events: &[Event], words: &mut Vec<u16>) {
        let mut rest = events;
        let mut buffer = [0; BUFFER];
        let mut used = 0;
        while let Some((event, later)) = rest.split_first() {
            let high = Some(event.t >> 12);
            // The fourth event tells in most cases that there is no vector.
            let fourth = rest.get(VECTOR_EVENTS - 1);
            let vector = fourth.is_some_and(|fourth| (fourth.t == event.t) & (fourth.y == event.y));
            let room = buffer.get_mut(used..).and_then(<[u16]>::first_chunk_mut::<3>);
            if let Some(slots) = room
                && high == self.high
                && !vector
            {
                let time = usize::from(event.t != self.t);
                let row = usize::from(self.y != Some(event.y));
                slots[0] = word(TIME_LOW, event.t as u16);
                slots[time] = word(ADDR_Y, event.y);
                slots[time + row] = word(ADDR_X, event.x | (event.p as u16) << 11);
                used += time + row + 1;
                (self.t, self.y) = (event.t, Some(event.y));
                rest = later;
                continue;
            }
            words.extend_from_slice(buffer.get(..used).unwrap_or_default());
            used = 0;
            if event.t != self.t {
                self.time(event.t, words);
            }
            if self.y != Some(event.y) {
                words.push(word(ADDR_Y, event.y));
                self.y = Some(event.y);
            }
            if vector && let Some(taken) = self.vector(rest, words) {
                rest = rest.get(taken..).unwrap_or_default();
                continue;
            }
            words.push(word(ADDR_X, event.x | (event.p as u16) << 11));
            rest = later;
        }
        words.extend_from_slice(buffer.get(..used).unwrap_or_default());
    }

    /// Sends the events at the start of `rest` that fit a vector, if they are enough; returns their number.
    fn vector(&self, rest: &[Event], words: &mut Vec<u16>) -> Option<usize> {
        let first = rest.first()?;
        // A vector covers 32 pixels, all within the row.
        let base = first.x.min(self.width.checked_sub(VECTOR_WIDTH)?);
        let (mut mask, mut taken, mut next) = (0_u32, 0, base);
        for e in rest.iter().take(VECTOR_WIDTH as usize) {
            // Pixels come back in rising order, so that is how they must go.
            let fits = e.t == first.t && e.y == first.y && e.p == first.p && e.x >= next;
            let bit = e.x.wrapping_sub(base);
            if !fits || bit >= VECTOR_WIDTH {
                break;
            }
            mask |= 1 << bit;
            next = e.x + 1;
            taken += 1;
        }
        if taken < VECTOR_EVENTS {
            return None;
        }
        words.push(word(VECT_BASE_X, base | (first.p as u16) << 11));
        words.push(word(VECT_12, mask as u16));
        words.push(word(VECT_12, (mask >> 12) as u16));
        words.push(word(VECT_8, (mask >> 24) as u16));
        Some(taken)
    }
}

/// A word of this type, as it lies in the file.
const fn word(kind: u16, value: u16) -> u16 {
    (kind << 12 | value & 0x0FFF).to_le()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words_of(events: &[Event], width: u16) -> Vec<u16> {
        let mut words = Vec::new();
        Encoder::new(width).events(events, &mut words);
        words.into_iter().map(u16::from_le).collect()
    }

    fn decoded(words: &[u16], size: (u16, u16)) -> Result<Vec<Event>, (usize, String)> {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let (mut events, mut triggers) = (Vec::new(), Vec::new());
        Decoder::new(size.0, size.1).decode(&bytes, &mut events, &mut triggers)?;
        Ok(events)
    }

    fn row(t: i64, y: u16, xs: &[u16], polarity: Polarity) -> Vec<Event> {
        xs.iter().map(|x| Event::new(t, *x, y, polarity)).collect()
    }

    #[test]
    fn vectors_are_whole_triples_inside_the_row() {
        let events = row(5, 7, &[3, 4, 9, 34], Polarity::On);
        let words = words_of(&events, 40);
        assert_eq!(words, [0x8000, 0x6005, 0x0007, 0x3803, 0x4043, 0x4000, 0x5080]);
        assert_eq!(decoded(&words, (40, 8)).unwrap(), events);
        // At the right edge the base moves left, so that all 32 pixels lie in the row.
        let events = row(5, 7, &[36, 37, 38, 39], Polarity::Off);
        let words = words_of(&events, 40);
        assert_eq!(words, [0x8000, 0x6005, 0x0007, 0x3008, 0x4000, 0x4000, 0x50F0]);
        assert_eq!(decoded(&words, (40, 8)).unwrap(), events);
        // Not where order, polarity, distance or the sensor's width forbid.
        for (xs, width) in
            [(&[9, 4, 3, 2][..], 40), (&[3, 4, 5, 35], 40), (&[3, 3, 4, 5], 40), (&[1, 2, 3, 4], 31)]
        {
            let events = row(5, 7, xs, Polarity::On);
            let words = words_of(&events, width);
            assert!(words.iter().all(|word| word >> 12 != VECT_BASE_X), "{xs:?}: {words:04x?}");
            assert_eq!(decoded(&words, (width, 8)).unwrap(), events);
        }
    }

    #[test]
    fn silence_is_bridged_by_every_time_that_passes() {
        let events = [5, 17_000_000, 100_000_000, LATEST_US].map(|t| Event::new(t, 1, 2, Polarity::On));
        let words = words_of(&events, 8);
        let highs: Vec<i64> = words
            .iter()
            .filter(|word| *word >> 12 == TIME_HIGH)
            .map(|word| i64::from(word & 0x0FFF))
            .collect();
        assert!(highs.windows(2).all(|pair| (pair[1] - pair[0]).rem_euclid(4096) == 1));
        assert!(
            words
                .windows(2)
                .all(|pair| pair[0] >> 12 != TIME_HIGH || matches!(pair[1] >> 12, TIME_HIGH | TIME_LOW))
        );
        assert_eq!(decoded(&words, (8, 8)).unwrap(), events);
        // Canary: without the steps, times are wrong.
        let jumps: Vec<u16> = words
            .iter()
            .enumerate()
            .filter(|(k, word)| *word >> 12 != TIME_HIGH || words[k + 1] >> 12 != TIME_HIGH)
            .map(|(_, word)| *word)
            .collect();
        assert_ne!(decoded(&jumps, (8, 8)).unwrap(), events);
    }

    #[test]
    fn words_that_cannot_be_are_named() {
        for (words, index, what) in [
            (vec![0x8000, 0x6000, 0x0002, 0x2008], 3, "column 8"),
            (vec![0x8000, 0x6000, 0x0008], 2, "row 8"),
            (vec![0x8000, 0x9000], 1, "reserved type 9"),
            (vec![0x8000, 0x6000, 0x0002, 0x3004, 0x4010], 4, "column 8"),
        ] {
            let (at, told) = decoded(&words, (8, 8)).unwrap_err();
            assert!(at == index && told.contains(what), "{at} {told}");
        }
        // What comes before the first time has none.
        assert_eq!(decoded(&[0x0002, 0x2001, 0x8000, 0x6003, 0x2001], (8, 8)).unwrap().len(), 1);
    }
}
