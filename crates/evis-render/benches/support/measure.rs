//! Two clocks, and what repetitions say of them.

use std::fs;
use std::time::Instant;

/// Seconds of one measurement.
#[derive(Clone, Copy, Default)]
pub struct Sample {
    /// By the clock on the wall.
    pub wall_s: f64,
    /// On all cores, by the scheduler: other work on the machine changes it little. NaN where it cannot be had.
    pub cpu_s: f64,
}

/// Measures `work`.
pub fn measure<T, E>(work: impl FnOnce() -> Result<T, E>) -> Result<(Sample, T), E> {
    let (cpu, wall) = (process_cpu_s(), Instant::now());
    let out = work()?;
    let wall_s = wall.elapsed().as_secs_f64();
    Ok((Sample { wall_s, cpu_s: process_cpu_s() - cpu }, out))
}

/// Time on a core of all threads that live (the driver's and the pools' live on), in seconds.
fn process_cpu_s() -> f64 {
    let Ok(tasks) = fs::read_dir("/proc/self/task") else { return f64::NAN };
    let on_core = |path: std::path::PathBuf| {
        let text = fs::read_to_string(path.join("schedstat")).ok()?;
        text.split(' ').next()?.parse::<u64>().ok()
    };
    tasks.flatten().filter_map(|t| on_core(t.path())).sum::<u64>() as f64 * 1e-9
}

/// Repetitions of one measurement.
#[derive(Clone, Default)]
pub struct Series(Vec<Sample>);

impl Series {
    /// Adds one.
    pub fn push(&mut self, sample: Sample) {
        self.0.push(sample);
    }

    /// Least, middle and largest of what `clock` reads.
    pub fn spread(&self, clock: impl Fn(&Sample) -> f64) -> [f64; 3] {
        let mut values: Vec<f64> = self.0.iter().map(clock).collect();
        values.sort_by(f64::total_cmp);
        match values.as_slice() {
            [] => [f64::NAN; 3],
            [first, .., last] => [*first, values[values.len() / 2], *last],
            [only] => [*only; 3],
        }
    }

    /// Least wall time.
    pub fn wall(&self) -> f64 {
        self.spread(|s| s.wall_s)[0]
    }

    /// Least CPU time.
    pub fn cpu(&self) -> f64 {
        self.spread(|s| s.cpu_s)[0]
    }
}

/// Peak resident memory of this process in MiB; NaN where the system does not tell.
pub fn peak_memory_mib() -> f64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let kib = line.and_then(|l| l.trim().trim_end_matches("kB").trim().parse::<f64>().ok());
    kib.map_or(f64::NAN, |k| k / 1024.0)
}
