"""Recordings in the viewer Rerun: events, frames, depth, flow, camera and poses on one timeline.

Needs rerun-sdk: ``pip install 'evis[view]'``. `view` opens the viewer, or writes a file for it,
which needs no display; `log` adds to a recording of your own. docs/view.md lists what is logged where.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check
from ._events import EventArray
from ._evis import MOST_T_US, ConfigError
from ._files import RecordedLabels, RecordedView, Recording, load, recording_of
from ._pictures import (
    DARK_OFF,
    DARK_ON,
    flow_of,
    full_speed,
    last_polarity,
    reference_of,
    tone_mapped,
)
from ._progress import Progress

__all__ = ["TIMELINE", "log", "view"]

Source: TypeAlias = "Recording | EventArray | str | PathLike[str]"

TIMELINE = "time"
"""The timeline: how long after the stream's start."""

_MOST_WINDOWS = 1_000_000
_FRAMES = ("frame", "hdr")
_FLOWS = ("flow_forward", "flow_backward")
_IDS = ("instance", "semantic")


def _rerun() -> Any:
    try:
        import rerun
    except ImportError as error:
        raise ConfigError("recordings are not shown without rerun-sdk; pip install 'evis[view]'") from error
    return rerun


def _opened(source: Source, camera: str | None) -> Recording:
    if isinstance(source, Recording):
        return source
    if isinstance(source, EventArray):
        return recording_of(source)
    if isinstance(source, (str, PathLike)):
        return load(source, camera=camera)
    raise ConfigError(
        f"source is {_check.shown(source)}; it must be an evis.Recording, an evis.EventArray or the path of "
        "a file"
    )


class _Log:
    """Where rows go, and how many went there."""

    def __init__(self, stream: Any, limits: tuple[int, int]) -> None:
        self.rr = _rerun()
        self.stream = stream
        self.limits = limits
        self.rows: dict[str, int] = {}

    def path(self, *parts: str) -> str:
        """Return an entity's path; parts may hold any characters."""
        return str(self.rr.new_entity_path(list(parts)))

    def always(self, path: str, *what: Any) -> None:
        """Log what holds at all times."""
        self.stream.log(path, *what, static=True)

    def columns(self, path: str, t_us: npt.ArrayLike, columns: Any) -> None:
        """Log a row for each time."""
        times = np.asarray(t_us, "timedelta64[us]")
        self.rr.send_columns(
            path, [self.rr.TimeColumn(TIMELINE, duration=times)], columns, recording=self.stream
        )
        self.rows[path] = self.rows.get(path, 0) + len(times)

    def image(self, path: str, t_us: int, archetype: Any, image: npt.NDArray[Any]) -> None:
        """Log one image: (H, W) or (H, W, 3), of the kind that ``archetype`` is."""
        rr = self.rr
        format = rr.components.ImageFormat(
            width=image.shape[1],
            height=image.shape[0],
            color_model=rr.ColorModel.RGB if image.ndim == 3 else rr.ColorModel.L,
            channel_datatype=rr.ChannelDatatype.from_np_dtype(image.dtype),
        )
        buffer = np.ascontiguousarray(image).view(np.uint8).reshape(1, -1)
        self.columns(path, [t_us], archetype.columns(buffer=buffer, format=[format]))

    def within(self, t_us: npt.NDArray[np.int64]) -> npt.NDArray[np.intp]:
        """Return the indices of the times that are asked for."""
        return np.flatnonzero((t_us >= self.limits[0]) & (t_us < self.limits[1]))


def _windows(events: EventArray, limits: tuple[int, int], window_us: int) -> npt.NDArray[np.int64]:
    """Return the edges of windows, from the first event's to the last one's; none without events."""
    if not len(events):
        return np.empty(0, np.int64)
    # Windows are counted from the part's start, or from 0, so that the first event does not move them.
    anchor = limits[0] if limits[0] > -_check.MOST_US else 0
    first, last = ((int(events.t[at]) - anchor) // window_us for at in (0, -1))
    count = last - first + 1
    if count > _MOST_WINDOWS:
        raise ConfigError(
            f"window_us is {window_us}: the events span {count} windows; choose a longer window, or a part "
            f"of the recording (at most {_MOST_WINDOWS} windows)"
        )
    edges = anchor + window_us * np.arange(first, first + count + 1, dtype=np.int64)
    return np.minimum(edges, limits[1])


def _log_events(log: _Log, view: RecordedView, image: str, rates: str, window_us: int, shown: bool) -> None:
    """Log pictures of windows, each at the window's end, and the rates of both polarities."""
    rr = log.rr
    events = view.slice_time(*log.limits)
    edges = _windows(events, log.limits, window_us)
    if not len(edges):
        return
    colors = [(1, "OFF", DARK_OFF), (2, "ON", DARK_ON)]
    log.always(image, rr.AnnotationContext([(0, "none", (0, 0, 0, 0)), *colors]))
    at = np.searchsorted(events.t, edges)
    array, size = events.to_numpy(), (events.width, events.height)
    filled = np.diff(at) > 0
    # A picture without events is logged where it takes the place of one with events, and not again.
    drawn = np.flatnonzero(filled | np.concatenate([[False], filled[:-1]]))
    with Progress(len(drawn), "windows", shown=shown) as progress:
        for k in drawn.tolist():
            codes = last_polarity(array[at[k] : at[k + 1]], size)
            log.image(image, int(edges[k + 1]), rr.SegmentationImage, codes)
            progress.advance()
    before_on = np.concatenate([[0], np.cumsum(events.p == 1, dtype=np.int64)])[at]
    seconds = np.diff(edges) * 1e-6
    on, all_events = np.diff(before_on), np.diff(at)
    for name, color, count in (("ON", DARK_ON, on), ("OFF", DARK_OFF, all_events - on)):
        path = f"{rates}/{name}"
        log.always(path, rr.SeriesLines(colors=[color], names=[f"{name}, events/s"]))
        log.columns(path, edges[1:], rr.Scalars.columns(scalars=count / seconds))


def _finite_range(labels: RecordedLabels, kept: npt.NDArray[np.intp]) -> tuple[float, float]:
    """Return the least and largest finite depth of about ten images."""
    low, high = np.inf, 0.0
    for index in kept[:: max(1, len(kept) // 10)].tolist():
        depth = labels[index]
        finite = depth[np.isfinite(depth)]
        if finite.size:
            low, high = min(low, float(finite.min())), max(high, float(finite.max()))
    return (low, max(high, 1.001 * low)) if np.isfinite(low) else (1.0, 2.0)


def _log_camera(log: _Log, view: RecordedView, camera: str, image: str, track: str) -> None:
    """Log lens, poses, and the path that they make."""
    rr, lens, depth = log.rr, view.camera, view.labels.get("depth")
    if np.isfinite([lens.fx, lens.fy, lens.cx, lens.cy]).all():
        # Both count from the picture's corner: the first pixel's centre is at 0.5.
        matrix = [[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]]
        size, axes = [lens.width, lens.height], rr.ViewCoordinates.RUB
        log.always(image, rr.Pinhole(image_from_camera=matrix, resolution=size, camera_xyz=axes))
        if depth is not None and len(depth):
            # The frustum ends well before what the camera sees.
            nearest = _finite_range(depth, np.arange(len(depth)))[0]
            log.always(image, rr.Pinhole.from_fields(image_plane_distance=0.4 * nearest))
    poses = view.poses
    kept = log.within(poses.t_us)
    if len(kept):
        where, turned = poses.position[kept], poses.rotation[kept]
        log.columns(camera, poses.t_us[kept], rr.Transform3D.columns(translation=where, quaternion=turned))
        log.always(track, rr.LineStrips3D([where], colors=[(150, 150, 150)]))


def _log_labels(log: _Log, recording: Recording, view: RecordedView, image: str, shown: bool) -> None:
    """Log frames, depth, flow and ids, each image at its own time."""
    rr = log.rr
    known = {kind: log.within(labels.t_us) for kind, labels in view.labels.items()}
    kinds = [kind for kind in ("depth", *_FRAMES, *_FLOWS, *_IDS) if len(known.get(kind, ()))]
    with Progress(sum(len(known[kind]) for kind in kinds), "label images", shown=shown) as progress:
        for kind in kinds:
            labels, path = view.labels[kind], f"{image}/{kind}"
            if kind == "depth":
                spread = _finite_range(labels, known[kind])
                how = {"meter": 1.0, "colormap": rr.components.Colormap.Viridis, "depth_range": spread}
                log.always(path, rr.DepthImage.from_fields(**how))
            speed = full_speed(view, kind) if kind in _FLOWS else 0.0
            reference = reference_of(recording, labels[int(known[kind][0])]) if kind in _FRAMES else 1.0
            for index in known[kind].tolist():
                t_us = int(labels.t_us[index])
                if kind == "depth":
                    # The viewer takes 0 for what has no depth, which is infinite here.
                    depth = np.nan_to_num(labels[index], nan=0.0, posinf=0.0)
                    log.image(path, t_us, rr.DepthImage, depth)
                elif kind in _IDS:
                    # The viewer's classes have 16 bits.
                    log.image(path, t_us, rr.SegmentationImage, labels[index].astype(np.uint16))
                elif kind in _FLOWS:
                    log.image(path, t_us, rr.Image, flow_of(view, kind, index, speed))
                else:
                    log.image(path, t_us, rr.Image, tone_mapped(labels[index], reference))
                progress.advance()


def _layout(log: _Log, names: Sequence[str]) -> Any:
    """Lay the viewer out: space at the left, a grid of pictures per camera beside it, rates below."""
    import rerun.blueprint as rrb

    grids, behind, rates, posed = [], [], [], False
    for name in names:
        camera, rate = log.path("world", "cameras", name), log.path("rates", name)
        paths = {kind: f"{camera}/image/{kind}" for kind in ("events", *_FRAMES, "depth", *_FLOWS, *_IDS)}
        shown = {kind: path for kind, path in paths.items() if path in log.rows}
        pictures = [
            rrb.Spatial2DView(origin=f"{camera}/image", contents=[path], name=f"{name}: {kind}")
            for kind, path in shown.items()
        ]
        if pictures:
            grids.append(rrb.Grid(*pictures))
        # One picture on each camera's frustum is enough: the first of these that there is.
        flat = [kind for kind in (*_FRAMES, "events", *_FLOWS, *_IDS) if kind in shown]
        behind += [f"- {shown[kind]}" for kind in flat[1:]]
        posed |= camera in log.rows
        if f"{rate}/ON" in log.rows:
            rates.append(rrb.TimeSeriesView(origin=rate, name=f"{name}: event rate"))
    space = rrb.Spatial3DView(origin="/world", contents=["+ /world/**", *behind], name="world")
    above = [space] * posed + [rrb.Vertical(*grids)] * bool(grids)
    rows = [rrb.Horizontal(*views) for views in (above, rates) if views]
    sides = rrb.BlueprintPanel(state="collapsed"), rrb.SelectionPanel(state="collapsed")
    return rrb.Blueprint(rrb.Vertical(*rows, row_shares=[4, 1][: len(rows)]), *sides)


def log(
    stream: Any,
    source: Source,
    *,
    window_us: int = 10_000,
    camera: str | None = None,
    start_us: int | None = None,
    end_us: int | None = None,
    progress: bool = False,
) -> dict[str, int]:
    """Log a recording to a stream of Rerun, and say how the viewer should lay it out.

    Events are pictures of windows, ``[k window_us, (k + 1) window_us)``, counted from ``start_us`` where that
    is given; a pixel shows its last polarity. A picture is logged at its window's end. A recording of EVIS
    brings all of its labels that the viewer can show, and poses; files of other programs bring events.

    Parameters
    ----------
    stream : rerun.RecordingStream
        Where rows go.
    source : Recording, EventArray or path
        What is logged; a path is opened by `evis.load`.
    window_us : int
        Microseconds per picture of events.
    camera : str, optional
        The one camera to log; else all.
    start_us, end_us : int, optional
        First microsecond, and one past the last.
    progress : bool
        Show a bar on standard error, if that is a terminal.

    Returns
    -------
    dict of str to int
        Rows by entity.

    Raises
    ------
    ConfigError
        If rerun-sdk is missing, an argument cannot be used, or there is nothing to show.
    OSError, FormatError
        If the file cannot be read.
    """
    recording = _opened(source, camera)
    window_us = _check.whole("window_us", window_us, 1, MOST_T_US, " microseconds")
    limits = (
        -_check.MOST_US if start_us is None else _check.time_us("start_us", start_us),
        _check.MOST_US if end_us is None else _check.time_us("end_us", end_us),
    )
    if limits[1] <= limits[0]:
        raise ConfigError(f"end_us is {end_us}; it must be above start_us, {start_us}")
    to = _Log(stream, limits)
    views = list(recording.values()) if camera is None else [recording[camera]]
    to.always("world", to.rr.ViewCoordinates.RIGHT_HAND_Y_UP)
    for view in views:
        name = view.camera.name
        place = to.path("world", "cameras", name)
        image = to.path("world", "cameras", name, "image")
        _log_camera(to, view, place, image, to.path("world", "tracks", name))
        _log_events(to, view, f"{image}/events", to.path("rates", name), window_us, progress)
        _log_labels(to, recording, view, image, progress)
    if not to.rows:
        part = "" if start_us is end_us is None else f" with start_us={start_us} and end_us={end_us}"
        raise ConfigError(
            f"there is nothing to show{part}: no event, no label image, no pose; choose another recording or "
            "part of it"
        )
    stream.send_blueprint(_layout(to, [view.camera.name for view in views]))
    return to.rows


def _spawn(stream: Any) -> None:
    """Open the viewer, which is installed beside Python, also where that folder is not on PATH."""
    before = os.environ.get("PATH", "")
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), before])
    try:
        stream.spawn()
    except RuntimeError as error:
        reason = str(error).partition("\n")[0]
        raise ConfigError(
            f"the viewer did not open: {reason}; write a file instead (save='OUT.rrd')"
        ) from error
    finally:
        os.environ["PATH"] = before


def view(
    source: Source,
    *,
    save: str | PathLike[str] | None = None,
    window_us: int = 10_000,
    camera: str | None = None,
    start_us: int | None = None,
    end_us: int | None = None,
    progress: bool = False,
) -> dict[str, int]:
    """Open Rerun's viewer with a recording, or write a file for it.

    Parameters
    ----------
    source : Recording, EventArray or path
        What is shown.
    save : path, optional
        A file to write, ``.rrd``, in place of opening the viewer; no display is needed. A file that is there
        is replaced, once the new one is complete.
    window_us, camera, start_us, end_us, progress
        As for `log`.

    Returns
    -------
    dict of str to int
        Rows by entity.

    Raises
    ------
    ConfigError
        As `log` does, or if there is no display, or ``save`` has another ending.
    OSError, FormatError
        If a file cannot be read or written.
    """
    rerun = _rerun()
    path = None if save is None else Path(save)
    display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if path is None and sys.platform == "linux" and not display:
        raise ConfigError(
            "there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set); write a file instead "
            "(save='OUT.rrd'), and open it where there is one"
        )
    if path is not None and path.suffix.lower() != ".rrd":
        raise ConfigError(f"save is {_check.shown(str(path))}; files for Rerun's viewer end with .rrd")
    recording = _opened(source, camera)
    stream = rerun.RecordingStream("evis")
    stream.send_recording_name(Path(source).name if isinstance(source, (str, PathLike)) else "events")
    options: dict[str, Any] = {"window_us": window_us, "camera": camera, "progress": progress}
    options |= {"start_us": start_us, "end_us": end_us}
    if path is None:
        _spawn(stream)
        rows = log(stream, recording, **options)
        stream.flush()
        return rows
    part = path.with_name(f"{path.name}.part")
    # Rerun itself prints what it cannot write, and goes on.
    part.open("wb").close()
    try:
        stream.save(part)
        rows = log(stream, recording, **options)
        stream.disconnect()
        part.replace(path)
    except BaseException:
        stream.disconnect()
        part.unlink(missing_ok=True)
        raise
    return rows
