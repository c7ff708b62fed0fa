//! How often noise of the photoreceptor fires: what `SensorConfig::photoreceptor_noise_for` was fitted to.
//!
//! `cargo bench --profile release --workspace --locked --bench receptor` prints Markdown: events per second and cutoff
//! under constant light, by the threshold in units of the root mean square, at two cutoffs whose knots are as far apart
//! as they can be for the time constant, and as near.
#![allow(clippy::unwrap_used, reason = "a benchmark may panic")]

use evis_core::sensor::{NoiseLaw, Photoreceptor};
use evis_core::{EmulatorConfig, EventEmulator, Frames, SensorConfig};

fn main() {
    println!(
        "| poles | C / rms | R / f, knots far apart | R / f, knots near | v2e's formula asks for C / rms | fitted |"
    );
    println!("|---|---|---|---|---|---|");
    for order in [1, 2] {
        for ratio in [1.5_f32, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0] {
            let (mut rates, mut sensor) = (Vec::new(), SensorConfig::default());
            for tau_us in [1030.0, 2040.0] {
                let cutoff_hz = 1e6 / (std::f32::consts::TAU * tau_us);
                let noise = sensor.threshold_on / ratio;
                sensor.photoreceptor = Photoreceptor { cutoff_hz, order, noise, ..Photoreceptor::default() };
                let (width, height) = (173, 130);
                let config = EmulatorConfig { width, height, sensor: sensor.clone(), ..Default::default() };
                let mut emulator = EventEmulator::new(config).unwrap();
                let frame = vec![0.5; (width * height) as usize];
                // The first tenth of a second forgets how it began.
                let (step_us, warm, mut frames, mut events) = (5000, 20, 0, 0_u64);
                while events < 20_000 && frames < 2000 || frames < 50 {
                    let lists = emulator.push(&Frames::linear(&frame), frames * step_us).unwrap();
                    events += if frames > warm { lists[0].len() as u64 } else { 0 };
                    frames += 1;
                }
                let seconds = ((frames - 1 - warm) * step_us) as f64 * 1e-6;
                rates.push(events as f64 / (f64::from(width * height) * seconds * f64::from(cutoff_hz)));
            }
            let mean = (rates[0] * rates[1]).sqrt() * f64::from(sensor.photoreceptor.cutoff_hz);
            let asked = |law| {
                sensor.photoreceptor_noise_for(mean, law).map_or(f32::NAN, |rms| sensor.threshold_on / rms)
            };
            println!(
                "| {order} | {ratio} | {:.3e} | {:.3e} | {:.2} | {:.3} |",
                rates[0],
                rates[1],
                asked(NoiseLaw::V2e),
                asked(NoiseLaw::Measured)
            );
        }
    }
}
