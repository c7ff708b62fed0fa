//! What every reader promises of events.

use evis_core::event::MOST_T_US;
use evis_core::format::EventFile;

pub fn check(file: &EventFile) {
    let (width, height) = file.size;
    assert!(file.events.is_sorted_by_key(|e| e.t));
    for e in &file.events {
        assert!(u32::from(e.x) < width && u32::from(e.y) < height && (0..=1).contains(&e.p), "{e:?}");
        assert!((-MOST_T_US..=MOST_T_US).contains(&e.t), "{e:?}");
    }
}
