//! EVT 2.0: 32-bit words, an event each, with the low bits of its time.

use evis_core::{Event, Polarity};

use crate::packet::Trigger;

const CD_OFF: u32 = 0x0;
const CD_ON: u32 = 0x1;
const TIME_HIGH: u32 = 0x8;
const EXT_TRIGGER: u32 = 0xA;
const OTHERS: u32 = 0xE;
const CONTINUED: u32 = 0xF;

/// Latest time: 34 bits. Readers of other programs do not count wraps.
pub(super) const LATEST_US: i64 = (1 << 34) - 1;

/// What the words so far mean for the next one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Decoder {
    width: u32,
    height: u32,
    epoch_us: i64,
    high: Option<u32>,
    /// Time of the last TIME_HIGH.
    base_us: i64,
}

impl Decoder {
    pub fn new(width: u16, height: u16) -> Self {
        Self { width: width.into(), height: height.into(), epoch_us: 0, high: None, base_us: 0 }
    }

    /// The latest time that an event so far may have.
    pub const fn now_us(&self) -> i64 {
        self.base_us + 63
    }

    /// Decodes whole words; the error names the word, and what is wrong with it.
    pub fn decode(
        &mut self,
        bytes: &[u8],
        events: &mut Vec<Event>,
        triggers: &mut Vec<Trigger>,
    ) -> Result<(), (usize, String)> {
        let words = bytes.as_chunks().0;
        events.reserve(words.len());
        for (index, word) in words.iter().enumerate() {
            let word = u32::from_le_bytes(*word);
            let t = self.base_us | i64::from(word >> 22 & 0x3F);
            match word >> 28 {
                kind @ (CD_OFF | CD_ON) => {
                    let (x, y) = (word >> 11 & 0x07FF, word & 0x07FF);
                    if x >= self.width || y >= self.height {
                        let Self { width, height, .. } = self;
                        return Err((index, format!("x {x}, y {y} lies outside of {width}x{height}")));
                    }
                    if self.high.is_some() {
                        let polarity = if kind == CD_ON { Polarity::On } else { Polarity::Off };
                        events.push(Event::new(t, x as u16, y as u16, polarity));
                    }
                }
                TIME_HIGH => self.time_high(word & 0x0FFF_FFFF),
                EXT_TRIGGER => {
                    if self.high.is_some() {
                        triggers.push(Trigger::new(t, (word >> 8 & 0x1F) as i16, word & 1 == 1));
                    }
                }
                OTHERS | CONTINUED => {}
                reserved => return Err((index, format!("a word is of the reserved type {reserved}"))),
            }
        }
        Ok(())
    }

    fn time_high(&mut self, high: u32) {
        if let Some(before) = self.high
            && before > high
            && before - high > 1 << 27
        {
            self.epoch_us += 1 << 34;
        }
        self.base_us = self.epoch_us + (i64::from(high) << 6);
        self.high = Some(high);
    }
}

/// What the words so far said.
#[derive(Clone, Copy, Debug)]
pub(super) struct Encoder {
    high: i64,
}

impl Encoder {
    pub const fn new() -> Self {
        Self { high: -1 }
    }

    fn time(&mut self, t: i64, words: &mut Vec<u32>) {
        let high = t >> 6;
        if high != self.high {
            words.push((TIME_HIGH << 28 | high as u32 & 0x0FFF_FFFF).to_le());
            self.high = high;
        }
    }

    pub fn trigger(&mut self, trigger: &Trigger, words: &mut Vec<u32>) {
        self.time(trigger.t, words);
        let (t, id) = (trigger.t as u32 & 0x3F, trigger.id as u32);
        words.push((EXT_TRIGGER << 28 | t << 22 | id << 8 | trigger.p as u32).to_le());
    }

    /// Encodes events that were checked.
    pub fn events(&mut self, events: &[Event], words: &mut Vec<u32>) {
        for e in events {
            self.time(e.t, words);
            let kind = e.p as u32;
            let word = kind << 28 | (e.t as u32 & 0x3F) << 22 | u32::from(e.x) << 11 | u32::from(e.y);
            words.push(word.to_le());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_those_of_the_layout() {
        let events = [Event::new(64 + 5, 3, 7, Polarity::On), Event::new(64 + 6, 1279, 719, Polarity::Off)];
        let mut words = Vec::new();
        let mut encoder = Encoder::new();
        encoder.events(&events, &mut words);
        encoder.trigger(&Trigger::new(64 + 7, 17, true), &mut words);
        let words: Vec<u32> = words.into_iter().map(u32::from_le).collect();
        assert_eq!(
            words,
            [
                0x8000_0001,
                1 << 28 | 5 << 22 | 3 << 11 | 7,
                6 << 22 | 1279 << 11 | 719,
                0xA << 28 | 7 << 22 | 17 << 8 | 1
            ]
        );
    }

    #[test]
    fn words_that_cannot_be_are_named() {
        let decode = |words: &[u32]| {
            let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
            let (mut events, mut triggers) = (Vec::new(), Vec::new());
            Decoder::new(8, 8).decode(&bytes, &mut events, &mut triggers).map(|()| events.len())
        };
        assert_eq!(decode(&[0x8000_0000, 8 << 11]).unwrap_err().0, 1);
        assert_eq!(decode(&[0x8000_0000, 0, 8]).unwrap_err().0, 2);
        assert!(decode(&[0x5000_0000]).unwrap_err().1.contains("reserved type 5"));
        // What comes before the first time has none; a wrap of 34 bits is counted.
        assert_eq!(decode(&[0, 0x8000_0000, 0]), Ok(1));
        let mut decoder = Decoder::new(8, 8);
        decoder.time_high(0x0FFF_FFFF);
        decoder.time_high(0);
        assert_eq!(decoder.base_us, 1 << 34);
    }
}
