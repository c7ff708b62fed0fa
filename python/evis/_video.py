"""Films, folders of pictures and arrays of frames become events."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from . import _check, _evis, _io
from ._evis import ConfigError
from ._progress import Progress, TimeLeft
from ._sensor import Sensor, sensor_of

if TYPE_CHECKING:
    from .flow import Upsampler


def _ffmpeg() -> str | None:
    """Name the ffmpeg of the extra `video`, where no other is named; None: the one on PATH."""
    if not os.environ.get("EVIS_FFMPEG"):
        with contextlib.suppress(ImportError, RuntimeError):
            import imageio_ffmpeg

            return str(imageio_ffmpeg.get_ffmpeg_exe())
    return None


def _wanted(
    source: str | PathLike[str],
    transfer: str | None,
    fps: float | None,
    timestamps: str | PathLike[str] | None,
    size: tuple[int, int] | None,
    start: float,
    duration: float | None,
) -> dict[str, Any]:
    return {
        "path": Path(source),
        "transfer": None if transfer is None else str(transfer),
        "fps": _check.number_or_none("fps", fps),
        "timestamps": None if timestamps is None else Path(timestamps),
        "size": None if size is None else _check.size(size, 65536),
        "start_us": _check.micros("start", start),
        "duration_us": None if duration is None else _check.duration_us("duration", duration),
        "ffmpeg": _ffmpeg(),
    }


@dataclass(frozen=True, kw_only=True, slots=True)
class VideoReport:
    """What `video` did.

    Attributes
    ----------
    output, input : Path
        The recording, and what was read.
    kind : {"film", "folder", "stack"}
        What that was.
    width, height : int
        Pixels of the sensor.
    frames : int
        Frames that were used.
    between : int
        Frames that were put between them.
    offset_us : int
        Time of the first one, as the source counts it, in microseconds; the recording starts at 0.
    stream_s, wall_s : float
        From the first frame to the last, and of work, in seconds.
    events, on, off : int
        Events written.
    unknown : int
        Pixel values that were NaN: those pixels kept their state.
    clamped, suppressed, dropped : int
        See `EmulatorReport`.
    transfer : str
        Curve of integer frames.
    warnings : tuple of str
        What was probably not meant, and what ffmpeg complained about.
    """

    output: Path
    input: Path
    kind: Literal["film", "folder", "stack"]
    width: int
    height: int
    frames: int
    between: int
    offset_us: int
    stream_s: float
    wall_s: float
    events: int
    on: int
    off: int
    unknown: int
    clamped: int
    suppressed: int
    dropped: int
    transfer: str
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class VideoProgress:
    """How far `video` has come.

    Attributes
    ----------
    t_us : int
        Microseconds after the first frame that are converted.
    duration_us : int, optional
        Microseconds in all; None where the source does not say.
    events : int
        Events so far.
    elapsed_s : float
        Seconds of work.
    left_s : float, optional
        Seconds left by what was measured so far; it never rises. None where nothing is known.
    """

    t_us: int
    duration_us: int | None
    events: int
    elapsed_s: float
    left_s: float | None


def video(
    source: str | PathLike[str],
    output: str | PathLike[str],
    *,
    sensor: Sensor | str | None = None,
    seed: int = 0,
    transfer: str | None = None,
    fps: float | None = None,
    timestamps: str | PathLike[str] | None = None,
    size: tuple[int, int] | None = None,
    start: float = 0.0,
    duration: float | None = None,
    upsampler: Upsampler | None = None,
    reference_luminance: float = 1.0,
    overwrite: bool = False,
    progress: bool | Callable[[VideoProgress], object] = False,
) -> VideoReport:
    """Turn a film, a folder of pictures or an array of frames into a recording.

    Memory does not grow with the length. Ctrl-C leaves a whole file. The GIL is released.

    Parameters
    ----------
    source : path
        A film that ffmpeg plays (of the extra ``evis[video]``, or the one on PATH); a folder of PNG, TIFF,
        EXR or JPEG pictures, in the order of the numbers in their names; a ``.npy`` file of shape (T, H, W)
        or (T, H, W, 3), uint8, uint16 or float32.
    output : path
        The recording, ``.h5`` or ``.hdf5``.
    sensor : Sensor or str, optional
        The sensor, or the name of a preset or TOML file; an ideal one if not given.
    seed : int
        Seed of everything random.
    transfer : str, optional
        Curve of integer values: ``"srgb"``, ``"rec709"``, ``"gamma:2.2"`` (any number), ``"linear"``. If not
        given, Rec. 709 for films and sRGB for the rest. float32 is linear light. ``"linear"`` imitates v2e,
        vid2e and OpenEB, which take stored values for light.
    fps : float, optional
        Frames per second, whatever the source says. A film has times of its own (variable ones are kept), a
        folder has them in its ``timestamps.txt``.
    timestamps : path, optional
        A text file of times, one per frame and line: seconds with a decimal point, or below a line
        ``# unit: us`` (s, ms, ns) that unit. With ``name time``, the names choose a folder's pictures.
    size : (int, int), optional
        Width and height of the sensor; frames are averaged to it in linear light.
    start, duration : float
        Seconds after the first frame to begin at, and to convert; all if not given.
    upsampler : evis.flow.Upsampler, optional
        Puts frames between frames, by optical flow or by a network; none if not given.
    reference_luminance : float
        Y_ref of the sensor's formula; white of integer frames is 1.
    overwrite : bool
        Replace a file that exists.
    progress : bool or callable
        True shows a bar with the time left on standard error, or a line every ten seconds where that is no
        terminal. A callable is given a `VideoProgress`, ten times per second at most.

    Raises
    ------
    ConfigError
        If a setting cannot be used, or there is no ffmpeg; the message says how to get one.
    FormatError
        If a frame cannot be read, has another size, or a time that does not come after the one before it; the
        message names the frame. What was written before stays readable.
    OSError
        If a file cannot be read or written.

    Examples
    --------
    >>> import numpy as np, tempfile, pathlib
    >>> import evis
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> frames = np.linspace(0.2, 0.8, 10, dtype=np.float32)[:, None, None] * np.ones((10, 4, 6), np.float32)
    >>> np.save(folder / "in.npy", frames)
    >>> report = evis.video(folder / "in.npy", folder / "out.h5", fps=100)
    >>> report.frames, report.events, evis.load(folder / "out.h5").events.p.min()
    (10, 144, np.int16(1))
    """
    if Path(output).suffix.lower() not in (".h5", ".hdf5"):
        raise ConfigError(f"output ends with '{Path(output).suffix}'; it must end with .h5 or .hdf5")
    # Arrays of frames are .npy files as well.
    held_format = _evis.recognise_format(Path(source)) if Path(source).is_file() else None
    if held_format not in (None, "npy"):
        raise ConfigError(
            f"source is {Path(source)}, which holds events or labels ({_io.formats()[held_format]}); it must "
            "be a film, a folder of pictures or an array of frames (evis.load reads events)"
        )
    sensor = sensor_of(sensor)
    sensor.check()
    began, left = time.monotonic(), TimeLeft()
    bar: Progress | None = None

    def on_progress(t_us: int, duration_us: int, events: int) -> None:
        nonlocal bar
        if progress is True:
            bar = bar or Progress(duration_us, "us of frames")
            bar.reach(t_us)
        elif callable(progress):
            elapsed_s = time.monotonic() - began
            left_s = left.after(elapsed_s, t_us / duration_us) if duration_us else None
            progress(VideoProgress(t_us, duration_us or None, events, elapsed_s, left_s))

    text = _evis.convert_video(
        _wanted(source, transfer, fps, timestamps, size, start, duration),
        Path(output),
        sensor=sensor._json(),
        seed=_check.whole("seed", seed, 0, 2**63 - 1),
        reference_luminance=_check.number("reference_luminance", reference_luminance),
        upsampler=upsampler,
        overwrite=overwrite,
        progress=on_progress if progress else None,
    )
    if bar is not None:
        bar.close()
    held = json.loads(text)
    # Interrupted, this function has raised KeyboardInterrupt.
    del held["interrupted"]
    held["output"], held["input"] = Path(held["output"]), Path(held["input"])
    held["warnings"] = tuple(held["warnings"])
    return VideoReport(**held)


class Frames(Iterator[tuple[int, npt.NDArray[Any]]]):
    """Frames of a source, one after the other: (microseconds, array); made by `frames`."""

    __slots__ = ("_reader",)

    def __init__(self, reader: _evis.FrameReader) -> None:
        self._reader = reader

    def __iter__(self) -> Frames:
        """Return itself."""
        return self

    def __next__(self) -> tuple[int, npt.NDArray[Any]]:
        """Read a frame."""
        read = self._reader.next()
        if read is None:
            raise StopIteration
        t_us, values, height, width, channels = read
        shape = (height, width) if channels == 1 else (height, width, channels)
        return t_us, np.reshape(values, shape)

    @property
    def kind(self) -> str:
        """What is read: ``"film"``, ``"folder"`` or ``"stack"``."""
        return self._reader.about()[0]

    @property
    def transfer(self) -> str:
        """Curve of integer frames."""
        return self._reader.about()[1]

    @property
    def offset_us(self) -> int:
        """Time of the first frame that was read, as the source counts it."""
        return self._reader.about()[2]

    @property
    def warnings(self) -> list[str]:
        """What was probably not meant so far."""
        return self._reader.about()[3]


def frames(
    source: str | PathLike[str],
    *,
    transfer: str | None = None,
    fps: float | None = None,
    timestamps: str | PathLike[str] | None = None,
    size: tuple[int, int] | None = None,
    start: float = 0.0,
    duration: float | None = None,
) -> Frames:
    """Read frames as arrays, for `EventEmulator` or anything else.

    Parameters are those of `video`.

    Returns
    -------
    Frames
        An iterator over (t_us, frame): int, microseconds after the first frame that is used; uint8, uint16 or
        float32 (H, W) or (H, W, 3). Frames brought to another ``size`` are float32 linear light.

    Raises
    ------
    ConfigError, FormatError, OSError
        As `video`; reading a frame may raise too.
    """
    return Frames(_evis.FrameReader(_wanted(source, transfer, fps, timestamps, size, start, duration)))
