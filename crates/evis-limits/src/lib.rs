//! How much memory a file may take, which files are read, and how one is replaced.
//!
//! Every reader makes a [`Budget`] when it is called and takes from it before it allocates what a file asks for, so that
//! a file of a few bytes cannot fill the memory. The limit belongs to the process, as a limit of the operating system
//! does: it changes no result, it refuses files.

use std::borrow::Cow;
use std::fmt;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The limit where nothing is set, bytes: 4 GiB, or half of the machine's memory where that is less.
const DEFAULT_LIMIT: u64 = 4 << 30;

/// The least limit that can be set, bytes.
pub const LEAST_MEMORY_LIMIT: u64 = 1 << 20;

/// 0 until it is set or read.
static LIMIT: AtomicU64 = AtomicU64::new(0);

/// Whether scenes may refer to files outside of their folder.
static ALLOW_OUTSIDE: AtomicBool = AtomicBool::new(false);

/// Whether glTF files may refer to files outside of their folder; not unless it is set.
pub fn allow_outside() -> bool {
    ALLOW_OUTSIDE.load(Ordering::Relaxed)
}

/// Sets [`allow_outside`] for all threads of the process.
pub fn set_allow_outside(allowed: bool) {
    ALLOW_OUTSIDE.store(allowed, Ordering::Relaxed);
}

/// Whether `relative`, looked up in a folder, stays in it; links are not followed.
pub fn stays_inside(relative: &Path) -> bool {
    let mut depth = 0_usize;
    for component in relative.components() {
        match component {
            Component::Normal(_) => depth += 1,
            Component::CurDir => {}
            Component::ParentDir if depth > 0 => depth -= 1,
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => return false,
        }
    }
    true
}

/// The most similar word, where one is similar at all.
pub fn nearest<'w>(word: &str, known: impl Iterator<Item = &'w str>) -> Option<&'w str> {
    // Long strangers are not worth the quadratic comparison.
    if word.len() > 64 {
        return None;
    }
    // Two letters that changed places make short words unlike for Jaro and Winkler.
    let slip =
        |candidate: &str| word.len() > 1 && candidate.len() > 2 && strsim::osa_distance(word, candidate) == 1;
    known
        .map(|candidate| (strsim::jaro_winkler(word, candidate), candidate))
        .filter(|(similarity, candidate)| *similarity > 0.75 || slip(candidate))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate)
}

/// `text` as it may be shown on a terminal: control characters, which names in files may hold and terminals obey, are
/// written as `\\u001b`; line breaks and tabs stay.
pub fn printable(text: &str) -> Cow<'_, str> {
    let obeyed = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    if !text.contains(obeyed) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if obeyed(c) {
            shown.push_str(&format!("\\u{:04x}", u32::from(c)));
        } else {
            shown.push(c);
        }
    }
    Cow::Owned(shown)
}

/// How much memory one use of a file may take, bytes.
pub fn memory_limit() -> u64 {
    match LIMIT.load(Ordering::Relaxed) {
        0 => {
            let limit = machine_memory().map_or(DEFAULT_LIMIT, |bytes| DEFAULT_LIMIT.min(bytes / 2));
            let limit = limit.max(LEAST_MEMORY_LIMIT);
            // Another thread may have set it in between.
            LIMIT.compare_exchange(0, limit, Ordering::Relaxed, Ordering::Relaxed).err().unwrap_or(limit)
        }
        limit => limit,
    }
}

/// Sets how much memory one use of a file may take, for all threads of the process; at least [`LEAST_MEMORY_LIMIT`].
pub fn set_memory_limit(bytes: u64) {
    LIMIT.store(bytes.max(LEAST_MEMORY_LIMIT), Ordering::Relaxed);
}

/// Memory of the machine, or of the group of processes that this one belongs to, in bytes, where the system says it.
pub fn machine_memory() -> Option<u64> {
    let machine = std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("MemTotal:"))?;
        line.split_whitespace().nth(1)?.parse::<u64>().ok()?.checked_mul(1024)
    });
    let group = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
    let group = group.and_then(|text| text.trim().parse::<u64>().ok());
    machine.into_iter().chain(group).min()
}

/// A size in the unit that suits it.
fn size(bytes: u64) -> String {
    match bytes {
        0..=9_999 => format!("{bytes} bytes"),
        10_000..=999_999 => format!("{:.1} kB", bytes as f64 / 1e3),
        1_000_000..=999_999_999 => format!("{:.1} MB", bytes as f64 / 1e6),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
    }
}

/// A file asks for more memory than it may take.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OverLimit {
    what: String,
    bytes: u64,
    taken: u64,
    limit: u64,
}

impl fmt::Display for OverLimit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} would take {} of memory", self.what, size(self.bytes))?;
        if self.taken > 0 {
            write!(f, " beside the {} that it takes already", size(self.taken))?;
        }
        write!(f, ", and a file may take {}; a larger `memory_limit` allows more", size(self.limit))
    }
}

impl std::error::Error for OverLimit {}

impl From<OverLimit> for String {
    fn from(error: OverLimit) -> Self {
        error.to_string()
    }
}

impl From<OverLimit> for io::Error {
    fn from(error: OverLimit) -> Self {
        Self::new(io::ErrorKind::OutOfMemory, error)
    }
}

/// What one use of a file may still allocate.
#[derive(Debug)]
pub struct Budget {
    limit: u64,
    taken: AtomicU64,
}

impl Default for Budget {
    fn default() -> Self {
        Self::of(memory_limit())
    }
}

impl Budget {
    /// A budget of so many bytes.
    pub const fn of(bytes: u64) -> Self {
        Self { limit: bytes, taken: AtomicU64::new(0) }
    }

    /// Bytes that are left.
    pub fn left(&self) -> u64 {
        self.limit.saturating_sub(self.taken.load(Ordering::Relaxed))
    }

    /// Counts `bytes` that `what` is about to allocate.
    ///
    /// # Errors
    /// More than what is left; nothing is counted then.
    pub fn take(&self, bytes: u64, what: &(impl fmt::Display + ?Sized)) -> Result<(), OverLimit> {
        let add = |taken: u64| taken.checked_add(bytes).filter(|sum| *sum <= self.limit);
        match self.taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add) {
            Ok(_) => Ok(()),
            Err(taken) => Err(self.refusal(bytes, taken, what)),
        }
    }

    /// Gives back what [`Budget::take`] counted, once it is freed.
    pub fn give_back(&self, bytes: u64) {
        let less = |taken: u64| Some(taken.saturating_sub(bytes));
        // The closure never refuses.
        let _ = self.taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
    }

    /// As [`Budget::take`], for `count` values of `T`.
    ///
    /// # Errors
    /// As [`Budget::take`].
    pub fn take_values<T>(&self, count: u64, what: &(impl fmt::Display + ?Sized)) -> Result<(), OverLimit> {
        self.take(count.saturating_mul(size_of::<T>() as u64), what)
    }

    /// An empty list with room for `count` values, counted.
    ///
    /// # Errors
    /// As [`Budget::take`], and memory that the system does not give.
    pub fn list<T>(&self, count: usize, what: &(impl fmt::Display + ?Sized)) -> Result<Vec<T>, OverLimit> {
        let bytes = (count as u64).saturating_mul(size_of::<T>() as u64);
        self.take(bytes, what)?;
        let mut list = Vec::new();
        list.try_reserve_exact(count).map_err(|_| self.refusal(bytes, 0, what))?;
        Ok(list)
    }

    fn refusal(&self, bytes: u64, taken: u64, what: &(impl fmt::Display + ?Sized)) -> OverLimit {
        OverLimit { what: what.to_string(), bytes, taken, limit: self.limit }
    }
}

/// Opens a file for reading: a regular one. A device may have no end, and a pipe may never begin.
///
/// # Errors
/// What the system says, and [`io::ErrorKind::InvalidInput`] for a device, a pipe or a socket.
pub fn open_regular(path: &Path) -> io::Result<File> {
    // Before it is opened: opening a pipe waits for its writer. A folder is left to the error that reading it gives.
    check_regular(&std::fs::metadata(path)?)?;
    let file = File::open(path)?;
    check_regular(&file.metadata()?)?;
    Ok(file)
}

/// Whether this is a file that is read; a folder is left to the error that reading it gives.
///
/// # Errors
/// As [`open_regular`].
pub fn check_regular(metadata: &std::fs::Metadata) -> io::Result<()> {
    if metadata.is_file() || metadata.is_dir() {
        return Ok(());
    }
    let what = "it is a device, a pipe or a socket, and only regular files are read";
    Err(io::Error::new(io::ErrorKind::InvalidInput, what))
}

/// Reads a regular file, which takes from `budget`.
///
/// # Errors
/// As [`open_regular`], and a file that is larger than what is left.
pub fn read_file(path: &Path, budget: &Budget) -> io::Result<Vec<u8>> {
    let file = open_regular(path)?;
    let length = file.metadata()?.len();
    let mut bytes = budget.list(usize::try_from(length).unwrap_or(usize::MAX), "the file")?;
    // What grows while it is read is cut off, and its reader then finds it incomplete.
    file.take(length).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads a regular file of text, which takes from `budget`.
///
/// # Errors
/// As [`read_file`], and [`io::ErrorKind::InvalidData`] for bytes that are no UTF-8 text.
pub fn read_text(path: &Path, budget: &Budget) -> io::Result<String> {
    String::from_utf8(read_file(path, budget)?)
        .map_err(|_| io::Error::new(io::ErrorKind::InvalidData, "stream did not contain valid UTF-8"))
}

/// Where a file that is written to `path` ends up: behind a link, what it leads to.
///
/// # Errors
/// What the system says about a link that cannot be followed.
pub fn behind_links(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_path_buf();
    // As many as Linux follows.
    for _ in 0..40 {
        match std::fs::read_link(&path) {
            Ok(target) => path = path.parent().unwrap_or(Path::new("")).join(target),
            Err(_) => return Ok(path),
        }
    }
    Err(io::Error::other("too many links lead from one to the next"))
}

/// A hidden name beside `path` that no other process and thread uses.
pub fn draft_path(path: &Path) -> PathBuf {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(format!(".{}.{}.draft", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed)));
    path.with_file_name(name)
}

/// Writes a file as a whole: beside it first, then in its place, so that whoever reads it meanwhile, and whatever ends this
/// process, leaves the old one or the new one. Links are followed.
///
/// # Errors
/// What the system says; the old file is then as it was.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let place = behind_links(path)?;
    // Such as /dev/stdout, which nothing can replace.
    if std::fs::metadata(&place).is_ok_and(|metadata| !metadata.is_file()) {
        return std::fs::write(&place, bytes);
    }
    let draft = draft_path(&place);
    let written = std::fs::write(&draft, bytes).and_then(|()| std::fs::rename(&draft, &place));
    if written.is_err() {
        // The first error is the one to report; the draft may not even exist.
        let _ = std::fs::remove_file(&draft);
    }
    written
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;

    #[test]
    fn a_budget_counts_what_is_taken() {
        let budget = Budget::of(100);
        assert_eq!(budget.take(60, "a picture"), Ok(()));
        let error = budget.take(41, "a mesh").unwrap_err().to_string();
        let want = "a mesh would take 41 bytes of memory beside the 60 bytes that it takes already, and a file may take 100 \
                    bytes; a larger `memory_limit` allows more";
        assert_eq!(error, want);
        assert_eq!(budget.left(), 40, "what is refused is not counted");
        budget.give_back(60);
        assert!(budget.take_values::<u64>(12, "numbers").is_ok() && budget.left() == 4);
        assert!(budget.take_values::<u64>(u64::MAX, "numbers").is_err());
        assert!(Budget::of(u64::MAX).list::<u64>(usize::MAX / 8, "numbers").is_err(), "more than there is");
    }

    #[test]
    fn the_limit_is_at_most_4_gib_until_it_is_set() {
        assert!((LEAST_MEMORY_LIMIT..=DEFAULT_LIMIT).contains(&memory_limit()));
        set_memory_limit(5 << 30);
        assert_eq!(Budget::default().left(), 5 << 30);
        set_memory_limit(0);
        assert_eq!(memory_limit(), LEAST_MEMORY_LIMIT);
    }

    #[test]
    fn a_terminal_is_sent_no_controls() {
        assert_eq!(printable("two\n\tlines, grün"), "two\n\tlines, grün");
        assert_eq!(printable("a\u{1b}[31mb\u{9b}c\r\u{7}"), "a\\u001b[31mb\\u009bc\\u000d\\u0007");
    }

    #[test]
    fn paths_that_leave_a_folder_are_known() {
        for inside in ["a.bin", "./a", "sub/../a", "a/b/../../c", ""] {
            assert!(stays_inside(Path::new(inside)), "{inside}");
        }
        for outside in ["../a", "a/../../b", "/etc/passwd", ".."] {
            assert!(!stays_inside(Path::new(outside)), "{outside}");
        }
    }

    #[test]
    fn a_file_is_replaced_as_a_whole_behind_links() {
        let folder = std::env::temp_dir().join(format!("evis-limits-whole-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (file, link) = (folder.join("file"), folder.join("link"));
        write_whole(&file, b"old").unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink("file", &link).unwrap();
        #[cfg(not(unix))]
        std::fs::copy(&file, &link).unwrap();
        write_whole(&link, b"new").unwrap();
        #[cfg(unix)]
        assert!(link.is_symlink() && std::fs::read(&file).unwrap() == b"new");
        assert_eq!(std::fs::read(&link).unwrap(), b"new");
        assert!(write_whole(&folder.join("none/file"), b"").is_err());
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2, "no draft is left");
        assert_ne!(draft_path(&file), draft_path(&file));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn only_regular_files_of_a_size_that_fits_are_read() {
        let path = std::env::temp_dir().join(format!("evis-limits-{}", std::process::id()));
        std::fs::write(&path, b"twelve bytes").unwrap();
        assert_eq!(read_text(&path, &Budget::of(12)).unwrap(), "twelve bytes");
        let error = read_file(&path, &Budget::of(11)).unwrap_err();
        assert!(error.to_string().contains("12 bytes"), "{error}");
        std::fs::remove_file(&path).unwrap();
        assert_eq!(read_file(&path, &Budget::default()).unwrap_err().kind(), io::ErrorKind::NotFound);
        #[cfg(unix)]
        {
            let error = read_file(Path::new("/dev/zero"), &Budget::default()).unwrap_err();
            assert!(error.to_string().contains("only regular files"), "{error}");
            assert!(read_file(&std::env::temp_dir(), &Budget::default()).is_err());
        }
    }
}
