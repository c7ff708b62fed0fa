//! Writes a recording with known content, for the tests outside Rust and for measuring.
//!
//! `write_recording OUT [events=N] [rate=PER_SECOND] [packet=N] [cameras=N] [labels=0|1] [wide=0|1]
//! [paced=0|1] [finish=0|1] [width=N] [height=N] [label_every=MICROS]`, or `write_recording OUT repair=1`
//!
//! Event i of every camera: h = mix(i), x = h mod width, y = (h / width) mod height, p = (h / 7) mod 2, t = floor(i * 10^6 / rate). With `paced`, wall-clock time
//! follows t, and after each packet a line tells how many events have been given.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use evis_core::format::hdf5::{RecordingHeader, RecordingWriter};
use evis_core::{CameraInfo, Event, LabelData, LabelFrame, LabelKind, Polarity, PoseSample};

/// 24 bits that do not compress: (m ^ (m >> 29)) * 0xBF58476D1CE4E5B9 >> 40, m = i * 0x9E3779B97F4A7C15.
fn mix(i: u64) -> u64 {
    let m = i.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (m ^ (m >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 40
}

fn event(i: u64, rate: u64, width: u32, height: u32) -> Event {
    let h = mix(i);
    let polarity = if (h / 7) % 2 == 1 { Polarity::On } else { Polarity::Off };
    let t = (u128::from(i) * 1_000_000 / u128::from(rate)) as i64;
    Event::new(t, (h % u64::from(width)) as u16, (h / u64::from(width) % u64::from(height)) as u16, polarity)
}

fn main() -> ExitCode {
    match write() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn write() -> Result<(), Box<dyn std::error::Error>> {
    let mut out = None;
    let (mut events, mut rate, mut packet, mut cameras) = (1_000_000_u64, 1_000_000_u64, 10_000_u64, 1_usize);
    let (mut width, mut height, mut label_every, mut repair) = (640_u32, 480_u32, 20_000_i64, false);
    let (mut labels, mut wide, mut paced, mut finish) = (false, false, false, true);
    for argument in std::env::args().skip(1) {
        match argument.split_once('=') {
            None => out = Some(PathBuf::from(argument)),
            Some(("events", v)) => events = v.parse()?,
            Some(("rate", v)) => rate = v.parse()?,
            Some(("packet", v)) => packet = v.parse()?,
            Some(("cameras", v)) => cameras = v.parse()?,
            Some(("labels", v)) => labels = v == "1",
            Some(("wide", v)) => wide = v == "1",
            Some(("paced", v)) => paced = v == "1",
            Some(("finish", v)) => finish = v == "1",
            Some(("width", v)) => width = v.parse()?,
            Some(("height", v)) => height = v.parse()?,
            Some(("label_every", v)) => label_every = v.parse()?,
            Some(("repair", v)) => repair = v == "1",
            Some((name, _)) => return Err(format!("unknown setting {name}").into()),
        }
    }
    let out = out.ok_or("give the output file")?;
    if repair {
        println!("{:?}", evis_core::format::hdf5::repair(&out)?);
        return Ok(());
    }
    let header = RecordingHeader {
        cameras: (0..cameras)
            .map(|i| CameraInfo {
                name: format!("cam{i}"),
                width,
                height,
                fx: 500.0,
                fy: 500.0,
                cx: 320.0,
                cy: 240.0,
                distortion: None,
            })
            .collect(),
        seed: 7,
        method: "native".into(),
        environment: 0,
        config_toml: "rate_hz = 1000.0\n".into(),
        duration_us: if wide { None } else { Some(4_000_000_000) },
        t_offset_us: 1_700_000_000_000_000,
        labels: if labels { vec![LabelKind::Depth, LabelKind::FlowForward] } else { Vec::new() },
    };
    let mut writer = RecordingWriter::create(&out, &header, true)?;
    let start = Instant::now();
    let mut next_label = 0;
    let mut spent = Duration::ZERO;
    let mut given = 0;
    while given < events {
        let until = (given + packet).min(events);
        let block: Vec<Event> = (given..until).map(|i| event(i, rate, width, height)).collect();
        let last_t = block.last().map_or(0, |e| e.t);
        let before = Instant::now();
        for camera in 0..cameras {
            writer.write_events(camera, &block)?;
            writer.write_pose(
                camera,
                &PoseSample {
                    t_us: last_t,
                    position: [last_t as f64, 1.0, 2.0],
                    rotation: [0.0, 0.0, 0.0, 1.0],
                },
            )?;
        }
        while labels && next_label <= last_t {
            for camera in 0..cameras {
                let pixels = (width * height) as usize;
                let value = next_label as f32;
                for (kind, size) in [(LabelKind::Depth, pixels), (LabelKind::FlowForward, 2 * pixels)] {
                    let data = LabelData::F32(vec![value; size]);
                    let t_other_us = next_label + label_every;
                    writer.write_label(camera, &LabelFrame { kind, t_us: next_label, t_other_us, data })?;
                }
            }
            next_label += label_every;
        }
        spent += before.elapsed();
        given = until;
        if paced {
            let mut stdout = std::io::stdout().lock();
            writeln!(stdout, "{given}")?;
            stdout.flush()?;
            let due = Duration::from_micros(last_t.unsigned_abs());
            std::thread::sleep(due.saturating_sub(start.elapsed()));
            writer.flush_if_due()?;
        }
    }
    let before = Instant::now();
    if finish {
        writer.finish("{\"events\": 1}")?;
    } else {
        drop(writer);
    }
    spent += before.elapsed();
    if !paced {
        let bytes = std::fs::metadata(&out)?.len();
        let total = events * cameras as u64;
        println!(
            "{total} events, {:.2} million/s in the writer, {:.2} bytes per event",
            total as f64 / spent.as_secs_f64() / 1e6,
            bytes as f64 / total as f64
        );
    }
    Ok(())
}
