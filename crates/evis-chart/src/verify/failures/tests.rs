//! lab
use super::*;
#[test]
fn lab() {
    let gpu = Gpu::open(None).unwrap();
    let only: Vec<String> = std::env::var("ONLY").map(|s| s.split(',').map(str::to_owned).collect()).unwrap_or_default();
    let methods = match std::env::var("METHODS") { Ok(s) => s.split(',').map(|m| NamedMethod::named(m).unwrap()).collect(), _ => methods() };
    let start = std::time::Instant::now();
    let stage = std::sync::Mutex::new(std::time::Instant::now());
    let last = std::sync::Mutex::new(0usize);
    let n = if only.is_empty() { 26.0 } else { 1.0 };
    let told = |s, part: f64| { let k = (part * n) as usize; if s == Stage::Truth { let mut l = last.lock().unwrap(); if k != *l { *l = k; let mut t = stage.lock().unwrap(); eprintln!("truth {k}: {:.1} s", t.elapsed().as_secs_f64()); *t = std::time::Instant::now(); } } true };
    let settings = FailureSettings { methods, failures: only, cache: Some("/tmp/fail-cache".into()) };
    let report = verify_failures(&gpu, &settings, &told).unwrap();
    println!("{report}\n{:.1} s", start.elapsed().as_secs_f64());
    std::fs::write("/tmp/fail-report.json", report.to_json().unwrap()).unwrap();
}
