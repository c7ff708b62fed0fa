"""Do networks accept these events? Reconstruction, flow and matching, each beside controls that must fail.

Needs onnxruntime, and OpenCV for matching: ``pip install 'evis[evaluate]'``. Networks are files of the user.
docs/evaluate.md has the methods, their sources, and figures.

>>> from evis import evaluate
>>> evaluate.CONTROLS
('flipped polarity', 'mirrored x', 'random events', 'delayed by 40 ms')
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check, metrics
from ._evaluate_scenes import LADDER, record
from ._events import EventArray
from ._evis import ConfigError
from ._files import RecordedLabels, RecordedView, Recording, load
from ._luminance import luminance
from ._networks import MatchNetwork, Network, Points, VoxelNetwork, opencv
from ._pictures import new_figure
from ._progress import Progress
from ._scene import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "CONTROLS",
    "LADDER",
    "Evaluation",
    "Ladder",
    "Row",
    "flow",
    "fwl",
    "ladder",
    "match",
    "ncc",
    "pose_auc",
    "reconstruct",
    "record",
    "tone_map",
]

Float = npt.NDArray[np.float32]
Source: TypeAlias = "Recording | str | PathLike[str]"
Normalization: TypeAlias = Literal["none", "standard", "robust", "exprobust"]

CONTROLS = ("flipped polarity", "mirrored x", "random events", "delayed by 40 ms")
"""What is done to the events of controls: networks must do worse on each."""

EVENTS = "events"
RENDERED = "rendered frames"
_DELAY_US = 40_000
_FAILED_SHARE = 0.9


@dataclass(frozen=True, slots=True)
class Row:
    """What one stream scored with one setting.

    Attributes
    ----------
    setting : str
        What was asked: ``"20 ms"``, ``"stereo"``.
    stream : str
        ``"events"``, one of `CONTROLS`, or ``"rendered frames"`` where a network sees those in their place.
    samples : int
        Pictures, windows or pairs of views that were scored.
    scores : mapping of str to float
        Their mean by measure; nan where nothing could be scored.
    worse : mapping of str to float
        Of a control: by the measures that judge it, the share of samples in which it scored below the events.
    """

    setting: str
    stream: str
    samples: int
    scores: Mapping[str, float]
    worse: Mapping[str, float]

    @property
    def fails(self) -> bool | None:
        """Whether a control fails: worse in 9 of 10 samples by some measure; None for no control."""
        return max(self.worse.values()) >= _FAILED_SHARE if self.worse else None


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What an evaluation found; ``print(evaluation)`` shows a table.

    Attributes
    ----------
    task : str
        ``"reconstruct"``, ``"flow"`` or ``"match"``.
    source : str
        What was evaluated.
    networks : mapping of str to str
        Files by their role, and the start of their SHA-256.
    settings : mapping
        What was chosen.
    rows : tuple of Row
        By setting: the events, then the controls.
    """

    task: str
    source: str
    networks: Mapping[str, str]
    settings: Mapping[str, Any]
    rows: tuple[Row, ...]

    @property
    def controls_fail(self) -> bool | None:
        """Whether every control fails, without which the other figures say nothing; None without controls."""
        outcomes = [row.fails for row in self.rows if row.fails is not None]
        return all(outcomes) if outcomes else None

    def row(self, stream: str = EVENTS, setting: str | None = None) -> Row:
        """Return the row of a stream; of the first setting where none is given.

        Raises
        ------
        ConfigError
            If there is none; names those that there are.
        """
        for row in self.rows:
            if row.stream == stream and setting in (None, row.setting):
                return row
        known = ", ".join(f"{row.stream!r} with {row.setting!r}" for row in self.rows)
        raise ConfigError(f"no row of {stream!r} with {setting!r}; there is {known}")

    def to_dict(self) -> dict[str, Any]:
        """Return dictionaries, lists and numbers; None where a mean is nan, which JSON does not have."""
        held = {**asdict(self), "controls_fail": self.controls_fail}
        for made, row in zip(held["rows"], self.rows, strict=True):
            made["fails"] = row.fails
            made["scores"] = {k: v if np.isfinite(v) else None for k, v in row.scores.items()}
        return held

    def to_json(self, *, indent: int | None = None) -> str:
        """Return the evaluation as JSON."""
        return json.dumps(self.to_dict(), indent=indent)

    def __str__(self) -> str:
        """Show a table."""
        names = list(dict.fromkeys(name for row in self.rows for name in row.scores))
        table = [["", "", "samples", *names, ""]]
        for row in self.rows:
            outcome = {None: "", True: "fails", False: "DOES NOT FAIL"}[row.fails]
            figures = [f"{row.scores[name]:.3f}" if name in row.scores else "" for name in names]
            table.append([row.setting, row.stream, str(row.samples), *figures, outcome])
        return "\n".join([_head(self), *_aligned(table)])


def _head(found: Evaluation) -> str:
    used = ", ".join(f"{role} {name}" for role, name in found.networks.items())
    return f"{found.task} of {found.source}" + (f" with {used}" if used else "")


def _aligned(table: Sequence[Sequence[str]]) -> list[str]:
    """Lay a table out: two columns to the left, the others to the right."""
    wide = [max(len(line[k]) for line in table) for k in range(len(table[0]))]
    lines = (
        "  ".join(
            cell.ljust(w) if k < 2 else cell.rjust(w)
            for k, (cell, w) in enumerate(zip(line, wide, strict=True))
        )
        for line in table
    )
    return [line.rstrip() for line in lines]


_LEADING = {
    "reconstruct": ("ssim", "ncc"),
    "flow": ("fwl", "increments"),
    "match": ("precision_3px", "auc_10deg"),
}
"""The measures of each task that a figure shows."""


@dataclass(frozen=True, slots=True)
class Ladder:
    """One evaluation of a scene by settings of the simulator; ``print(ladder)`` shows a table.

    Attributes
    ----------
    evaluations : mapping of str to Evaluation
        By the name of the settings.
    events : mapping of str to int
        Events of each recording.
    """

    evaluations: Mapping[str, Evaluation]
    events: Mapping[str, int]

    @property
    def controls_fail(self) -> bool | None:
        """Whether every control of every evaluation fails; None without controls."""
        outcomes = [found.controls_fail for found in self.evaluations.values()]
        known = [outcome for outcome in outcomes if outcome is not None]
        return all(known) if known else None

    def to_dict(self) -> dict[str, Any]:
        """Return dictionaries, lists and numbers; None where a mean is nan, which JSON does not have."""
        return {
            "controls_fail": self.controls_fail,
            "ladder": [
                {"name": name, "events": self.events[name], **found.to_dict()}
                for name, found in self.evaluations.items()
            ],
        }

    def to_json(self, *, indent: int | None = None) -> str:
        """Return the ladder as JSON."""
        return json.dumps(self.to_dict(), indent=indent)

    def __str__(self) -> str:
        """Show a table: what the events of each scored, and how many of its controls fail."""
        rows = [
            (name, row, [other.fails for other in found.rows if other.worse and other.setting == row.setting])
            for name, found in self.evaluations.items()
            for row in found.rows
            if row.stream == EVENTS
        ]
        names = list(dict.fromkeys(measure for _, row, _ in rows for measure in row.scores))
        table = [["", "", "events", "samples", *names, "controls"]]
        for name, row, fail in rows:
            figures = [f"{row.scores[each]:.3f}" if each in row.scores else "" for each in names]
            outcome = f"{sum(map(bool, fail))} of {len(fail)} fail" if fail else ""
            table.append([row.setting, name, str(self.events[name]), str(row.samples), *figures, outcome])
        order = list(dict.fromkeys(row.setting for _, row, _ in rows))
        body = sorted(table[1:], key=lambda line: order.index(line[0]))
        return "\n".join([_head(next(iter(self.evaluations.values()))), *_aligned([table[0], *body])])

    def figure(self) -> Figure:
        """Draw the leading measures as bars: SSIM and NCC, FWL and increments, or precision and AUC.

        Returns
        -------
        matplotlib.figure.Figure
            ``figure.savefig("ladder.png")`` writes it.

        Raises
        ------
        ConfigError
            If Matplotlib is not installed: ``pip install 'evis[plot]'``.
        """
        first = next(iter(self.evaluations.values()))
        settings = list(dict.fromkeys(row.setting for row in first.rows if row.stream == EVENTS))
        measures = _LEADING[first.task]
        figure = new_figure(4.5 * len(measures), 1.2 + 0.4 * len(self.evaluations))
        places = np.arange(len(self.evaluations))
        height = 0.8 / len(settings)
        for axes, measure in zip(figure.subplots(1, len(measures), sharey=True), measures, strict=True):
            for k, setting in enumerate(settings):
                rows = [found.row(EVENTS, setting) for found in self.evaluations.values()]
                values = [row.scores.get(measure, float("nan")) for row in rows]
                axes.barh(places + (k - (len(settings) - 1) / 2) * height, values, height, label=setting)
            axes.set_xlabel(measure)
            axes.set_yticks(places, list(self.evaluations))
        # Both share it: the first settings at the top.
        axes.invert_yaxis()
        figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper")
        figure.suptitle(_head(first), fontsize="medium")
        return figure


def check_network(network: str | PathLike[str] | None) -> None:
    """Refuse a network that cannot be used, before a scene is simulated for it."""
    if network is not None:
        Network(network)


def ladder(
    task: Literal["reconstruct", "flow", "match"],
    scene: Scene,
    network: str | PathLike[str] | None = None,
    *,
    rungs: Mapping[str, Mapping[str, Any]] = LADDER,
    duration_s: float = 1.0,
    size: tuple[int, int] = (320, 240),
    seed: int | None = None,
    progress: bool = False,
    **options: Any,
) -> Ladder:
    """Evaluate a scene that is simulated with different settings.

    Parameters
    ----------
    task : {"reconstruct", "flow", "match"}
        The evaluation, with ``network`` and ``options`` as its function takes them.
    scene : Scene
        What is seen; see `record`.
    network : path, optional
        The network.
    rungs : mapping of str to mapping
        Arguments of `evis.Simulator` by name; `LADDER` where not given: rendering at 1000 Hz, the presets,
        and the rates of the EVIS paper.
    duration_s : float
        Seconds of each recording.
    size : tuple of int
        Width and height in pixels.
    seed : int, optional
        Of the simulator.
    progress : bool
        Show a bar.
    **options
        Of the evaluation, such as ``controls`` and ``windows_us``.

    Returns
    -------
    Ladder
        One evaluation by name; the recordings are removed.

    Raises
    ------
    ConfigError, OSError, FormatError
        As the evaluation and `record`.
    """
    runs: Mapping[str, Callable[..., Evaluation]] = {"reconstruct": reconstruct, "flow": flow, "match": match}
    if task not in runs:
        raise ConfigError(f"task is {_check.shown(task)}; it must be {_check.one_of(list(runs))}")
    if not rungs:
        raise ConfigError(
            "rungs is empty; it must hold settings by name, such as {'draft': {'quality': 'draft'}}"
        )
    check_network(network)
    evaluations, events = {}, {}
    with tempfile.TemporaryDirectory() as folder, Progress(len(rungs), "settings", shown=progress) as bar:
        # Its name is the table's.
        path = Path(folder) / f"{scene.name.replace('/', '_')}.h5"
        for name, settings in rungs.items():
            recording = record(scene, path, task, duration_s=duration_s, size=size, seed=seed, **settings)
            events[name] = sum(len(view) for view in recording.values())
            evaluations[name] = runs[task](path, network, **options)
            bar.advance(1, name)
    return Ladder(evaluations, events)


def ncc(picture: npt.ArrayLike, reference: npt.ArrayLike) -> float:
    """Return the normalized cross-correlation of two pictures: Pearson's correlation of their pixels.

    Parameters
    ----------
    picture, reference : array_like
        One shape; computed as float64.

    Returns
    -------
    float
        -1 to 1; 0 where one of them is the same everywhere, which has no correlation.

    Raises
    ------
    ConfigError
        If the shapes differ, or a value is not finite.
    """
    a, b = (np.asarray(each, np.float64) for each in (picture, reference))
    if a.shape != b.shape or not a.size or not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ConfigError(
            f"picture has shape {a.shape}, reference {b.shape}; both must have one shape and finite values"
        )
    a, b = a - a.mean(), b - b.mean()
    norm = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / norm if norm > 0 else 0.0


def _local(picture: Float) -> npt.NDArray[np.float64]:
    """Take the mean over 41x41 pixels, mirrored at borders, from each pixel."""
    half = [min(20, side - 1) for side in picture.shape]
    framed = np.pad(picture.astype(np.float64), [(h, h) for h in half], mode="reflect")
    for axis, h in enumerate(half):
        sums = np.cumsum(np.insert(framed, 0, 0.0, axis=axis), axis=axis)
        size = 2 * h + 1
        upper = np.take(sums, range(size, sums.shape[axis]), axis)
        lower = np.take(sums, range(sums.shape[axis] - size), axis)
        framed = (upper - lower) / size
    return np.asarray(picture - framed, np.float64)


def tone_map(luminance: npt.ArrayLike) -> Float:
    """Map linear luminance to what a camera would show, 0 to 1.

    One exposure for all pictures: the mean logarithm becomes 0.18 (the key of E. Reinhard et al.,
    Photographic tone reproduction for digital images, 2002), then the curve of sRGB (IEC 61966-2-1), cut at 0
    and 1.

    Parameters
    ----------
    luminance : array_like
        Linear luminance, any shape and unit, not negative.

    Returns
    -------
    numpy.ndarray
        float32 of that shape.

    Raises
    ------
    ConfigError
        If a value is negative or not finite, or nothing is above 0.
    """
    light = np.asarray(luminance, np.float32)
    if not light.size or not np.isfinite(light).all() or light.min() < 0 or light.max() <= 0:
        raise ConfigError("luminance must be finite, not negative, and above 0 somewhere")
    lit = light[light > 0].astype(np.float64)
    light = light * np.float32(0.18 / np.exp(np.log(lit).mean()))
    curved = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(np.clip(curved, 0.0, 1.0), np.float32)


def _post(picture: Float, how: Normalization) -> Float:
    """Normalize a reconstruction as EVREAL does (B. Ercan et al., CVPR workshops 2023), and cut it."""
    if how != "none":
        picture = np.exp(picture) if how == "exprobust" else picture
        low, high = np.percentile(picture, (0, 100) if how == "standard" else (1, 99))
        picture = (picture - low) / max(high - low, 1e-12)
    return np.clip(picture, 0.0, 1.0).astype(np.float32)


def _chosen(controls: Sequence[str]) -> list[str]:
    names = _check.items("controls", controls, f"['{CONTROLS[0]}']")
    for name in names:
        if name not in CONTROLS:
            raise ConfigError(f"controls has {_check.shown(name)}; it must hold {_check.one_of(CONTROLS)}")
    return names


def _windows(windows_us: Sequence[int]) -> list[int]:
    windows = [
        _check.whole("windows_us", each, 1) for each in _check.items("windows_us", windows_us, "[20_000]")
    ]
    if not windows:
        raise ConfigError("windows_us is empty; it must hold at least one time, such as 20_000")
    return windows


def _streams(events: EventArray, controls: Sequence[str]) -> Iterator[tuple[str, EventArray]]:
    """Give the events, and each control made of them."""
    size = {"width": events.width, "height": events.height}
    t, x, y, p = events.columns
    for name in (EVENTS, *controls):
        if name == EVENTS:
            yield name, events
        elif name == CONTROLS[0]:
            yield name, EventArray.from_columns(t, x, y, 1 - p, **size)
        elif name == CONTROLS[1]:
            yield name, EventArray.from_columns(t, events.width - 1 - x, y, p, **size)
        elif name == CONTROLS[2]:
            # As many as there are, anywhere and at any time that has any.
            rng = np.random.default_rng(0)
            first, last = (int(t[0]), int(t[-1])) if len(t) else (0, 0)
            times = np.sort(rng.integers(first, last + 1, len(t)))
            places = (rng.integers(0, n, len(t)) for n in (events.width, events.height, 2))
            yield name, EventArray.from_columns(times, *places, **size)
        else:
            yield name, EventArray.from_columns(t + _DELAY_US, x, y, p, **size)


def _rows(setting: str, found: Mapping[str, list[dict[str, float]]], judges: Sequence[str]) -> Iterator[Row]:
    """Average the scores of each stream, and judge the controls by the events' scores."""
    for stream, scores in found.items():
        names = list(scores[0])
        columns = {name: np.array([score[name] for score in scores]) for name in names}
        known = {name: column[np.isfinite(column)] for name, column in columns.items()}
        means = {
            name: float(column.mean()) if column.size else float("nan") for name, column in known.items()
        }
        worse = {}
        for judge in (each for each in judges if each in names and stream in CONTROLS):
            real = np.array([score[judge] for score in found[EVENTS]])
            # A sample without a figure, as of no match at all, is as bad as one can be.
            real, own = (np.nan_to_num(each, nan=-np.inf) for each in (real, columns[judge]))
            worse[judge] = float((own < real).mean())
        yield Row(setting, stream, len(scores), means, worse)


def _opened(source: Source, what: str) -> tuple[Recording, str]:
    if isinstance(source, Recording):
        return source, " and ".join(camera.name for camera in source.cameras)
    if isinstance(source, (str, PathLike)):
        return load(source), Path(source).name
    raise ConfigError(f"{what} is {_check.shown(source)}; it must be an evis.Recording or the path of one")


def _view(recording: Recording, camera: str | None) -> RecordedView:
    view = recording[camera] if camera is not None else next(iter(recording.values()))
    if not len(view):
        raise ConfigError(f"camera '{view.camera.name}' has no events; there is nothing to evaluate")
    return view


def _images(view: RecordedView, kinds: Sequence[str]) -> RecordedLabels:
    for kind in kinds:
        if kind in view.labels and len(view.labels[kind]) > 1:
            return view.labels[kind]
    raise ConfigError(
        f"camera '{view.camera.name}' has no {' or '.join(kinds)} images; record it with the labels "
        "depth, flow and hdr"
    )


def _every(labels: RecordedLabels, time_us: int, what: str) -> int:
    """Return how many images of a kind one window spans."""
    period = round(float(np.median(np.diff(labels.t_us))))
    every = round(time_us / period)
    if every < 1 or abs(every * period - time_us) > 0.02 * time_us:
        raise ConfigError(
            f"{what} is {time_us} us; it must be a multiple of the time between two {labels.kind} images, "
            f"{period} us"
        )
    return every


def _reconstructed(
    network: VoxelNetwork,
    events: EventArray,
    edges: npt.NDArray[np.int64],
    normalize: bool,
    post: Normalization,
) -> list[Float]:
    """Return a picture for each window between two edges."""
    network.reset()
    made, before = [], None
    for start, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        grid = events.voxel_grid(network.bins, normalize=normalize, start_us=start, end_us=end)
        picture = network.run(grid, before)[0]
        before = grid
        if picture.ndim != 4 or picture.shape[:2] != (1, 1) or picture.shape[2:] != grid.shape[1:]:
            raise ConfigError(
                f"{network.network.path.name} gives {picture.shape}; it must give pictures (1, 1, H, W)"
            )
        made.append(_post(picture[0, 0], post))
    return made


def reconstruct(
    source: Source,
    network: str | PathLike[str],
    *,
    windows_us: Sequence[int] = (20_000, 40_000),
    normalize: bool = True,
    post: Normalization = "none",
    skip: int = 10,
    camera: str | None = None,
    controls: Sequence[str] = CONTROLS,
    lpips: str | PathLike[str] | None = None,
) -> Evaluation:
    """Reconstruct pictures from events, and compare them with rendered ones.

    The windows lie between rendered frames, as EVREAL has them: of a recording's label ``frame`` where it has
    one, else ``hdr``, mapped by `tone_map`. Measures: ``mse``, ``ssim`` (`evis.metrics.ssim`, range 1),
    `ncc`, ``ncc_local``, which is `ncc` after the mean over 41x41 pixels is taken away: events hold little of
    slow gradients; with ``lpips``, that too. Controls are judged by `ncc`.

    Parameters
    ----------
    source : Recording or path
        A recording with ``frame`` or ``hdr`` images.
    network : path
        An ONNX network: a voxel grid (1, bins, H, W) of a window and states in, a picture (1, 1, H, W) and
        the next states out.
    windows_us : sequence of int
        Microseconds per window, multiples of the time between two frames.
    normalize : bool
        Whether grids are normalized (`EventArray.voxel_grid`): FireNet and E2VID take them so, FireNet+ and
        HyperE2VID do not.
    post : {"none", "standard", "robust", "exprobust"}
        What EVREAL does to a picture before it is cut to 0 to 1: nothing; its least and largest value, or its
        1st and 99th percentile (E2VID), become 0 and 1; the latter after an exponential (SSL-E2VID).
    skip : int
        Pictures at the start that do not count, while the network's states settle.
    camera : str, optional
        The camera; the first where not given.
    controls : sequence of str
        Of `CONTROLS`.
    lpips : path, optional
        An ONNX network for LPIPS (R. Zhang et al., CVPR 2018): two pictures (1, 3, H, W), -1 to 1, in, a
        number out.

    Returns
    -------
    Evaluation
        Rows for each window and stream.

    Raises
    ------
    ConfigError
        If the recording lacks what is needed, onnxruntime is missing, or the network does not fit.
    OSError, FormatError
        If a file cannot be read.
    """
    recording, name = _opened(source, "source")
    view = _view(recording, camera)
    frames = _images(view, ("frame", "hdr"))
    windows, controls = _windows(windows_us), _chosen(controls)
    if post not in ("none", "standard", "robust", "exprobust"):
        raise ConfigError(f"post is {post!r}; it must be none, standard, robust or exprobust")
    skip = _check.whole("skip", skip)
    model = VoxelNetwork(network, view.camera.height, view.camera.width)
    used = {"network": _named(model.network)}
    judge = None if lpips is None else Network(lpips)
    if judge is not None:
        used["lpips"] = _named(judge)
    reference = tone_map(np.stack([luminance(frames[k]) for k in range(len(frames))]))
    rows: list[Row] = []
    for window in windows:
        every = _every(frames, window, "a window")
        edges = frames.t_us[::every]
        if len(edges) < skip + 3:
            raise ConfigError(
                f"there are {len(edges) - 1} windows of {window} us, of which {skip} are skipped; record at "
                f"least {(skip + 2) * window / 1e6:g} s, or skip fewer"
            )
        found: dict[str, list[dict[str, float]]] = {}
        for stream, events in _streams(view.events, controls):
            pictures = _reconstructed(model, events, edges, normalize, post)
            found[stream] = [
                _compared(picture, reference[every * (k + 1)], judge)
                for k, picture in enumerate(pictures)
                if k >= skip
            ]
        rows += _rows(f"{window / 1000:g} ms", found, ("ncc",))
    settings = {
        "camera": view.camera.name,
        "reference": frames.kind,
        "normalize": bool(normalize),
        "post": post,
        "skip": skip,
    }
    return Evaluation("reconstruct", name, used, settings, tuple(rows))


def _named(network: Network) -> str:
    """Return the file's name and the start of its hash, for reports."""
    return f"{network.path.name} ({network.sha256[:12]})"


def _compared(picture: Float, reference: Float, lpips: Network | None) -> dict[str, float]:
    scores = {
        "mse": metrics.mse(picture, reference),
        "ssim": metrics.ssim(picture, reference, data_range=1.0),
        "ncc": ncc(picture, reference),
        "ncc_local": ncc(_local(picture), _local(reference)),
    }
    if lpips is not None:
        pair = [
            np.ascontiguousarray(np.broadcast_to(2 * each - 1, (1, 3, *each.shape)), np.float32)
            for each in (picture, reference)
        ]
        scores["lpips"] = float(np.ravel(lpips.run(pair)[0])[0])
    return scores


def _bilinear(image: Float, x: npt.NDArray[Any], y: npt.NDArray[Any]) -> Float:
    """Read (H, W) or (H, W, C) at places, 0 at the first pixel's centre; borders hold beyond them."""
    height, width = image.shape[:2]
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    extra = (...,) + (None,) * (image.ndim - 2)
    fx, fy = (x - left)[extra], (y - top)[extra]
    upper = image[top, left] * (1 - fx) + image[top, right] * fx
    lower = image[below, left] * (1 - fx) + image[below, right] * fx
    return np.asarray(upper * (1 - fy) + lower * fy, np.float32)


Piece: TypeAlias = "tuple[npt.NDArray[Any], npt.NDArray[np.bool_], int, int]"
"""Flow (H, W, 2), where it is defined, and the microseconds from which and to which it leads."""


def _carried(
    x: npt.NDArray[Any], y: npt.NDArray[Any], t: npt.NDArray[Any], pieces: Sequence[Piece]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Carry points back to the start of the first piece; return where they come from, if that is known.

    Flow is anchored where things are at a piece's start: p with p + share * flow(p) = x is found by
    iteration.
    """
    x, y, known = x.astype(np.float64), y.astype(np.float64), np.ones(len(x), bool)
    for field, defined, start, end in reversed(pieces):
        on = np.flatnonzero(t >= start)
        share = np.minimum((t[on] - start) / (end - start), 1.0)
        px, py = x[on], y[on]
        for _ in range(4):
            moved = _bilinear(field, px, py)
            px, py = x[on] - share * moved[:, 0], y[on] - share * moved[:, 1]
        inside = (px > -0.5) & (py > -0.5) & (px < field.shape[1] - 0.5) & (py < field.shape[0] - 0.5)
        row, column = np.rint(py[inside]).astype(np.intp), np.rint(px[inside]).astype(np.intp)
        # What comes from beyond the border leaves the picture, which is known.
        known[on[inside]] &= defined[row, column]
        x[on], y[on] = px, py
    return x, y, known


def _sharpness(events: EventArray, pieces: Sequence[Piece]) -> float:
    """Variance of the image of carried events over that of the same events where they fired."""
    shape = (events.height, events.width)
    part = events.slice_time(pieces[0][2], pieces[-1][3])
    x, y, known = _carried(part.x, part.y, part.t, pieces)
    variances = []
    for at in ((x, y), (part.x, part.y)):
        u, v = (np.rint(each[known]).astype(np.intp) for each in at)
        inside = (u >= 0) & (v >= 0) & (u < shape[1]) & (v < shape[0])
        counts = np.bincount(v[inside] * shape[1] + u[inside], minlength=shape[0] * shape[1])
        variances.append(float(counts.var()))
    return variances[0] / variances[1] if variances[1] > 0 else float("nan")


def fwl(
    events: EventArray,
    flow: npt.ArrayLike,
    *,
    start_us: int,
    end_us: int,
    mask: npt.ArrayLike | None = None,
) -> float:
    """Flow warp loss: how much sharper events become when the flow carries them back.

    ``var(image of carried events) / var(image of events)`` (T. Stoffregen et al., Reducing the sim-to-real
    gap for event cameras, ECCV 2020, section 4.1): above 1 where the flow aligns them. Events of both
    polarities count alike, so that flipped polarities change nothing. An event goes to the nearest pixel, as
    in the measure of J. Hagenaars et al. (NeurIPS 2021): shares between four pixels would blur, and be below
    1 for the best flow too. It grows with the motion in the window; compare only equal windows.

    Parameters
    ----------
    events : EventArray
        Those with ``start_us <= t < end_us`` count.
    flow : array_like
        (H, W, 2), pixels from ``start_us`` to ``end_us``, x right, y down, of what is there at ``start_us``.
    start_us, end_us : int
        The flow's interval in microseconds.
    mask : array_like, optional
        (H, W), where the flow is defined; events from elsewhere do not count. Everywhere where not given.

    Returns
    -------
    float
        Above 0; nan where no event counts or their image is even.

    Raises
    ------
    ConfigError
        If shapes do not fit, or a flow that counts is not finite.
    """
    field = np.asarray(flow, np.float32)
    shape = (events.height, events.width)
    known = np.ones(shape, bool) if mask is None else np.asarray(mask).astype(bool)
    if field.shape != (*shape, 2) or known.shape != shape or end_us <= start_us:
        raise ConfigError(
            f"flow has shape {field.shape}, mask {known.shape}, from {start_us} to {end_us} us; they must be "
            f"{(*shape, 2)} and {shape}, for a time above 0"
        )
    if not np.isfinite(field[known]).all():
        raise ConfigError("flow is not finite where it counts; give a mask")
    return _sharpness(events, [(np.where(known[..., None], field, 0), known, start_us, end_us)])


def _increments(events: EventArray, light: Float, pieces: Sequence[Piece]) -> float:
    """Correlate ON minus OFF events with the change of log light that a moving picture causes.

    Brightness constancy: log light at the end is that of the start, where the flow comes from (G. Gallego et
    al., Event-based vision: a survey, TPAMI 2022, section 2.4, before it is linearized).
    """
    height, width = light.shape
    log = np.log(light + np.float32(1e-3) * max(float(light.mean()), 1e-12))
    y, x = (axis.ravel() for axis in np.mgrid[0:height, 0:width])
    start, end = pieces[0][2], pieces[-1][3]
    px, py, known = _carried(x, y, np.full(x.size, end), pieces)
    known &= (px >= 0) & (py >= 0) & (px <= width - 1) & (py <= height - 1)
    predicted = _bilinear(log, px, py) - log.ravel()
    counted = events.event_frame(start_us=start, end_us=end).ravel()
    return ncc(counted[known], predicted[known]) if known.any() else float("nan")


def flow(
    source: Source,
    network: str | PathLike[str] | None = None,
    *,
    windows_us: Sequence[int] = (20_000, 40_000, 100_000),
    normalize: bool = True,
    skip: int = 0,
    camera: str | None = None,
    controls: Sequence[str] = CONTROLS,
) -> Evaluation:
    """Hold events against optical flow: the recording's exact flow, and a network's.

    With exact flow, ``fwl`` (see `fwl`; over several flow images each event is carried through them one by
    one) and, where the recording has ``hdr`` or ``frame`` images, ``increments``: the correlation of ON minus
    OFF events with the change of log light that the flow causes in the picture at the window's start, which
    flipped polarities turn around.

    With a network, its ``fwl`` over the time between two flow images; at pixels that fired and have a flow,
    ``epe``, its mean distance from the exact flow (`evis.metrics.endpoint_error`), ``epe_zero``, that of no
    flow at all, and ``gain``, their difference. Controls are judged by ``fwl`` and ``increments``, and by
    ``gain``.

    Parameters
    ----------
    source : Recording or path
        A recording with the label ``flow``.
    network : path, optional
        An ONNX network: a voxel grid (1, bins, H, W) of a window, or the one before and it (E-RAFT), and
        states in; flow (1, 2, H, W) in pixels per window, anchored at its start, out. The last such output
        counts.
    windows_us : sequence of int
        Microseconds per window for exact flow, multiples of the time between two flow images.
    normalize : bool
        Whether the network's grids are normalized.
    skip : int
        Windows at the start that do not count.
    camera, controls
        As in `reconstruct`.

    Returns
    -------
    Evaluation
        Rows for each window, and for ``"network"``.

    Raises
    ------
    ConfigError, OSError, FormatError
        As `reconstruct`.
    """
    recording, name = _opened(source, "source")
    view = _view(recording, camera)
    fields, masks = _images(view, ("flow_forward",)), view.labels["flow_forward_valid"]
    windows, controls = _windows(windows_us), _chosen(controls)
    skip = _check.whole("skip", skip)
    lights = next((view.labels[kind] for kind in ("hdr", "frame") if kind in view.labels), None)
    model = None
    if network is not None:
        model = VoxelNetwork(network, view.camera.height, view.camera.width, multiple=32)
    # An image whose flow leads past the last event has a window that is not full.
    last_us = int(view.events.t[-1]) + 1 + int(np.median(np.diff(fields.t_us))) // 2
    pieces: list[Piece] = []
    for k in range(len(fields)):
        start, end = fields.interval_us(k)
        if start < end <= last_us:
            known = masks[k].astype(bool)
            pieces.append((np.where(known[..., None], fields[k], 0), known, start, end))
    rows: list[Row] = []
    for window in windows:
        every = _every(fields, window, "a window")
        spans = [pieces[k : k + every] for k in range(0, len(pieces) - every + 1, every)][skip:]
        if len(spans) < 3:
            raise ConfigError(
                f"there are {len(spans)} windows of {window} us with flow after {skip} skipped ones; it must "
                "be at least 3: record longer, or skip fewer"
            )
        exact: dict[str, list[dict[str, float]]] = {}
        for stream, events in _streams(view.events, controls):
            exact[stream] = []
            for span in spans:
                scores = {"fwl": _sharpness(events, span)}
                if lights is not None:
                    light = luminance(lights[int(np.abs(lights.t_us - span[0][2]).argmin())])
                    scores["increments"] = _increments(events, light, span)
                exact[stream].append(scores)
        rows += _rows(f"{window / 1000:g} ms", exact, ("fwl", "increments"))
    used = {}
    if model is not None:
        used["network"] = _named(model.network)
        seen = {
            stream: _network_flow(model, view.events, events, pieces, normalize)[skip:]
            for stream, events in _streams(view.events, controls)
        }
        rows += _rows("network", seen, ("fwl", "gain"))
    settings = {"camera": view.camera.name, "normalize": bool(normalize), "skip": skip}
    return Evaluation("flow", name, used, settings, tuple(rows))


def _network_flow(
    model: VoxelNetwork, real: EventArray, events: EventArray, pieces: Sequence[Piece], normalize: bool
) -> list[dict[str, float]]:
    """Score a network's flow of each window."""
    model.reset()
    scores, before = [], None
    for field, known, start, end in pieces:
        grid = events.voxel_grid(model.bins, normalize=normalize, start_us=start, end_us=end)
        made = [out for out in model.run(grid, before) if out.ndim == 4 and out.shape[1] == 2]
        before = grid
        fitting = [out for out in made if out.shape[2:] == grid.shape[1:]]
        if not fitting or not np.isfinite(fitting[-1]).all():
            raise ConfigError(
                f"{model.network.path.name} gives {[out.shape for out in made]}; it must give finite flow "
                f"(1, 2, {grid.shape[1]}, {grid.shape[2]})"
            )
        found = np.ascontiguousarray(fitting[-1][0].transpose(1, 2, 0), np.float32)
        # The same pixels for all streams: those that fired, and whose flow is known.
        fired = (real.counts(start_us=start, end_us=end).sum(axis=0) > 0) & known
        epe = zero = float("nan")
        if fired.any():
            epe = metrics.endpoint_error(found, field, mask=fired).mean
            zero = metrics.endpoint_error(np.zeros_like(field), field, mask=fired).mean
        sharp = _sharpness(events, [(found, known, start, end)])
        scores.append({"fwl": sharp, "epe": epe, "epe_zero": zero, "gain": zero - epe})
    return scores


def pose_auc(errors_degrees: Sequence[float], limit_degrees: float) -> float:
    """Area under the curve of recall over pose error, up to a limit, as a part of the largest one.

    As SuperGlue and LoFTR (J. Sun et al., CVPR 2021) count it: recall rises by 1 / N at each error, straight
    between them.

    Parameters
    ----------
    errors_degrees : sequence of float
        One per pair of views: the larger one of the angles between rotations and between translations; inf
        where no pose was found.
    limit_degrees : float
        Above 0.

    Returns
    -------
    float
        0 to 1; nan without errors.
    """
    if not len(errors_degrees):
        return float("nan")
    errors = np.concatenate([[0.0], np.sort(np.asarray(errors_degrees, np.float64))])
    recall = np.linspace(0.0, 1.0, len(errors))
    last = int(np.searchsorted(errors, limit_degrees))
    x = np.append(errors[:last], limit_degrees)
    y = np.append(recall[:last], recall[last - 1])
    return float(((x[1:] - x[:-1]) * (y[1:] + y[:-1]) / 2).sum() / limit_degrees)


@dataclass(frozen=True, slots=True)
class _Place:
    """A camera at a time, with its depth: pixels of it go to pixels of another."""

    lens: npt.NDArray[np.float64]
    world_from_camera: npt.NDArray[np.float64]
    depth: Float

    def moved(self, other: _Place, places: Points) -> npt.NDArray[np.float64]:
        """Return where the other sees what is at places here, (N, 9, 2): by the depth of 3x3 pixels around.

        What lies on an outline belongs to either side.
        """
        height, width = self.depth.shape
        at = np.floor(places).astype(np.intp)
        dy, dx = np.mgrid[-1:2, -1:2].reshape(2, 9)
        x = np.clip(at[:, :1] + dx, 0, width - 1)
        y = np.clip(at[:, 1:] + dy, 0, height - 1)
        # What shows nothing is far away.
        z = np.minimum(self.depth[y, x].astype(np.float64), 1e6)
        ray = np.concatenate([places, np.ones((len(places), 1))], axis=1) @ np.linalg.inv(self.lens).T
        points = ray[:, None] * z[..., None] @ _FLIP
        there = np.linalg.inv(other.world_from_camera) @ self.world_from_camera
        points = (points @ there[:3, :3].T + there[:3, 3]) @ _FLIP
        behind = points[..., 2] <= 1e-9
        pixels = points @ other.lens.T
        with np.errstate(divide="ignore", invalid="ignore"):
            found: npt.NDArray[np.float64] = pixels[..., :2] / pixels[..., 2:]
        found[behind] = np.inf
        return found

    def pose_to(self, other: _Place) -> npt.NDArray[np.float64]:
        """Return other-from-self, (4, 4), in OpenCV's axes: x right, y down, z ahead."""
        flip = np.eye(4)
        flip[:3, :3] = _FLIP
        found: npt.NDArray[np.float64] = (
            flip @ np.linalg.inv(other.world_from_camera) @ self.world_from_camera @ flip
        )
        return found


_FLIP = np.diag([1.0, -1.0, -1.0])
"""From the camera's axes, which looks along -Z with +Y up, to those of pictures, and back."""


def _places(view: RecordedView) -> list[_Place]:
    depth, poses = _images(view, ("depth",)), view.poses
    if not np.array_equal(poses.t_us, depth.t_us):
        raise ConfigError(f"camera '{view.camera.name}' has poses and depth at other times; record again")
    return [_Place(view.camera.matrix, matrix, depth[k]) for k, matrix in enumerate(poses.matrix)]


def _moving(view: RecordedView, k: int) -> npt.NDArray[np.bool_]:
    """Return the pixels of image ``k`` that move by themselves, and those beside."""
    depth, poses = view.labels["depth"], view.poses.matrix
    height, width = depth[k].shape
    moving = np.zeros((height + 2, width + 2), bool)
    if "flow_forward" in view.labels and k + 1 < len(depth):
        here, there = (_Place(view.camera.matrix, poses[i], depth[i]) for i in (k, k + 1))
        y, x = np.mgrid[0:height, 0:width]
        centres = np.stack([x.ravel(), y.ravel()], axis=1) + 0.5
        # The fifth of nine is the pixel's own depth.
        still = here.moved(there, centres)[:, 4] - centres
        off = view.labels["flow_forward"][k].reshape(-1, 2) - still
        known = view.labels["flow_forward_valid"][k].astype(bool)
        moving[1:-1, 1:-1] = (np.hypot(*off.T) > 0.1).reshape(height, width) & known
    beside = [moving[dy : dy + height, dx : dx + width] for dy in range(3) for dx in range(3)]
    return np.asarray(np.logical_or.reduce(beside))


def _pose_error(one: Points, other: Points, place: _Place, there: _Place) -> float:
    """Return the larger one of the angles of rotation and translation, degrees; inf without a pose."""
    cv2 = opencv()
    truth = place.pose_to(there)
    if len(one) < 5:
        return float("inf")
    flat = [
        (np.concatenate([p, np.ones((len(p), 1))], axis=1) @ np.linalg.inv(v.lens).T)[:, :2]
        for p, v in ((one, place), (other, there))
    ]
    cv2.setRNGSeed(0)
    limit = 1.0 / float(np.mean([place.lens[0, 0], there.lens[0, 0]]))
    essential, inside = cv2.findEssentialMat(
        *flat, np.eye(3), method=cv2.RANSAC, prob=0.99999, threshold=limit
    )
    best, error = -1, float("inf")
    for each in np.split(essential, len(essential) // 3) if essential is not None else []:
        count, turn, shift, _ = cv2.recoverPose(each, *flat, np.eye(3), 1e9, mask=inside.copy())[:4]
        if count > best:
            best = count
            cosines = [
                (np.trace(turn.T @ truth[:3, :3]) - 1) / 2,
                float(shift[:, 0] @ truth[:3, 3] / max(np.linalg.norm(truth[:3, 3]), 1e-12)),
            ]
            error = float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max())
    return error


def match(
    source: Source,
    network: str | PathLike[str],
    *,
    reconstructor: str | PathLike[str] | None = None,
    window_us: int = 20_000,
    apart_us: int = 200_000,
    pairs: int = 10,
    normalize: bool = True,
    post: Normalization = "none",
    skip: int = 10,
    cameras: Sequence[str] | None = None,
    controls: Sequence[str] = CONTROLS,
) -> Evaluation:
    """Match views, and hold matches against exact correspondence from depth and poses.

    Views are those of one camera ``apart_us`` apart, and those of two cameras at one time where the recording
    has two. A match is right if it is within 1, 3, 5 pixels of where the point is (``precision_1px`` and so
    on): by the depth of its pixel, or of one beside it, since a point on an outline belongs to either side.
    Matches on what moves by itself are left out. ``auc_5deg`` and so on are `pose_auc` of poses from
    essential matrices (OpenCV, RANSAC with 1 pixel), with the larger one of the angles of rotation and of
    translation.

    In controls the second view's events are changed, the first view's are not. They are judged by
    ``precision_3px`` and ``precision_1px``. Rows of ``"rendered frames"`` show what the network does with
    pictures in place of events.

    Parameters
    ----------
    source : Recording or path
        A recording with ``depth`` and, to see what moves, ``flow``; with ``hdr`` for rows of rendered frames.
    network : path
        An ONNX network: one picture in, and XFeat's outputs; or two pictures or voxel grids in, and the
        places of matches out.
    reconstructor : path, optional
        A network that makes the pictures from events, as in `reconstruct`. Without one, pictures are of ON
        minus OFF events in a window, for networks that take pictures.
    window_us : int
        Microseconds of events per picture or grid, a multiple of the time between two depth images.
    apart_us : int
        Microseconds between two views of one camera, a multiple of ``window_us``.
    pairs : int
        Pairs of views, at most, spread evenly.
    normalize, post, skip
        As in `reconstruct`.
    cameras : sequence of str, optional
        One camera, or two; the first two where not given.
    controls : sequence of str
        Of `CONTROLS`.

    Returns
    -------
    Evaluation
        Rows for ``"200 ms apart"`` and, with two cameras, ``"stereo"``.

    Raises
    ------
    ConfigError, OSError, FormatError
        As `reconstruct`.
    """
    recording, name = _opened(source, "source")
    controls = _chosen(controls)
    names = list(recording)[:2] if cameras is None else _check.items("cameras", cameras, "['left', 'right']")
    if not 1 <= len(names) <= 2:
        raise ConfigError(f"cameras is {names}; it must name one or two cameras")
    views = [_view(recording, each) for each in names]
    count, skip = _check.whole("pairs", pairs, 1), _check.whole("skip", skip)
    sizes = {(view.camera.height, view.camera.width) for view in views}
    if len(sizes) > 1:
        raise ConfigError("the cameras have different sizes; the network takes both pictures in one size")
    height, width = sizes.pop()
    model = MatchNetwork(network, height, width)
    used = {"network": _named(model.network)}
    maker = None if reconstructor is None else VoxelNetwork(reconstructor, height, width)
    if maker is not None:
        used["reconstructor"] = _named(maker.network)
    depth = _images(views[0], ("depth",))
    every = _every(depth, _check.whole("window_us", window_us, 1), "window_us")
    apart = round(_check.whole("apart_us", apart_us, 1) / window_us)
    if apart < 1 or apart * window_us != apart_us:
        raise ConfigError(f"apart_us is {apart_us}; it must be a multiple of window_us, {window_us}")
    edges = depth.t_us[::every]
    last = len(edges) - 1
    if last < skip + apart + 1:
        raise ConfigError(
            f"there are {last} windows, {skip} are skipped, and pairs are {apart} apart: record at least "
            f"{(skip + apart + 2) * window_us / 1e6:g} s, or skip fewer"
        )
    places = [_places(view)[::every] for view in views]
    lights = [view.labels["hdr"] for view in views if "hdr" in view.labels and model.channels in (1, 3)]
    jobs = [(f"{apart_us / 1000:g} ms apart", 0, apart)]
    if len(views) == 2:
        jobs.append(("stereo", 1, 0))
    rows: list[Row] = []
    for setting, second, step in jobs:
        most = min(count, last - step - skip)
        chosen = np.unique(np.linspace(skip + 1, last - step, most).round().astype(int)).tolist()
        then = [k + step for k in chosen]
        moving = [_moving(views[0], every * k) for k in chosen]

        def shots(events: EventArray, ks: list[int]) -> list[Any]:
            made = _pictures(model, maker, events, edges[: max(ks) + 1], normalize, post)
            return [model.prepare(made(k - 1)) for k in ks]

        here = shots(views[0].events, chosen)
        found: dict[str, list[dict[str, float]]] = {}
        for stream, events in _streams(views[second].events, controls):
            found[stream] = _matched(
                model, here, shots(events, then), moving, places[0], places[second], chosen, step
            )
        if len(lights) == len(views):
            seen, there = (
                [model.prepare(tone_map(luminance(lights[view][every * k]))) for k in ks]
                for view, ks in ((0, chosen), (second, then))
            )
            found[RENDERED] = _matched(model, seen, there, moving, places[0], places[second], chosen, step)
        rows += _rows(setting, found, ("precision_3px", "precision_1px"))
    settings = {
        "cameras": [view.camera.name for view in views],
        "window_us": window_us,
        "apart_us": apart_us,
        "normalize": bool(normalize),
        "post": post,
        "skip": skip,
    }
    return Evaluation("match", name, used, settings, tuple(rows))


def _pictures(
    model: MatchNetwork,
    maker: VoxelNetwork | None,
    events: EventArray,
    edges: npt.NDArray[np.int64],
    normalize: bool,
    post: Normalization,
) -> Callable[[int], Float]:
    """Return what the network is shown of a window, by its index."""
    if maker is not None:
        return _reconstructed(maker, events, edges, normalize, post).__getitem__

    def shown(k: int) -> Float:
        start, end = int(edges[k]), int(edges[k + 1])
        if model.channels not in (1, 3):
            return events.voxel_grid(model.channels, normalize=normalize, start_us=start, end_us=end)
        frame = events.event_frame(start_us=start, end_us=end).astype(np.float32)
        # Grey where nothing fired; most pixels that did are within three deviations.
        return np.asarray(np.clip(0.5 + frame / max(6 * float(frame.std()), 1e-6), 0, 1), np.float32)

    return shown


def _matched(
    model: MatchNetwork,
    here: list[Any],
    there: list[Any],
    moving: list[npt.NDArray[np.bool_]],
    places: list[_Place],
    others: list[_Place],
    chosen: list[int],
    step: int,
) -> list[dict[str, float]]:
    """Match pairs of views, and score each."""
    scores, errors = [], []
    for first, second, moves, k in zip(here, there, moving, chosen, strict=True):
        one, other = model.match(first, second)
        height, width = moves.shape
        x, y = np.floor(one).astype(np.intp).T
        inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        inside[inside] = ~moves[y[inside], x[inside]]
        one, other = one[inside], other[inside]
        off = np.linalg.norm(places[k].moved(others[k + step], one) - other[:, None], axis=2).min(axis=1)
        shares = {
            f"precision_{limit}px": float((off < limit).mean()) if len(off) else float("nan")
            for limit in (1, 3, 5)
        }
        scores.append({"matches": float(len(off)), **shares})
        errors.append(_pose_error(one, other, places[k], others[k + step]))
    aucs = {f"auc_{limit}deg": pose_auc(errors, limit) for limit in (5, 10, 20)}
    return [{**score, **aucs} for score in scores]
