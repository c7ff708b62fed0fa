"""Plots of events: rates, intervals, maps, thumbnails, time surfaces, x-y-t clouds, and films of them.

Needs Matplotlib: ``pip install 'evis[plot]'``; films need imageio-ffmpeg too: ``'evis[plot,video]'``. Each
function returns a figure of Matplotlib, which ``figure.savefig("plot.png")`` writes. docs/view.md shows them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check
from ._events import EventArray, EventCarrier, Events
from ._evis import ConfigError
from ._files import load
from ._pictures import OFF, ON, new_figure, polarity_picture, surface_picture
from ._progress import Progress

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "FILMS",
    "KINDS",
    "intervals",
    "polarity",
    "rate_map",
    "rates",
    "summary",
    "surface",
    "thumbnails",
    "video",
    "xyt",
]

Source: TypeAlias = "EventArray | EventCarrier | str | PathLike[str]"
"""Whatever has the events of one camera: an array, a recording, a view, a packet, or the path of a file."""

_ON, _OFF = ("#{:02x}{:02x}{:02x}".format(*color) for color in (ON, OFF))
_GREY = "#666666"


def _events(source: Source) -> EventArray:
    if isinstance(source, (str, PathLike)):
        source = load(source)
    if isinstance(source, EventCarrier):
        source = source._event_array()
    if not isinstance(source, EventArray):
        raise ConfigError(
            f"events are {_check.shown(source)}; they must be an evis.EventArray, something of one camera "
            "that has events, or the path of a file"
        )
    if not len(source):
        raise ConfigError("there are no events; choose another recording, camera or part of it")
    return source


def _span_us(events: EventArray) -> tuple[int, int]:
    """Return the first microsecond, and one past the last.

    Streams start at 0: where the first event comes soon after, that is the first microsecond.
    """
    start, end = int(events.t[0]), int(events.t[-1]) + 1
    return (0 if 0 <= start < 0.05 * end else start), end


class _Axis:
    """How times are written: in what unit, and from where on.

    Streams start at 0; cameras that count from 1970 are written from their first event on.
    """

    def __init__(self, start_us: int, end_us: int) -> None:
        span = end_us - start_us
        self.origin_us = start_us if abs(start_us) > 100 * span and abs(start_us) > 3_600_000_000 else 0
        units = ((1e6, "s"), (1e3, "ms"), (1.0, "us"))
        self.us, self.unit = next((u for u in units if span >= 2 * u[0]), units[-1])
        # A thousandth of the span is resolved.
        self._decimals = max(0, int(np.ceil(-np.log10(span / (1000 * self.us)))))
        after = f" after {self.origin_us} us" if self.origin_us else ""
        self.label = f"time{after} ({self.unit})"

    def __call__(self, t_us: Any) -> Any:
        return (np.asarray(t_us, np.int64) - self.origin_us) / self.us

    def text(self, t_us: int) -> str:
        return f"{float(self(t_us)):.{self._decimals if self.us > 1 else 0}f}"


def _plain(axes: Any) -> None:
    """Remove spines without information."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)


def _nice(value: float) -> int:
    """Return the whole number 1, 2 or 5 times a power of ten that is next above ``value``."""
    power = 1
    while 10 * power <= value:
        power *= 10
    return next(step * power for step in (1, 2, 5, 10) if step * power >= value)


def _draw_rates(axes: Any, events: EventArray, bin_us: int | None) -> None:
    from matplotlib.ticker import EngFormatter

    start, end = _span_us(events)
    width = (
        _nice((end - start) / 200)
        if bin_us is None
        else _check.whole("bin_us", bin_us, 1, unit=" microseconds")
    )
    first, last = start // width, (end - 1) // width
    if last - first >= 10_000_000:
        raise ConfigError(f"bin_us is {width}: the events span {last - first + 1} bins; choose a longer one")
    edges = width * np.arange(first, last + 2, dtype=np.int64)
    axis = _Axis(start, end)
    for name, color, polarity in (("ON", _ON, 1), ("OFF", _OFF, 0)):
        bins = events.t[events.p == polarity] // width - first
        count = np.bincount(bins, minlength=len(edges) - 1)
        rate = count / (width * 1e-6)
        axes.stairs(rate, axis(edges), baseline=None, color=color, label=name, linewidth=1.2)
    axes.set_xlim(axis(edges[0]), axis(edges[-1]))
    axes.set_ylim(0)
    axes.yaxis.set_major_formatter(EngFormatter())
    axes.set_xlabel(axis.label)
    axes.set_ylabel("events per second")
    axes.set_title(f"Event rate, bins of {width / 1000:g} ms")
    axes.legend(frameon=False, ncols=2)
    _plain(axes)


def _pixel_intervals(events: EventArray) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Return the times between successive events of each pixel, and whether their polarities are the same."""
    pixel = events.y.astype(np.int64) * events.width + events.x
    order = np.argsort(pixel, kind="stable")
    pixel, t, p = pixel[order], events.t[order], events.p[order]
    again = pixel[1:] == pixel[:-1]
    return np.diff(t)[again], (p[1:] == p[:-1])[again]


def _draw_intervals(axes: Any, events: EventArray) -> None:
    gaps, alike = _pixel_intervals(events)
    axes.set_title("Time between two events of a pixel")
    axes.set_xlabel("interval (us)")
    axes.set_ylabel("intervals")
    axes.set_xscale("log")
    axes.set_yscale("log")
    _plain(axes)
    if not len(gaps):
        axes.text(0.5, 0.5, "no pixel fired twice", transform=axes.transAxes, ha="center", color=_GREY)
        return
    # Ten bins per decade, but none without a whole microsecond; the first one holds intervals of 0.
    decades = np.arange(0, np.log10(max(int(gaps.max()), 1)) + 0.1001, 0.1)
    edges = np.concatenate([[0.5], np.unique(np.rint(10**decades))])
    edges[-1] = max(edges[-1], gaps.max() + 1)
    for name, color, kept in (
        ("same polarity", "#333333", alike),
        ("other polarity", "#009e73", ~alike),
    ):
        count, _ = np.histogram(np.maximum(gaps[kept], 0.7), edges)
        axes.stairs(count, edges, baseline=None, color=color, label=name, linewidth=1.2)
    axes.set_xlim(edges[max(0, np.searchsorted(edges, gaps.min(), side="right") - 2)], edges[-1])
    axes.set_ylim(0.7)
    axes.legend(frameon=False)


def _imshow(axes: Any, picture: Any, **how: Any) -> Any:
    axes.set_xticks([])
    axes.set_yticks([])
    return axes.imshow(picture, interpolation="nearest", **how)


def _draw_rate_map(figure: Any, axes: Any, events: EventArray) -> None:
    from matplotlib.colors import LogNorm

    start, end = _span_us(events)
    rate = events.counts().sum(axis=0) / ((end - start) * 1e-6)
    fired = rate[rate > 0]
    low, high = float(fired.min()), float(fired.max())
    shown = _imshow(
        axes, np.ma.masked_equal(rate, 0), norm=LogNorm(low, max(high, 1.01 * low)), cmap="viridis"
    )
    axes.set_facecolor("#eeeeee")
    y, x = np.unravel_index(int(rate.argmax()), rate.shape)
    most = f"{high:.0f}" if high >= 100 else f"{high:.3g}"
    axes.set_title(f"Rate per pixel, up to {most}/s at ({x}, {y})")
    figure.colorbar(shown, ax=axes, label="events per second")


def rates(events: Source, *, bin_us: int | None = None) -> Figure:
    """Plot the rate of ON and of OFF events over time.

    Parameters
    ----------
    events : EventArray, anything of one camera that has events, or path
        The events.
    bin_us : int, optional
        Microseconds per bin; about 200 bins where not given. Bins start at multiples of it.

    Returns
    -------
    matplotlib.figure.Figure
        One axes, with a step line each, in events per second.

    Raises
    ------
    ConfigError
        If there are no events, ``bin_us`` cannot be used, or Matplotlib is missing.
    """
    array, figure = _events(events), new_figure(8, 3)
    _draw_rates(figure.subplots(), array, bin_us)
    return figure


def intervals(events: Source) -> Figure:
    """Plot a histogram of the time between successive events of a pixel.

    Pairs of the same polarity and of different ones are counted apart: the first show refractory periods and
    steep edges, the second textures, flicker and noise.

    Parameters
    ----------
    events : EventArray, anything of one camera that has events, or path
        The events.

    Returns
    -------
    matplotlib.figure.Figure
        One axes, with a step line each; both scales are logarithmic, ten bins per decade, fewer below 10 us.
        The first bin holds pairs of the same microsecond.

    Raises
    ------
    ConfigError
        If there are no events, or Matplotlib is missing.
    """
    array, figure = _events(events), new_figure(8, 3)
    _draw_intervals(figure.subplots(), array)
    return figure


def rate_map(events: Source) -> Figure:
    """Plot how often each pixel fired, in events per second, on a logarithmic scale.

    Parameters
    ----------
    events : EventArray, anything of one camera that has events, or path
        The events.

    Returns
    -------
    matplotlib.figure.Figure
        The picture, and its scale; pixels that never fired are grey.

    Raises
    ------
    ConfigError
        If there are no events, or Matplotlib is missing.
    """
    array, figure = _events(events), new_figure(6, 4.2)
    _draw_rate_map(figure, figure.subplots(), array)
    return figure


def polarity(events: Source) -> Figure:
    """Draw the last polarity of each pixel: ON orange, OFF dark blue.

    Parameters
    ----------
    events : EventArray, anything of one camera that has events, or path
        The events; choose some milliseconds of them, with ``slice_time``.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.

    Raises
    ------
    ConfigError
        If there are no events, or Matplotlib is missing.
    """
    array, figure = _events(events), new_figure(6, 4.6)
    axes = figure.subplots()
    start, end = _span_us(array)
    axis = _Axis(start, end)
    _imshow(axes, polarity_picture(array.to_numpy(), (array.width, array.height)))
    axes.set_title(
        f"{len(array)} events, {axis.text(start)} to {axis.text(end)} {axis.unit}; ON orange, OFF blue"
    )
    return figure


def surface(events: Source, *, tau_us: float = 30_000, at_us: int | None = None) -> Figure:
    """Draw a time surface: pixels have the colour of their last event's polarity, the paler the older it is.

    Parameters
    ----------
    events : EventArray, anything of one camera that has events, or path
        The events.
    tau_us : float
        Microseconds in which colours fade to 1/e.
    at_us : int, optional
        The surface's time; that of the last event where not given.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.

    Raises
    ------
    ConfigError
        If there are no events, a parameter cannot be used, or Matplotlib is missing.

    Notes
    -----
    `EventArray.time_surface` has the formula and its source.
    """
    array, figure = _events(events), new_figure(6, 4.6)
    axes = figure.subplots()
    at = int(array.t[-1]) if at_us is None else _check.time_us("at_us", at_us)
    _imshow(axes, surface_picture(array.time_surface(tau_us, at_us=at)))
    axis = _Axis(*_span_us(array))
    axes.set_title(
        f"Time surface at {axis.text(at)} {axis.unit}, tau {tau_us / 1000:g} ms; ON orange, OFF blue"
    )
    return figure


def _tiles(events: EventArray, count: int, window_us: int | None) -> list[tuple[int, int]]:
    """Return windows that end at the ends of equal parts: the last one shows the stream's end."""
    start, end = _span_us(events)
    length = min(20_000, max(1, (end - start) // count)) if window_us is None else window_us
    ends = [start + (end - start) * (k + 1) // count for k in range(count)]
    return [(max(start, each - length), each) for each in ends]


def _draw_thumbnails(figure: Any, events: EventArray, count: int, window_us: int | None) -> None:
    from matplotlib.ticker import MaxNLocator

    tiles = _tiles(events, count, window_us)
    windows = [events.slice_time(*tile) for tile in tiles]
    counts = [window.counts().sum(axis=0) for window in windows]
    most = max(1, max(int(each.max()) for each in counts))
    axis = _Axis(*_span_us(events))
    rows = figure.subplots(3, count, squeeze=False)
    for k, ((start, end), window) in enumerate(zip(tiles, windows, strict=True)):
        rows[0, k].set_title(f"{axis.text(start)} to {axis.text(end)} {axis.unit}", fontsize=9)
        shown = _imshow(rows[0, k], np.ma.masked_equal(counts[k], 0), vmin=0, vmax=most, cmap="magma_r")
        age = events.time_surface(max(1, (end - start) / 2), at_us=end - 1)
        _imshow(rows[1, k], surface_picture(age))
        _imshow(rows[2, k], polarity_picture(window.to_numpy(), (events.width, events.height)))
    for row, name in zip(rows[:, 0], ("counts", "time surface", "polarity"), strict=True):
        row.set_ylabel(name)
    figure.colorbar(shown, ax=list(rows[0]), label="events", ticks=MaxNLocator(5, integer=True))


def thumbnails(events: Source, *, count: int = 4, window_us: int | None = None) -> Figure:
    """Draw counts, time surface and polarity of some windows, from the start to the end.

    Parameters
    ----------
    events : EventArray, anything of one camera that has events, or path
        The events.
    count : int
        Windows, evenly spread.
    window_us : int, optional
        Microseconds of each; 20 000 where not given, or less for short streams. The time surfaces fade to 1/e
        within half of it, and know all earlier events too.

    Returns
    -------
    matplotlib.figure.Figure
        A row each of counts (both polarities), time surfaces and last polarities.

    Raises
    ------
    ConfigError
        If there are no events, a parameter cannot be used, or Matplotlib is missing.
    """
    array = _events(events)
    count = _check.whole("count", count, 1, 20)
    length = None if window_us is None else _check.whole("window_us", window_us, 1, unit=" microseconds")
    figure = new_figure(1 + 2.2 * count, 0.6 + 3 * 2.2 * array.height / array.width)
    _draw_thumbnails(figure, array, count, length)
    return figure


def _draw_cloud(axes: Any, events: Events, size: tuple[int, int], most: int, axis: _Axis) -> None:
    """Draw events as points, time to the right, the sensor upright."""
    from matplotlib.ticker import MaxNLocator

    width, height = size
    if len(events) > most:
        # The same events each time, and evenly in time, where every k-th might follow the rows.
        kept = np.random.default_rng(0).choice(len(events), most, replace=False)
        events = events[np.sort(kept)]
    colors = np.where(events["p"] == 1, _ON, _OFF)
    points = axis(events["t"]), events["x"], events["y"]
    axes.scatter(*points, c=colors, s=2, linewidths=0, depthshade=False, rasterized=True)
    axes.set_ylim(0, width)
    # Rows run down.
    axes.set_zlim(height, 0)
    axes.set_box_aspect((2.2, 1, height / width), zoom=1.3)
    axes.yaxis.set_major_locator(MaxNLocator(3))
    axes.zaxis.set_major_locator(MaxNLocator(4))
    axes.view_init(elev=18, azim=-62)
    for pane in (axes.xaxis, axes.yaxis, axes.zaxis):
        pane.set_pane_color((0.97, 0.97, 0.97, 1))
    axes.set_xlabel(axis.label, labelpad=12)
    axes.set_ylabel("x (px)")
    axes.set_zlabel("y (px)")


def xyt(events: Source, *, most: int = 20_000) -> Figure:
    """Draw events in space and time: time to the right, the sensor upright, ON orange, OFF dark blue.

    Parameters
    ----------
    events : EventArray, anything of one camera that has events, or path
        The events; 50 to 100 ms of them show motion best, with ``slice_time``.
    most : int
        Points at most; of more events, so many are drawn, chosen at random (always the same).

    Returns
    -------
    matplotlib.figure.Figure
        One axes with three dimensions.

    Raises
    ------
    ConfigError
        If there are no events, ``most`` cannot be used, or Matplotlib is missing.
    """
    array = _events(events)
    most = _check.whole("most", most, 1)
    figure = new_figure(8, 4.2)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 0.97, 0.97), projection="3d")
    axis = _Axis(*_span_us(array))
    _draw_cloud(axes, array.to_numpy(), (array.width, array.height), most, axis)
    some = f"{most} of {len(array)} events" if len(array) > most else f"{len(array)} events"
    figure.suptitle(f"{some}; ON orange, OFF blue", y=0.97)
    return figure


def summary(events: Source) -> Figure:
    """Draw rates, intervals, the rate of each pixel and thumbnails on one sheet.

    Parameters
    ----------
    events : EventArray, anything of one camera that has events, or path
        The events.

    Returns
    -------
    matplotlib.figure.Figure
        What `rates`, `intervals`, `rate_map` and `thumbnails` draw.

    Raises
    ------
    ConfigError
        If there are no events, or Matplotlib is missing.
    """
    array = _events(events)
    tiles = 0.6 + 3 * 2.2 * array.height / array.width
    figure = new_figure(10, 6 + tiles)
    top, bottom = figure.subfigures(2, 1, height_ratios=[6, tiles])
    above, below = top.subfigures(2, 1)
    _draw_rates(above.subplots(), array, None)
    left, right = below.subplots(1, 2)
    _draw_intervals(left, array)
    _draw_rate_map(below, right, array)
    _draw_thumbnails(bottom, array, 4, None)
    return figure


KINDS: dict[str, Callable[..., Figure]] = {
    "summary": summary,
    "rates": rates,
    "intervals": intervals,
    "map": rate_map,
    "thumbnails": thumbnails,
    "polarity": polarity,
    "surface": surface,
    "xyt": xyt,
}
"""Plots by the names that ``evis plot --kind`` takes."""

FILMS = ("polarity", "surface", "xyt")
"""What films show."""

_MOST_FRAMES = 1_000_000
_LEAST_WIDTH = 480
_CAPTION = 30
_CLOUD = 4_000
"""Points of a film's clouds."""


def _stamp(figure: Any, caption: float, width: int) -> Any:
    """Write the legend of a film ``width`` pixels wide, and return the text artist of the time."""
    middle = caption / 2
    for right, name, color in ((8, "OFF", _OFF), (52, "ON", _ON)):
        place = 1 - right / width
        figure.text(place, middle, name, ha="right", va="center", color=color, weight="bold", fontsize=11)
    return figure.text(8 / width, middle, "", va="center", color=_GREY, fontsize=11)


def _frames(
    events: EventArray, ends: npt.NDArray[np.int64], kind: str, window_us: int
) -> Iterator[npt.NDArray[np.uint8]]:
    """Draw each frame of a film, uint8 (H, W, 3)."""
    width, height = events.width, events.height
    array, axis = events.to_numpy(), _Axis(*_span_us(events))
    scale = max(1, -(-_LEAST_WIDTH // width)) if kind != "xyt" else 1
    sides = (width * scale, height * scale) if kind != "xyt" else (800, 440)
    # Films have even sides, which every player shows.
    sides = (sides[0] + sides[0] % 2, sides[1] + (sides[1] + _CAPTION) % 2)
    figure = new_figure(sides[0] / 100, (sides[1] + _CAPTION) / 100)
    figure.set_layout_engine("none")
    canvas = _canvas(figure)
    caption = _CAPTION / (sides[1] + _CAPTION)
    stamp = _stamp(figure, caption, sides[0])
    last_us = np.full((2, height, width), -(1 << 62), np.int64)
    if kind == "xyt":
        axes = figure.add_axes((0.0, caption, 1.0, 1 - caption), projection="3d")
    else:
        axes = figure.add_axes((0, caption, width * scale / sides[0], height * scale / (sides[1] + _CAPTION)))
        axes.set_axis_off()
        shown = axes.imshow(
            np.full((height, width, 3), 255, np.uint8), interpolation="nearest", aspect="auto"
        )
    done = 0
    for end in ends.tolist():
        begin, until = np.searchsorted(events.t, (end - window_us, end)).tolist()
        if kind == "polarity":
            shown.set_data(polarity_picture(array[begin:until], (width, height)))
        elif kind == "surface":
            new = array[done:until]
            last_us[new["p"], new["y"], new["x"]] = new["t"]
            done = until
            shown.set_data(surface_picture(np.exp((last_us - end) / window_us).astype(np.float32)))
        else:
            axes.clear()
            _draw_cloud(axes, array[begin:until], (width, height), _CLOUD, axis)
            axes.set_xlim(axis(end - window_us), axis(end))
            axes.set_xlabel("")
        stamp.set_text(f"{axis.text(end)} {axis.unit}")
        canvas.draw()
        yield np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])


def _canvas(figure: Any) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    return FigureCanvasAgg(figure)


def video(
    events: Source,
    path: str | PathLike[str],
    *,
    kind: str = "polarity",
    fps: float = 30.0,
    slow: float = 1.0,
    window_us: int | None = None,
    progress: bool = False,
) -> int:
    """Write a film of events, replacing a file that is there.

    Parameters
    ----------
    events : EventArray, anything of one camera that has events, or path
        The events.
    path : path
        Ends with ``.mp4``. The file has its name once it is complete.
    kind : {"polarity", "surface", "xyt"}
        What it shows: `polarity` of a window, a time `surface`, or `xyt` of a window.
    fps : float
        Frames per second of the film.
    slow : float
        How many times slower than the events it runs.
    window_us : int, optional
        Microseconds of events that a frame shows, or in which a surface fades to 1/e; where not given, the
        time between two frames, at least 10 000, or 30 000 for surfaces, or 100 000 for clouds.
    progress : bool
        Show a bar with the time left on standard error, if that is a terminal.

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    ConfigError
        If there are no events, an argument cannot be used, or a package is missing.
    OSError
        If the file cannot be read or written.
    """
    path = Path(path)
    array = _events(events)
    if kind not in FILMS:
        raise ConfigError(f"kind is {_check.shown(kind)}; films show {_check.one_of(FILMS)}")
    if path.suffix.lower() != ".mp4":
        raise ConfigError(f"path is {_check.shown(str(path))}; films end with .mp4")
    for name, value, most in (("fps", fps, 1000.0), ("slow", slow, 1e6)):
        if not 0 < _check.number(name, value) <= most:
            raise ConfigError(f"{name} is {value}; it must be above 0, and at most {most:g}")
    step_us = 1e6 / (fps * slow)
    least = {"polarity": 10_000, "surface": 30_000, "xyt": 100_000}[kind]
    if window_us is None:
        window_us = max(round(step_us), least)
    window_us = _check.whole("window_us", window_us, 1, _check.MOST_US, " microseconds")
    start, end = _span_us(array)
    count = max(1, int(np.ceil((end - start) / step_us - 1e-6)))
    if count > _MOST_FRAMES:
        raise ConfigError(
            f"the film would have {count} frames; choose a part of the events, a lower fps or a lower slow "
            f"(at most {_MOST_FRAMES})"
        )
    ends = start + np.rint(step_us * np.arange(1, count + 1)).astype(np.int64)
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise ConfigError(
            "films are not written without imageio-ffmpeg; pip install 'evis[plot,video]'"
        ) from error
    part = path.with_name(f"{path.name}.part")
    part.open("wb").close()
    try:
        _write(
            imageio_ffmpeg,
            part,
            _frames(array, ends, kind, window_us),
            fps,
            Progress(count, "frames", shown=progress),
        )
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    return count


def _write(
    imageio_ffmpeg: Any, path: Path, frames: Iterator[npt.NDArray[np.uint8]], fps: float, bar: Progress
) -> None:
    writer = None
    try:
        with bar:
            for frame in frames:
                if writer is None:
                    # The same frames give the same file: no date, no version, no decisions by thread.
                    exact = [
                        "-threads",
                        "1",
                        "-fflags",
                        "+bitexact",
                        "-flags:v",
                        "+bitexact",
                        "-map_metadata",
                        "-1",
                    ]
                    writer = imageio_ffmpeg.write_frames(
                        str(path),
                        (frame.shape[1], frame.shape[0]),
                        fps=fps,
                        macro_block_size=2,
                        quality=None,
                        output_params=[*exact, "-crf", "18", "-movflags", "+faststart", "-f", "mp4"],
                    )
                    writer.send(None)
                writer.send(frame)
                bar.advance()
    finally:
        if writer is not None:
            writer.close()
