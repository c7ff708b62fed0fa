//! `--trace FILE`: spans as a Chrome trace, which Perfetto and `chrome://tracing` open.
//!
//! A subscriber of its own rather than `tracing-chrome`: passes on the device come with times of their own, which that
//! layer cannot place, and it would bring eight packages.

use std::cell::Cell;
use std::collections::HashMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use anyhow::Context as _;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Metadata, Subscriber};

use crate::failure::bad_input;

/// Track of passes on the device; threads have tracks from 1 on.
const DEVICE_TRACK: u64 = 0;

/// Spans of the project are recorded, and those of no other package.
const PREFIX: &str = "evis";

static NEXT_THREAD: AtomicU64 = AtomicU64::new(1);

thread_local! {
    /// Track of this thread; 0 before its first span.
    static TRACK: Cell<u64> = const { Cell::new(0) };
}

/// A trace being written. [`Trace::finish`] completes the file; a run that fails before removes it.
pub(crate) struct Trace {
    path: PathBuf,
    shared: Arc<Shared>,
}

struct Shared {
    start: Instant,
    state: Mutex<State>,
}

struct State {
    out: BufWriter<File>,
    open: HashMap<u64, Span>,
    next_span: u64,
    /// Set once the file is complete: the subscriber outlives it, for a process has one.
    closed: bool,
    /// The first failure to write; the rest is not written.
    failed: Option<std::io::Error>,
}

/// A span that is open.
struct Span {
    name: String,
    arguments: String,
    references: usize,
    entered_us: f64,
}

impl Trace {
    /// Starts a trace in `path`, where one is asked for. It ends with the process, as `tracing` has one subscriber for it.
    ///
    /// # Errors
    /// The file cannot be made, or the process has a subscriber already.
    pub(crate) fn start(path: Option<&Path>) -> anyhow::Result<Option<Self>> {
        let Some(path) = path else { return Ok(None) };
        if tracing::dispatcher::has_been_set() {
            return Err(bad_input("--trace needs a process of its own: this one records spans already"));
        }
        let trace = Self::create(path)?;
        tracing::subscriber::set_global_default(Recorder(trace.shared.clone()))
            .context("--trace needs a process of its own")?;
        Ok(Some(trace))
    }

    fn create(path: &Path) -> anyhow::Result<Self> {
        let file = File::create(path).with_context(|| format!("cannot write {}", path.display()))?;
        let mut out = BufWriter::new(file);
        // The array is left open until the end: readers of the format allow that.
        write!(
            out,
            "[\n{{\"ph\":\"M\",\"name\":\"thread_name\",\"pid\":1,\"tid\":{DEVICE_TRACK},\"args\":{{\"name\":\"device\"}}}}"
        )?;
        let state = State { out, open: HashMap::new(), next_span: 0, closed: false, failed: None };
        let shared = Arc::new(Shared { start: Instant::now(), state: Mutex::new(state) });
        Ok(Self { path: path.to_owned(), shared })
    }

    /// Completes the file.
    ///
    /// # Errors
    /// Something of it could not be written.
    pub(crate) fn finish(self) -> anyhow::Result<()> {
        self.close()
    }

    fn close(&self) -> anyhow::Result<()> {
        let mut state = self.shared.state();
        if std::mem::replace(&mut state.closed, true) {
            return Ok(());
        }
        let written = match state.failed.take() {
            Some(error) => Err(error),
            None => writeln!(state.out, "\n]").and_then(|()| state.out.flush()),
        };
        written.with_context(|| format!("cannot write {}", self.path.display()))
    }
}

impl Drop for Trace {
    fn drop(&mut self) {
        // A run that fails has another error to tell, and leaves nothing behind.
        if !self.shared.state().closed {
            let _ = self.close();
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

impl Shared {
    fn now_us(&self) -> f64 {
        self.start.elapsed().as_nanos() as f64 * 1e-3
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    fn write(&mut self, text: &str) {
        if !self.closed
            && self.failed.is_none()
            && let Err(error) = self.out.write_all(text.as_bytes())
        {
            self.failed = Some(error);
        }
    }

    /// A stretch of time on a track. Nothing is written once the file is complete.
    fn complete(&mut self, track: u64, name: &str, start_us: f64, length_us: f64, arguments: &str) {
        self.write(&format!(
            ",\n{{\"ph\":\"X\",\"name\":{},\"pid\":1,\"tid\":{track},\"ts\":{start_us:.3},\"dur\":{length_us:.3},\
             \"args\":{{{arguments}}}}}",
            quoted(name)
        ));
    }
}

/// The track of this thread.
fn track(state: &mut State) -> u64 {
    TRACK.with(|track| {
        if track.get() == 0 {
            track.set(NEXT_THREAD.fetch_add(1, Ordering::Relaxed));
            let name = std::thread::current()
                .name()
                .map_or_else(|| format!("thread {}", track.get()), str::to_owned);
            state.write(&format!(
                ",\n{{\"ph\":\"M\",\"name\":\"thread_name\",\"pid\":1,\"tid\":{},\"args\":{{\"name\":{}}}}}",
                track.get(),
                quoted(&name)
            ));
        }
        track.get()
    })
}

/// `text` as a JSON string.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

/// Fields of a span or an event.
#[derive(Default)]
struct Fields {
    /// The field `pass`: the name of the pass that a span records.
    pass: Option<String>,
    /// Where the pass ran on the device, in nanoseconds before now.
    ago_ns: Option<u64>,
    length_ns: Option<u64>,
    /// The others, as members of a JSON object.
    others: String,
}

impl Fields {
    fn add(&mut self, name: &str, value: &str) {
        let comma = if self.others.is_empty() { "" } else { "," };
        let _ = write!(self.others, "{comma}{}:{value}", quoted(name));
    }
}

impl Visit for Fields {
    fn record_u64(&mut self, field: &Field, value: u64) {
        match field.name() {
            "ago_ns" => self.ago_ns = Some(value),
            "length_ns" => self.length_ns = Some(value),
            name => self.add(name, &value.to_string()),
        }
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.add(field.name(), &value.to_string());
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        if field.name() == "pass" {
            self.pass = Some(value.to_owned());
        } else {
            self.add(field.name(), &quoted(value));
        }
    }

    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        self.add(field.name(), &quoted(&format!("{value:?}")));
    }
}

/// What writes the spans.
struct Recorder(Arc<Shared>);

impl Subscriber for Recorder {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target().starts_with(PREFIX)
    }

    fn new_span(&self, attributes: &Attributes<'_>) -> Id {
        let mut fields = Fields::default();
        attributes.record(&mut fields);
        let name = fields.pass.unwrap_or_else(|| attributes.metadata().name().to_owned());
        let mut state = self.0.state();
        state.next_span += 1;
        let id = state.next_span;
        state.open.insert(id, Span { name, arguments: fields.others, references: 1, entered_us: 0.0 });
        Id::from_u64(id)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn event(&self, event: &Event<'_>) {
        let mut fields = Fields::default();
        event.record(&mut fields);
        // Warnings and the like are no stretch of time.
        let (Some(pass), Some(ago_ns), Some(length_ns)) = (fields.pass, fields.ago_ns, fields.length_ns)
        else {
            return;
        };
        let start_us = (self.0.now_us() - ago_ns as f64 * 1e-3).max(0.0);
        self.0.state().complete(DEVICE_TRACK, &pass, start_us, length_ns as f64 * 1e-3, &fields.others);
    }

    fn enter(&self, id: &Id) {
        let now_us = self.0.now_us();
        if let Some(span) = self.0.state().open.get_mut(&id.into_u64()) {
            span.entered_us = now_us;
        }
    }

    fn exit(&self, id: &Id) {
        let now_us = self.0.now_us();
        let mut state = self.0.state();
        let track = track(&mut state);
        // Out of the map while it is written, which needs the whole state.
        if let Some(span) = state.open.remove(&id.into_u64()) {
            let length_us = now_us - span.entered_us;
            state.complete(track, &span.name, span.entered_us, length_us, &span.arguments);
            state.open.insert(id.into_u64(), span);
        }
    }

    fn clone_span(&self, id: &Id) -> Id {
        if let Some(span) = self.0.state().open.get_mut(&id.into_u64()) {
            span.references += 1;
        }
        id.clone()
    }

    fn try_close(&self, id: Id) -> bool {
        let mut state = self.0.state();
        let Some(span) = state.open.get_mut(&id.into_u64()) else { return false };
        span.references -= 1;
        let closes = span.references == 0;
        if closes {
            state.open.remove(&id.into_u64());
        }
        closes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a trace holds after `work`.
    fn traced(name: &str, work: impl FnOnce()) -> Vec<serde_json::Value> {
        let path = std::env::temp_dir().join(format!("evis-trace-{name}-{}.json", std::process::id()));
        let trace = Trace::create(&path).unwrap();
        tracing::subscriber::with_default(Recorder(trace.shared.clone()), work);
        trace.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        serde_json::from_str(&text).unwrap()
    }

    fn named<'a>(entries: &'a [serde_json::Value], name: &str) -> &'a serde_json::Value {
        entries.iter().find(|entry| entry["name"] == name).unwrap_or_else(|| panic!("{name} in {entries:?}"))
    }

    #[test]
    fn spans_are_stretches_of_time_that_nest() {
        let entries = traced("nest", || {
            let _outer = tracing::trace_span!("outer", instants = 7_u32).entered();
            tracing::trace_span!("pass", pass = "a \"b\".wgsl")
                .in_scope(|| std::thread::sleep(std::time::Duration::from_millis(2)));
            tracing::trace_span!(target: "wgpu", "foreign").in_scope(|| ());
            tracing::info!("no stretch of time");
        });
        let (outer, inner) = (named(&entries, "outer"), named(&entries, "a \"b\".wgsl"));
        assert_eq!(outer["args"]["instants"], 7);
        assert_eq!(outer["tid"], inner["tid"]);
        let times = |entry: &serde_json::Value| {
            let [start, length] = ["ts", "dur"].map(|key| entry[key].as_f64().unwrap());
            (start, start + length)
        };
        assert!(times(outer).0 <= times(inner).0 && times(inner).1 <= times(outer).1, "{entries:?}");
        assert!(times(inner).1 - times(inner).0 >= 2000.0, "{inner}");
        // Names of the device's and of this thread's track, and the two spans.
        assert_eq!(entries.len(), 4, "{entries:?}");
    }

    #[test]
    fn passes_on_the_device_have_their_own_track_and_times() {
        let entries = traced("device", || {
            std::thread::sleep(std::time::Duration::from_millis(3));
            let (ago_ns, length_ns) = (1_000_000_u64, 500_000_u64);
            tracing::trace!(target: "evis_render::device", pass = "luminance", ago_ns, length_ns);
        });
        let pass = named(&entries, "luminance");
        assert_eq!(pass["tid"], DEVICE_TRACK);
        assert_eq!(pass["dur"], 500.0);
        assert!(pass["ts"].as_f64().unwrap() >= 2000.0, "{pass}");
    }
}
