//! Rust errors become Python exceptions, each in exactly one place.

use pyo3::exceptions::{PyFileExistsError, PyOSError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyTuple, PyType};

use evis_core::ConfigError;
use evis_core::format::FormatError;
use evis_render::EngineError;
use evis_scene::SceneError;

/// What failed, by the exception that says so.
#[derive(Debug)]
pub(crate) enum Failure {
    /// `EvisError`: a panic, or a simulator used in a way that it forbids.
    Engine(String),
    /// `ConfigError`.
    Config(String),
    /// `FormatError`.
    Format(String),
    /// `DeviceError`.
    Device(String),
    /// `FileExistsError`.
    Exists(String),
    /// `OSError`; Python picks the subclass by the error number.
    Io { path: Option<String>, source: std::io::Error },
}

impl From<ConfigError> for Failure {
    fn from(error: ConfigError) -> Self {
        Self::Config(error.to_string())
    }
}

impl From<SceneError> for Failure {
    fn from(error: SceneError) -> Self {
        match error {
            SceneError::Io { path, source } => Self::Io { path: Some(path.display().to_string()), source },
            SceneError::Invalid { .. } => Self::Format(error.to_string()),
            SceneError::Rule(_) | SceneError::Unknown { .. } => Self::Config(error.to_string()),
        }
    }
}

impl From<FormatError> for Failure {
    fn from(error: FormatError) -> Self {
        let path = Some(error.path().display().to_string());
        match error {
            FormatError::Io { source, .. } => Self::Io { path, source },
            FormatError::Lost { source, .. } => Self::Io { path, source },
            FormatError::Exists { .. } => Self::Exists(error.to_string()),
            _ => Self::Format(error.to_string()),
        }
    }
}

impl From<EngineError> for Failure {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Config(error) => error.into(),
            EngineError::Scene(error) => error.into(),
            EngineError::Format(error) => error.into(),
            EngineError::NoDevice => Self::Device(error.to_string()),
            EngineError::Device(message) => Self::Device(message),
            EngineError::Read { path, source } | EngineError::Write { path, source } => {
                Self::Io { path: Some(path.display().to_string()), source }
            }
            EngineError::Stopped => Self::Engine(error.to_string()),
        }
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        Python::attach(|py| match failure {
            Failure::Engine(message) => raise(py, &EVIS_ERROR, message),
            Failure::Config(message) => raise(py, &CONFIG_ERROR, message),
            Failure::Format(message) => raise(py, &FORMAT_ERROR, message),
            Failure::Device(message) => raise(py, &DEVICE_ERROR, message),
            Failure::Exists(message) => PyFileExistsError::new_err(shown(&message)),
            Failure::Io { path, source } => match (source.raw_os_error(), path) {
                (Some(code), Some(path)) => PyOSError::new_err((code, reason(&source), path)),
                (Some(code), None) => PyOSError::new_err((code, reason(&source))),
                (None, Some(path)) => PyOSError::new_err(shown(&format!("{path}: {source}"))),
                (None, None) => PyOSError::new_err(shown(&source.to_string())),
            },
        })
    }
}

/// Settings that are no keyword of what was called by that name, and how Python sets them.
const SETTINGS: [(&str, &str); 3] = [
    ("`overwrite`", "overwrite=True"),
    ("`memory_limit`", "limit, evis.set_limits(memory=...),"),
    ("`allow_outside`", "evis.set_limits(allow_outside=True)"),
];

/// `message` with Python's words for settings.
fn in_python(message: &str) -> String {
    SETTINGS.iter().fold(message.to_owned(), |message, (name, words)| message.replace(name, words))
}

/// The same as it may be shown: Python prints messages as they are, and names in files may hold what a terminal obeys.
fn shown(message: &str) -> String {
    evis_core::limits::printable(&in_python(message)).into_owned()
}

/// The system's words without Rust's "(os error N)", which Python adds in its own way.
fn reason(error: &std::io::Error) -> String {
    let text = error.to_string();
    text.split(" (os error").next().unwrap_or(&text).to_owned()
}

// `create_exception!` gives one base class; the subclasses of ours also are `ValueError` or
// `RuntimeError`, so that code which knows nothing of EVIS catches them too.
static EVIS_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static CONFIG_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static FORMAT_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();
static DEVICE_ERROR: PyOnceLock<Py<PyType>> = PyOnceLock::new();

fn raise(py: Python<'_>, class: &PyOnceLock<Py<PyType>>, message: String) -> PyErr {
    let message = shown(&message);
    match class.get(py) {
        Some(class) => PyErr::from_type(class.bind(py).clone(), (message,)),
        // Only before the module is initialised.
        None => PyRuntimeError::new_err(message),
    }
}

/// Makes the exception classes and adds them to `module`.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    let exception = py.get_type::<pyo3::exceptions::PyException>();
    let value_error = py.get_type::<PyValueError>();
    let runtime_error = py.get_type::<PyRuntimeError>();
    // Messages of what Python itself raises hold names from files, too.
    let printed = py
        .eval(c"lambda printable, plain: lambda self: printable(plain(self))", None, None)?
        .call1((module.getattr("printable")?, exception.getattr("__str__")?))?;
    let evis_error = class(
        module,
        &EVIS_ERROR,
        "EvisError",
        &[exception],
        "Base of every error that EVIS raises, except OSError for files.",
        Some(printed),
    )?;
    class(
        module,
        &CONFIG_ERROR,
        "ConfigError",
        &[evis_error.clone(), value_error.clone()],
        "A setting cannot be used; the message names it, its value, and what would work.",
        None,
    )?;
    class(
        module,
        &FORMAT_ERROR,
        "FormatError",
        &[evis_error.clone(), value_error],
        "A file or text was read, and its content is not usable.",
        None,
    )?;
    class(
        module,
        &DEVICE_ERROR,
        "DeviceError",
        &[evis_error, runtime_error],
        "No usable graphics device, or the device failed.",
        None,
    )?;
    Ok(())
}

fn class<'py>(
    module: &Bound<'py, PyModule>,
    slot: &PyOnceLock<Py<PyType>>,
    name: &str,
    bases: &[Bound<'py, PyType>],
    doc: &str,
    to_str: Option<Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyType>> {
    let py = module.py();
    let namespace = PyDict::new(py);
    namespace.set_item("__doc__", doc)?;
    // Users import the classes from `evis`, and pickles should too.
    namespace.set_item("__module__", "evis")?;
    if let Some(to_str) = to_str {
        namespace.set_item("__str__", to_str)?;
    }
    let made = py.get_type::<PyType>().call1((name, PyTuple::new(py, bases)?, namespace))?;
    let made = made.cast_into::<PyType>()?;
    let kept = slot.get_or_init(py, || made.clone().unbind());
    module.add(name, kept.bind(py))?;
    Ok(kept.bind(py).clone())
}
