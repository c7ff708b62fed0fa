//! Canaries: streams whose score can be said beforehand.

use super::*;
use crate::event::Polarity;
use crate::packet::CameraInfo;
use crate::truth::RegionSpan;

/// SplitMix64.
pub(super) struct Random(pub u64);

impl Random {
    pub fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % limit
    }
}

fn event(t: i64, x: u16, y: u16, on: bool) -> Event {
    Event::new(t, x, y, if on { Polarity::On } else { Polarity::Off })
}

fn truth(size: [u16; 2], duration_us: i64, mut events: Vec<Event>) -> Truth {
    events.sort_by_key(Event::order);
    let [width, height] = size;
    Truth {
        camera: CameraInfo::uncalibrated("camera", (width.into(), height.into())),
        sensor: SensorConfig::default(),
        reference_luminance: 1.0,
        duration_us,
        pixels: (0..height).flat_map(|y| (0..width).map(move |x| [x, y])).collect(),
        events,
        speed: Vec::new(),
        event_region: Vec::new(),
        span_start: Vec::new(),
        spans: Vec::new(),
        provenance: String::new(),
    }
}

/// 8×6 pixels over one second. Each pixel fires every 20 ms (each at its own phase), ON in the left half, OFF in the
/// right one, so that no two events of a pixel are closer than twenty widest plain tolerances.
fn sparse() -> Truth {
    let mut events = Vec::new();
    for y in 0..6_u16 {
        for x in 0..8_u16 {
            let phase = 3000 + i64::from(x) * 311 + i64::from(y) * 173;
            events.extend((0..49).map(|k| event(phase + k * 20_000, x, y, x < 4)));
        }
    }
    truth([8, 6], 1_000_000, events)
}

fn changed(truth: &Truth, change: impl FnMut(&Event) -> Event) -> Vec<Event> {
    let mut events: Vec<_> = truth.events.iter().map(change).collect();
    events.sort_by_key(Event::order);
    events
}

fn moved(e: &Event, by_us: i64) -> Event {
    event(e.t + by_us, e.x, e.y, e.p == 1)
}

fn scored(events: &[Event], truth: &Truth) -> Score {
    score(events, truth, &ScoreSettings::default()).unwrap()
}

fn plain(events: &[Event], truth: &Truth, tolerance_us: i64) -> MatchScore {
    scored(events, truth).at(tolerance_us).unwrap().plain.clone()
}

#[test]
fn truth_scores_full_marks_against_itself() {
    let truth = sparse();
    let score = scored(&truth.events, &truth);
    for level in &score.tolerances {
        for s in [&level.plain, &level.scaled] {
            assert_eq!((s.precision, s.recall, s.f1, s.missed, s.spurious), (1.0, 1.0, 1.0, 0, 0));
            assert_eq!(
                s.time_error,
                Some(TimeError {
                    median_us: 0.0,
                    p95_us: 0.0,
                    rms_us: 0.0,
                    bias_us: 0.0,
                    median_per_interval: Some(0.0)
                })
            );
        }
    }
    assert_eq!((score.exact_sequence, score.exact_sequence_fired, score.count_ratio), (1.0, 1.0, 1.0));
    assert_eq!((score.voxel_l1, score.integrated_log_rms), (Some(0.0), Some(0.0)));
    let json = serde_json::to_string(&score).unwrap();
    assert_eq!(serde_json::from_str::<Score>(&json).unwrap(), score);
}

#[test]
fn a_shift_within_the_tolerance_is_all_bias() {
    let truth = sparse();
    let score = scored(&changed(&truth, |e| moved(e, 500)), &truth);
    let s = &score.at(1000).unwrap().plain;
    assert_eq!((s.f1, s.matched), (1.0, 49 * 48));
    let error = s.time_error.as_ref().unwrap();
    assert_eq!((error.bias_us, error.median_us, error.p95_us, error.rms_us), (500.0, 500.0, 500.0, 500.0));
    // The next event of the pixel is 20 ms away: 500 / 20 000, to one part in 256.
    assert!((error.median_per_interval.unwrap() - 0.025).abs() < 1e-4);
    // Beyond the tolerance nothing is near.
    let s = &score.at(300).unwrap().plain;
    assert_eq!((s.f1, s.precision, s.recall, &s.time_error), (0.0, 0.0, 0.0, &None));
    assert!((s.missed_per_pixel_s - 49.0).abs() < 1e-9 && (s.spurious_per_pixel_s - 49.0).abs() < 1e-9);
    let early = plain(&changed(&truth, |e| moved(e, -300)), &truth, 300);
    assert_eq!(
        (early.f1, early.time_error.unwrap().bias_us),
        (1.0, -300.0),
        "the tolerance itself is within it"
    );
}

#[test]
fn a_shift_beyond_the_tolerance_pairs_neighbours() {
    // Ten events 1200 us apart, 1500 us late: event k falls 300 us after truth event k + 1, so that nine of ten pair,
    // with a bias of 300 us.
    let mut truth = truth([2, 1], 400_000, (0..10).map(|k| event(50_000 + 1200 * k, 1, 0, true)).collect());
    let late = changed(&truth, |e| moved(e, 1500));
    let s = plain(&late, &truth, 1000);
    assert_eq!((s.matched, s.f1, s.time_error.unwrap().bias_us), (9, 0.9, 300.0));
    // Where the picture moves at 50 px/s, 0.1 px are 2 ms: all ten pair with their own.
    truth.speed = vec![50.0; 10];
    let score = scored(&late, &truth);
    let level = score.at(1000).unwrap();
    assert_eq!((level.plain.matched, level.scaled.matched), (9, 10));
    assert_eq!(level.scaled.time_error.as_ref().unwrap().bias_us, 1500.0);
    assert_eq!(score.at(300).unwrap().scaled.matched, 9, "0.03 px are 600 us");
    assert_eq!(score.at(100).unwrap().scaled.matched, 0, "0.01 px are 200 us");
}

#[test]
fn tolerances_grow_where_the_picture_is_slow_and_no_further_than_tenfold() {
    let one = |speed: f32, t: i64| {
        let mut truth = truth([1, 1], 300_000, vec![event(100_000, 0, 0, true)]);
        truth.speed = vec![speed];
        let scores = scored(&[event(100_000 + t, 0, 0, true)], &truth);
        let at = |tolerance| scores.at(tolerance).unwrap();
        assert_eq!(at(1000).plain.matched, u64::from(t <= 1000));
        [at(1000).scaled.matched, at(300).scaled.matched, at(100).scaled.matched]
    };
    assert_eq!((one(40.0, 2500), one(40.0, 2501)), ([1, 0, 0], [0, 0, 0]));
    assert_eq!((one(40.0, 750), one(40.0, 250), one(40.0, 251)), ([1, 1, 0], [1, 1, 1], [1, 1, 0]));
    assert_eq!((one(1.0, 10_000), one(1.0, 10_001)), ([1, 0, 0], [0, 0, 0]));
    assert_eq!((one(1.0, 1000), one(1.0, 1001)), ([1, 1, 1], [1, 1, 0]));
    for full in [100.0, 5000.0, 0.0, -3.0, f32::NAN, f32::INFINITY] {
        assert_eq!(
            (one(full, 100), one(full, 101), one(full, 1001)),
            ([1, 1, 1], [1, 1, 0], [0, 0, 0]),
            "{full}"
        );
    }
}

#[test]
fn a_mirrored_stream_and_a_flipped_one_match_nothing() {
    let truth = sparse();
    // The left half is all ON, the right half all OFF.
    let mirrored = scored(&changed(&truth, |e| event(e.t, 7 - e.x, e.y, e.p == 1)), &truth);
    let flipped = scored(&changed(&truth, |e| event(e.t, e.x, e.y, e.p == 0)), &truth);
    for score in [&mirrored, &flipped] {
        assert!(score.tolerances.iter().all(|l| l.plain.f1 == 0.0 && l.scaled.f1 == 0.0));
        assert_eq!((score.exact_sequence, score.exact_sequence_fired, score.count_ratio), (0.0, 0.0, 1.0));
    }
    assert_eq!(flipped.voxel_l1, Some(2.0), "each voxel is wrong by twice itself");
    // After window k of 50 each pixel is off by twice its k events of 0.2; the last event comes in window 49 of 50.
    let squares = (1..=49).chain([49]).map(|k: i32| (0.4 * f64::from(k)).powi(2));
    let expected = (squares.sum::<f64>() / 50.0).sqrt();
    assert!((flipped.integrated_log_rms.unwrap() - expected).abs() < 1e-6);
}

#[test]
fn a_thinned_stream_is_precise_and_incomplete() {
    let truth = sparse();
    let mut seen = std::collections::HashMap::new();
    let mut kept = truth.events.clone();
    kept.retain(|e| {
        let count = seen.entry((e.x, e.y)).or_insert(0);
        *count += 1;
        *count % 4 != 0 && *count <= 48
    });
    // 36 of the first 48 events of each pixel; the 49th is left out of the truth.
    let mut whole = truth.clone();
    whole.events.retain(|e| e.t < 960_000);
    assert_eq!((whole.events.len(), kept.len()), (48 * 48, 48 * 36));
    let score = scored(&kept, &whole);
    for s in score.tolerances.iter().flat_map(|l| [&l.plain, &l.scaled]) {
        assert_eq!((s.recall, s.precision, s.f1), (0.75, 1.0, 6.0 / 7.0));
        assert_eq!((s.missed, s.spurious), (48 * 12, 0));
    }
    assert_eq!((score.count_ratio, score.exact_sequence), (0.75, 0.0));
}

#[test]
fn uniform_jitter_shows_as_its_standard_deviation() {
    let mut random = Random(5);
    let events = (0..40_000_i64).map(|k| event(5000 + k / 40 * 10_000, (k % 40) as u16, 0, k % 3 == 0));
    let truth = truth([40, 1], 10_100_000, events.collect());
    let jittered = changed(&truth, |e| moved(e, random.below(801) as i64 - 400));
    let s = plain(&jittered, &truth, 1000);
    assert_eq!(s.f1, 1.0);
    let error = s.time_error.unwrap();
    // Whole microseconds from -j to j: the variance is j (j + 1) / 3, next to j² / 3. Bounds are four standard errors.
    let (expected, n) = ((400.0 * 401.0 / 3.0_f64).sqrt(), 40_000.0_f64);
    assert!((error.rms_us / expected - 1.0).abs() < 4.0 * 0.447 / n.sqrt(), "{error:?}");
    assert!(error.bias_us.abs() < 4.0 * expected / n.sqrt(), "{error:?}");
    assert!((error.median_us - 200.0).abs() < 4.0, "{error:?}");
    assert!((error.p95_us - 380.0).abs() < 4.0, "{error:?}");
}

/// `count` events at random pixels and times.
fn noise(count: usize, size: [u16; 2], duration_us: i64, seed: u64) -> Vec<Event> {
    let mut random = Random(seed);
    let mut below = |limit: i64| random.below(limit as u64);
    let any = |_| {
        event(
            below(duration_us) as i64,
            below(size[0].into()) as u16,
            below(size[1].into()) as u16,
            below(2) == 1,
        )
    };
    let mut events: Vec<_> = (0..count).map(any).collect();
    events.sort_by_key(Event::order);
    events
}

#[test]
fn an_unrelated_stream_scores_as_chance() {
    for duration_us in [1_000_000, 120_000] {
        let truth = truth([16, 16], duration_us, noise(40_000, [16, 16], duration_us, 1));
        let score = scored(&noise(40_000, [16, 16], duration_us, 2), &truth);
        for s in score.tolerances.iter().map(|l| &l.plain) {
            assert!((s.f1 - s.chance_f1).abs() < 0.02, "{} and by chance {}", s.f1, s.chance_f1);
        }
        let widest = &score.at(1000).unwrap().plain;
        assert!(widest.f1 > 0.05 && widest.f1 < 0.95, "canary: {} could not differ", widest.f1);
        // A right stream is far better than chance.
        let s = plain(&truth.events, &truth, 100);
        assert!(s.f1 == 1.0 && s.chance_f1 < 0.4, "{}", s.chance_f1);
    }
}

#[test]
fn chance_streams_move_by_more_than_50_ms_either_way() {
    let truth = sparse();
    assert_eq!(scored(&truth.events, &truth).chance_shift_us, [50_001, 949_999]);
    let short = super::tests::truth([1, 1], 100_000, vec![event(5, 0, 0, true)]);
    assert_eq!(scored(&[], &short).chance_shift_us, [25_000, 74_999]);
}

#[test]
fn an_empty_stream_has_a_score() {
    let truth = sparse();
    let score = scored(&[], &truth);
    let s = &score.at(1000).unwrap().plain;
    assert_eq!((s.precision, s.recall, s.f1, s.chance_f1), (1.0, 0.0, 0.0, 0.0));
    assert_eq!((score.voxel_l1, score.exact_sequence, score.count_ratio), (Some(1.0), 0.0, 0.0));
}

#[test]
fn the_sequence_of_polarities_counts_silence_and_order() {
    let events = vec![event(1000, 0, 0, true), event(2000, 0, 0, false), event(1000, 1, 0, true)];
    let truth = truth([4, 1], 300_000, events);
    let sequences = |events: &[Event]| {
        let score = scored(events, &truth);
        (score.exact_sequence, score.exact_sequence_fired, score.fired_pixels)
    };
    // Any times, the right order.
    let right = [event(50, 0, 0, true), event(60, 1, 0, true), event(299_999, 0, 0, false)];
    assert_eq!(sequences(&right), (1.0, 1.0, 2));
    let swapped = [event(50, 0, 0, false), event(60, 1, 0, true), event(299_999, 0, 0, true)];
    assert_eq!(sequences(&swapped), (0.75, 0.5, 2));
    let noisy = [event(50, 0, 0, true), event(60, 1, 0, true), event(70, 0, 0, false), event(80, 3, 0, true)];
    assert_eq!(sequences(&noisy), (0.75, 2.0 / 3.0, 3));
}

#[test]
fn regions_share_out_what_matched_and_what_did_not() {
    let span = |t_us, region| RegionSpan { t_us, region };
    let mut truth = truth(
        [2, 1],
        300_000,
        vec![event(10_000, 0, 0, true), event(20_000, 0, 0, true), event(30_000, 1, 0, true)],
    );
    truth.event_region = vec![Region::Silhouette, Region::Interior, Region::ShadowEdge];
    truth.span_start = vec![0, 2, 3];
    truth.spans =
        vec![span(0, Region::Interior), span(15_000, Region::Disoccluded), span(0, Region::ShadowEdge)];
    let events = [
        event(10_500, 0, 0, true), // pairs with the silhouette event, in a pixel that is interior then
        event(14_999, 0, 0, true), // spurious, interior
        event(15_000, 0, 0, true), // spurious, disoccluded
        event(30_000, 1, 0, false), // spurious, shadow edge
    ];
    let s = plain(&events, &truth, 1000);
    let counts = |region| s.region(region).map(|r| (r.truth_events, r.events, r.matched));
    assert_eq!(counts(Region::Interior), Some((1, 1, 0)));
    assert_eq!(counts(Region::Silhouette), Some((1, 1, 1)));
    assert_eq!(counts(Region::Disoccluded), Some((0, 1, 0)));
    assert_eq!(counts(Region::ShadowEdge), Some((1, 1, 0)));
    assert_eq!(s.region(Region::Silhouette).unwrap().f1, 1.0);
    assert_eq!(s.region(Region::Disoccluded).unwrap().f1, 0.0);
    assert_eq!((s.matched, s.missed, s.spurious), (1, 2, 3));
    let same = plain(&truth.events, &truth, 1000);
    assert!(same.region(Region::Disoccluded).is_none() && same.regions.iter().all(|r| r.f1 == 1.0));
}

#[test]
fn what_truth_does_not_know_is_ignored_and_counted() {
    let mut truth = sparse();
    truth.pixels.retain(|[x, _]| *x != 3);
    let mut stream = truth.events.clone();
    truth.events.retain(|e| e.x != 3);
    stream.extend([event(1_000_000, 0, 0, true), event(1_500_000, 0, 0, true)]);
    stream.insert(0, event(-1, 0, 0, true));
    let score = scored(&stream, &truth);
    assert_eq!((score.ignored_unknown_pixel, score.ignored_outside_interval), (6 * 49, 3));
    assert_eq!((score.events, score.at(100).unwrap().plain.f1), (42 * 49, 1.0));
}

#[test]
fn phase_blind_measures_follow_their_formulas() {
    let duration_us = 130_000;
    let truth = truth([3, 2], duration_us, noise(60, [3, 2], duration_us, 8));
    let stream = noise(75, [3, 2], duration_us, 9);
    let voxels = |events: &[Event], x: u16, y: u16, window: i64, bin: i64| -> f64 {
        let mine = events.iter().filter(|e| (e.x, e.y, e.t / WINDOW_US) == (x, y, window));
        mine.map(|e| {
            let place = 4.0 * (e.t - window * WINDOW_US) as f64 / WINDOW_US as f64;
            f64::from(2 * e.p - 1) * (1.0 - (bin as f64 - place).abs()).max(0.0)
        })
        .sum()
    };
    let brightness = |events: &[Event], x: u16, y: u16, until: i64| -> f64 {
        let mine = events.iter().filter(|e| (e.x, e.y) == (x, y) && e.t < until);
        mine.map(|e| 0.2_f32 as f64 * f64::from(2 * e.p - 1)).sum()
    };
    let (mut difference, mut reference, mut squares) = (0.0, 0.0, 0.0);
    for (x, y) in [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)] {
        for window in 0..7 {
            for bin in 0..5 {
                let (a, b) = (voxels(&stream, x, y, window, bin), voxels(&truth.events, x, y, window, bin));
                difference += (a - b).abs();
                reference += b.abs();
            }
            let until = ((window + 1) * WINDOW_US).min(duration_us);
            let error = brightness(&stream, x, y, until) - brightness(&truth.events, x, y, until);
            squares += error * error;
        }
    }
    let score = scored(&stream, &truth);
    assert!((score.voxel_l1.unwrap() - difference / reference).abs() < 1e-9);
    assert_eq!(voxel_l1(&stream, &truth), Ok(score.voxel_l1));
    assert!((score.integrated_log_rms.unwrap() - (squares / (6.0 * 7.0)).sqrt()).abs() < 1e-9);
    let mut unknown = truth.clone();
    unknown.sensor.threshold_on = f32::NAN;
    assert_eq!(scored(&stream, &unknown).integrated_log_rms, None);
}

#[test]
fn a_stream_that_does_not_belong_to_the_truth_is_told_why() {
    let truth = sparse();
    let refused = |events: &[Event], truth: &Truth, settings: &ScoreSettings, words: &[&str]| {
        let message = score(events, truth, settings).unwrap_err().to_string();
        assert!(words.iter().all(|w| message.contains(w)), "{message}");
    };
    let fine = ScoreSettings::default();
    let size = ScoreSettings { size: Some([640, 480]), ..fine.clone() };
    refused(&[], &truth, &size, &["640x480", "8x6"]);
    let sensor = |change: fn(&mut SensorConfig)| {
        let mut sensor = SensorConfig::default();
        change(&mut sensor);
        ScoreSettings { sensor: Some(sensor), ..fine.clone() }
    };
    refused(&[], &truth, &sensor(|s| s.threshold_on = 0.3), &["threshold_on = 0.3", "0.2"]);
    refused(&[], &truth, &sensor(|s| s.threshold_off = 0.25), &["threshold_off = 0.25", "0.2"]);
    refused(&[], &truth, &sensor(|s| s.log_eps = 1e-5), &["log_eps", "0.00001", "0.001"]);
    assert!(score(&[], &truth, &sensor(|s| s.threshold_on = 0.2 + 1e-7)).is_ok(), "rounded twice");
    assert!(score(&[], &truth, &sensor(|s| s.threshold_on = f32::NAN)).is_ok(), "unknown");

    let at = |t| event(t, 0, 0, true);
    refused(&[at(5), at(9), at(8), at(1)], &truth, &fine, &["event 2", "8 us", "9 us", "the stream"]);
    refused(&[event(5, 8, 0, true)], &truth, &fine, &["x = 8", "8x6", "the stream"]);
    let mut purple = at(5);
    purple.p = -1;
    refused(&[at(1), purple], &truth, &fine, &["event 1 of the stream", "-1"]);
    for tolerances_us in [vec![], vec![0], vec![1000, -5], vec![2_000_000]] {
        refused(&[], &truth, &ScoreSettings { tolerances_us, ..fine.clone() }, &["tolerances_us"]);
    }

    let with = |change: fn(&mut Truth)| {
        let mut changed = truth.clone();
        change(&mut changed);
        changed
    };
    refused(&[at(1)], &with(|t| t.events.clear()), &fine, &["has no events", "48 pixels", "1 events"]);
    let nothing = with(|t| {
        t.pixels.clear();
        t.events.clear();
    });
    refused(&[], &nothing, &fine, &["knows no pixels"]);
    refused(&[], &with(|t| t.events.swap(3, 40)), &fine, &["the truth is not sorted"]);
    refused(&[], &with(|t| t.duration_us = 900_000), &fine, &["outside its interval", "900000"]);
    refused(&[], &with(|t| t.pixels.truncate(40)), &fine, &["not among its 40 pixels"]);
    refused(&[], &with(|t| t.pixels.swap(1, 2)), &fine, &["order of y"]);
    refused(&[], &with(|t| t.speed = vec![1.0; 3]), &fine, &["2352 events and 3 speeds"]);
    refused(&[], &with(|t| t.event_region = vec![Region::Interior]), &fine, &["1 regions"]);
    refused(&[], &with(|t| t.span_start = vec![0; 3]), &fine, &["3 starts"]);
    refused(&[], &with(|t| t.duration_us = 0), &fine, &["duration is 0"]);
    refused(&[], &with(|t| t.camera.width = 4), &fine, &["outside 4x6"]);
}

#[test]
fn a_score_reads_as_a_table() {
    let truth = sparse();
    let text = scored(&changed(&truth, |e| moved(e, 500)), &truth).to_string();
    for words in ["1000 us plain     1.0000", "100 us scaled    0.0000", "500.0", "interior", "voxel"] {
        assert!(text.contains(words), "the table lacks '{words}':\n{text}");
    }
    // What presets promise is marked, and said, where it is among the tolerances.
    let promised = |text: &str| {
        let marked = text.lines().filter(|line| line.contains("scaled *")).map(str::trim_start);
        (
            marked.map(|line| line.split(" scaled").next().unwrap().to_owned()).collect(),
            text.contains("0.1 px"),
        )
    };
    assert_eq!(promised(&text), (vec!["1000 us".to_owned()], true), "{text}");
    let settings = ScoreSettings { tolerances_us: vec![300, 100], ..ScoreSettings::default() };
    let others = score(&truth.events, &truth, &settings).unwrap().to_string();
    assert_eq!(promised(&others), (Vec::<String>::new(), false), "{others}");
}
