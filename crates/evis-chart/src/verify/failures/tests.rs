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

#[test]
fn lab2() {
    let gpu = Gpu::open(None).unwrap();
    let known = run::Known::new(shots::ShotId::Burst { keyframe_hz: Some(30.0) }, Some(Path::new("/tmp/fail-cache")), &|_| true).unwrap();
    let hist = |events: &mut dyn Iterator<Item = &evis_core::Event>| { let mut h = [[0; 2]; 34]; for e in events { if e.t > 16666 { let ph = (e.t as f64 / 33333.333).fract(); h[(ph * 33.0) as usize][e.p as usize] += 1; } } h };
    let t = hist(&mut known.truth.events.iter());
    for m in ["native", "splat"] {
        let r = run::Run::new(&gpu, &known, &NamedMethod::named(m).unwrap(), &|_| true).unwrap();
        let b = detect::ByPixel::new(&r.events, &known.truth);
        let h = hist(&mut b.pixels().flatten());
        for k in 0..33 { println!("{m} {k} {:?} truth {:?}", h[k], t[k]); }
    }
    let px = known.truth.pixels[100];
    let r = run::Run::new(&gpu, &known, &NamedMethod::named("splat").unwrap(), &|_| true).unwrap();
    println!("{px:?} {:?}", r.events.iter().filter(|e| [e.x, e.y] == px).map(|e| (e.t, e.p)).collect::<Vec<_>>());
    println!("{:?}", known.truth.events.iter().filter(|e| [e.x, e.y] == px).map(|e| (e.t, e.p)).collect::<Vec<_>>());
    let method = NamedMethod::named("splat").unwrap().with_keyframes(30.0);
    let config = method.setting.run_config(&evis_render::RunConfig { reference_luminance: Some(0.5), ..Default::default() }).unwrap();
    println!("{config:?}");
}
