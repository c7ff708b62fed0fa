//! Mutants of every kind of file that is read: no panic, no abort, no hang, and no more memory than a limit.
//!
//! Each target of `fuzz/src/targets.rs` runs in a child process, whose address space is limited; the mutants are the same in
//! every run. `EVIS_FUZZ_S` is for how many seconds each target goes on, in place of its number of mutants, and
//! `EVIS_FUZZ_SEED` where it begins.

#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[path = "../../evis-core/tests/common/damage.rs"]
mod damage;
#[path = "../../../fuzz/src/targets.rs"]
mod targets;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use damage::{Damage, Folder, replace};
use targets::{TARGETS, Target};

/// Memory that a file may take, bytes.
const FILE_LIMIT: u64 = 64 << 20;
/// Address space of a child, kilobytes: the limit, and what a process of threads takes anyway.
const CHILD_LIMIT_KB: u64 = 1 << 20;
/// No file takes so long to read, seconds.
const HANG_S: u64 = 60;

const TARGET: &str = "EVIS_FUZZ_TARGET";
const FOLDER: &str = "EVIS_FUZZ_FOLDER";

/// Exit codes of a child that noticed something.
const PANICKED: i32 = 70;
const HUNG: i32 = 71;

/// Targets that do what no target may.
fn canaries() -> [Target; 4] {
    let base = |name, read| Target { name, mutants: 5, marks: &[], seeds: |_| vec![b"seed".to_vec()], read };
    [
        base("canary_panic", |_, bytes| {
            assert!(bytes == b"seed", "a planted panic");
            true
        }),
        base("canary_memory", |_, bytes| {
            // Two gigabytes, which the limit does not have.
            bytes == b"seed" || vec![bytes.len() as u8; 2 << 30].iter().any(|byte| *byte == 1)
        }),
        base("canary_hang", |_, bytes| {
            let file = std::hint::black_box(bytes);
            loop {
                if file == b"seed" {
                    return true;
                }
                std::thread::sleep(Duration::from_millis(10));
            }
        }),
        base("canary_seed", |_, _| false),
    ]
}

fn setting(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|text| text.parse().unwrap_or_else(|_| panic!("{name}={text}: a number")))
}

/// Runs the target that the environment names; the parent's other half.
#[test]
#[ignore = "a child of the other tests"]
fn child() {
    let name = std::env::var(TARGET).expect("started by another test");
    let folder = PathBuf::from(std::env::var(FOLDER).unwrap());
    let all = canaries().into_iter().chain(TARGETS);
    let target = all.into_iter().find(|target| target.name == name).expect("a target");
    evis_core::limits::set_memory_limit(FILE_LIMIT);

    let done = Arc::new(AtomicU64::new(0));
    let watched = done.clone();
    let hang_after = Duration::from_secs(setting("EVIS_FUZZ_HANG_S").unwrap_or(HANG_S));
    std::thread::spawn(move || {
        let (mut last, mut since) = (0, Instant::now());
        loop {
            std::thread::sleep(Duration::from_millis(100));
            let now = watched.load(Ordering::Relaxed);
            if now != last {
                (last, since) = (now, Instant::now());
            } else if since.elapsed() > hang_after {
                std::process::exit(HUNG);
            }
        }
    });

    let seeds = (target.seeds)(&folder);
    for (number, seed) in seeds.iter().enumerate() {
        assert!((target.read)(&folder, seed), "seed {number} of {name} is not taken: {}", text(seed));
        done.fetch_add(1, Ordering::Relaxed);
    }
    let first = setting("EVIS_FUZZ_SEED").unwrap_or(1);
    let mut mutants: Vec<_> =
        seeds.iter().enumerate().map(|(k, seed)| Damage::new(first + k as u64, seed, target.marks)).collect();
    let end = setting("EVIS_FUZZ_S").map(|seconds| Instant::now() + Duration::from_secs(seconds));
    let (mut taken, mut refused) = (0_u64, 0_u64);
    let most = target.mutants.next_multiple_of(mutants.len());
    let current = folder.join("mutant");
    for number in 0.. {
        if end.map_or(number >= most, |end| Instant::now() >= end) {
            break;
        }
        let count = mutants.len();
        let mutant = mutants[number % count].next();
        // What is read when the process ends is found here.
        replace(&current, &mutant);
        match catch_unwind(AssertUnwindSafe(|| (target.read)(&folder, &mutant))) {
            Ok(true) => taken += 1,
            Ok(false) => refused += 1,
            Err(_) => std::process::exit(PANICKED),
        }
        done.fetch_add(1, Ordering::Relaxed);
    }
    println!("tried {} taken {taken} refused {refused}", taken + refused);
}

/// The start of a file, for a message.
fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(&bytes[..bytes.len().min(300)]).into_owned()
}

fn run(folder: &Path, name: &str, hang_s: u64) -> Output {
    let program = std::env::current_exe().unwrap();
    Command::new("sh")
        .args(["-c", &format!("ulimit -v {CHILD_LIMIT_KB} && exec \"$0\" \"$@\"")])
        .arg(program)
        .args(["--exact", "child", "--ignored", "--nocapture", "--test-threads=1"])
        .env(TARGET, name)
        .env(FOLDER, folder)
        .env("EVIS_FUZZ_HANG_S", hang_s.to_string())
        // Address space of stacks and of heaps of threads is not what is measured.
        .env("RAYON_NUM_THREADS", "2")
        .env("MALLOC_ARENA_MAX", "2")
        .output()
        .unwrap()
}

/// Numbers of mutants that were tried, taken and refused; or what went wrong.
fn outcome(folder: &Path, name: &str, hang_s: u64) -> Result<[u64; 3], String> {
    let output = run(folder, name, hang_s);
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    if output.status.success()
        && let Some(line) = told.lines().find_map(|line| line.split_once("tried ").map(|(_, rest)| rest))
    {
        let numbers: Vec<u64> = line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        return numbers.try_into().map_err(|_| told);
    }
    let why = match output.status.code() {
        Some(PANICKED) => "panics".into(),
        Some(HUNG) => format!("is still being read after {hang_s} s"),
        _ => format!("ends the process ({})", output.status),
    };
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    // A backtrace is long, and what comes before it says more; outside decoders' own panics come first.
    let from = errors.rfind("panicked at").unwrap_or(errors.len().saturating_sub(500));
    let told: String =
        String::from_utf8_lossy(&errors.as_bytes()[from..]).lines().take(6).collect::<Vec<_>>().join("\n");
    Err(format!("{why}\n{told}"))
}

fn campaign(name: &str) {
    let folder = Folder::new(&format!("fuzz-{name}"));
    let path = folder.file("");
    match outcome(&path, name, HANG_S) {
        Ok([tried, taken, refused]) => {
            println!("{name}: {tried} mutants, {taken} taken, {refused} refused");
            let target = TARGETS.into_iter().find(|target| target.name == name).unwrap();
            assert!(setting("EVIS_FUZZ_S").is_some() || tried >= target.mutants as u64, "{tried} tried");
            // A campaign that takes nothing, or refuses nothing, has tried nothing.
            assert!(taken > tried / 200 && refused > tried / 200, "{taken} taken, {refused} refused");
        }
        Err(why) => {
            let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("mutant-{name}"));
            let copied = std::fs::copy(path.join("mutant"), &kept);
            panic!("a mutant of {name} (kept as {}, {copied:?}) {why}", kept.display());
        }
    }
}

macro_rules! campaigns {
    ($($test:ident $name:literal,)*) => {
        $(#[test]
        fn $test() {
            campaign($name);
        })*

        #[test]
        fn ten_thousand_files_are_tried() {
            let tested = [$($name),*];
            assert_eq!(tested.to_vec(), TARGETS.map(|target| target.name).to_vec(), "a test for each target");
            let all: usize = TARGETS.iter().map(|target| target.mutants).sum();
            assert!(all >= 10_000, "{all}");
        }
    };
}

campaigns! {
    mutated_gltf_files "gltf",
    mutated_scene_files "toml_scene",
    mutated_sensor_files "sensor",
    mutated_rigs "rig",
    mutated_trajectories "trajectory",
    mutated_pictures "picture",
    mutated_environments "environment",
    mutated_event_files "events",
    mutated_raw_files "raw",
    mutated_aedat4_files "aedat4",
    mutated_bags "bag",
    mutated_hdf5_files "hdf5",
    mutated_numpy_files "numpy",
    mutated_recordings "recording",
    mutated_truths "truth",
    mutated_states "state",
    mutated_frames "frames",
}

#[test]
fn panics_greed_hangs_and_seeds_that_are_no_files_are_noticed() {
    for (name, message) in [
        ("canary_panic", "panics"),
        ("canary_memory", "ends the process"),
        ("canary_hang", "still being read"),
        ("canary_seed", "is not taken"),
    ] {
        let folder = Folder::new(name);
        let why = outcome(&folder.file(""), name, 2).unwrap_err();
        assert!(why.contains(message), "{name}: {why}");
    }
}
