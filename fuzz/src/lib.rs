//! The targets of `cargo fuzz`; `targets.rs` says what they read.

pub mod targets;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

#[doc(hidden)]
pub use libfuzzer_sys;
use targets::{TARGETS, Target};

/// Memory that a file may take, bytes, as in the test of mutants.
const FILE_LIMIT: u64 = 64 << 20;

/// Prepares a target: the limit, a folder of its own, and its first corpus where `fuzz/corpus` has none.
pub fn prepare(name: &str) -> &'static (Target, PathBuf) {
    static PREPARED: OnceLock<(Target, PathBuf)> = OnceLock::new();
    PREPARED.get_or_init(|| {
        // Decoders of other authors panic at what they take for impossible, which readers catch; libFuzzer's hook would end
        // the process. A panic that leaves the target still does.
        drop(std::panic::take_hook());
        evis_core::limits::set_memory_limit(FILE_LIMIT);
        let target = TARGETS.into_iter().find(|target| target.name == name).expect("a target");
        let folder = std::env::temp_dir().join(format!("evis-fuzz-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder for what is read");
        let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(name);
        if std::fs::create_dir_all(&corpus).is_ok() {
            for (number, seed) in (target.seeds)(&folder).iter().enumerate() {
                let path = corpus.join(format!("seed-{number}"));
                if !path.exists() {
                    let _ = std::fs::write(path, seed);
                }
            }
        }
        (target, folder)
    })
}

/// The program of one target.
#[macro_export]
macro_rules! fuzz {
    ($name:literal) => {
        $crate::libfuzzer_sys::fuzz_target!(
            init: {
                $crate::prepare($name);
            },
            |bytes: &[u8]| {
                let (target, folder) = $crate::prepare($name);
                (target.read)(folder, bytes);
            }
        );
    };
}
