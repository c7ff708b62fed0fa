//! An event leaves its pixel.

use super::pixel::Pixel;
use crate::emulator::order::Record;
use crate::emulator::readout::delay_us;
use crate::event::{Cause, Polarity};

impl Pixel<'_> {
    /// Writes an event.
    #[inline]
    pub(super) fn emit(&mut self, t: f64, polarity: Polarity, cause: Cause) {
        let offset = (t as u32).clamp(1, self.us.max(1));
        let (x, y) = self.place;
        let left = offset + self.light_delay(t);
        let t_us = self.start_us + i64::from(left);
        let delay = delay_us(&self.plan.sensor.readout, self.key, self.pixel, t_us);
        self.records.push(Record::new(left + delay, x, y, polarity));
        if let Some(causes) = &mut self.causes {
            causes.push(cause);
        }
        if let Some(fired) = self.chain.fired.get_mut(self.index) {
            *fired = (self.start_us + i64::from(offset) - self.chain.base_us) as i32;
        }
        if let Some(last) = self.chain.polarity.get_mut(self.index) {
            *last = u8::from(polarity == Polarity::On);
        }
    }

    /// Delay of an event at `t` within the pixel, whole microseconds: the part of the latency that light has.
    #[inline]
    pub(super) fn light_delay(&self, t: f64) -> u32 {
        let latency = self.plan.sensor.readout.latency_light_us;
        if latency == 0.0 {
            return 0;
        }
        let light = self.light_at(t) as f32 + self.plan.sensor.photoreceptor.dark_light;
        (latency / light.max(0.01)) as u32
    }
}
