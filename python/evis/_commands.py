"""The commands of ``evis`` that are written in Python: ``evaluate``, ``view``, ``plot`` and ``dataset``."""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from . import _check, dataset, evaluate, plot, rerun
from ._evaluate_scenes import scene_named
from ._events import EventArray
from ._evis import ConfigError, EvisError, printable
from ._files import load
from ._scene import Scene, scenes

_COLUMNS = 99


class _Parser(argparse.ArgumentParser):
    """A parser with headings and examples, whose errors name the choice that was probably meant."""

    def __init__(
        self, *, examples: Sequence[str] = (), description: str = "", epilog: str = "", **options: Any
    ) -> None:
        shown = [f"  evis {example}" for example in examples]
        parts = ["\n".join(["Examples:", *shown]) if shown else "", textwrap.fill(epilog, _COLUMNS)]
        super().__init__(
            description=textwrap.fill(description, _COLUMNS),
            epilog="\n\n".join(part for part in parts if part),
            formatter_class=partial(
                argparse.RawDescriptionHelpFormatter, max_help_position=30, width=_COLUMNS
            ),
            **options,
        )
        self._positionals.title, self._optionals.title = "Input", "Options"

    def format_help(self) -> str:
        """Return the help as the other commands have it: dense, and without the line on ``--help``."""
        named = [(action.metavar, action.nargs) for action in self._positionals._group_actions]
        places = [f"[{metavar}]" if nargs == "?" else str(metavar) for metavar, nargs in named]
        usage, self.usage = self.usage, " ".join(["%(prog)s", "[OPTIONS]", *places])
        lines = super().format_help().splitlines()
        self.usage = usage
        shown = (line for line in lines if line.strip() and line != "Options:")
        return "".join(f"{line}\n" for line in shown if not line.startswith("  -h, --help"))

    def headed(self, heading: str) -> argparse._ArgumentGroup:
        """Return the options under ``heading``."""
        known = [group for group in self._action_groups if group.title == heading]
        return known[0] if known else self.add_argument_group(heading)

    def error(self, message: str) -> NoReturn:
        wrong = re.search(r"invalid choice: '([^']*)' \(choose from ([^)]*)\)", message)
        if wrong is not None:
            known = [name.strip(" '") for name in wrong[2].split(",")]
            message += _check.did_you_mean(wrong[1], known)
        super().error(message)


def _milliseconds(text: str) -> int:
    """Return microseconds of an argument in milliseconds."""
    with suppress(ValueError):
        time_us = float(text) * 1000
        if 1 <= time_us < 2**32:
            return round(time_us)
    raise argparse.ArgumentTypeError(f"it is {text!r}; it must be a time in milliseconds, such as 20")


def _times(text: str) -> list[int]:
    return [_milliseconds(part) for part in text.split(",")]


def _size(text: str) -> tuple[int, int]:
    """Return a width and a height in pixels."""
    with suppress(ValueError):
        width, height = map(int, text.split("x"))
        return width, height
    raise argparse.ArgumentTypeError(f"it is {text!r}; it must be width x height, such as 320x240")


_QUALITIES = ("draft", "standard", "high", "reference")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="evis evaluate",
        examples=["evaluate reconstruct events.h5 --network firenet.onnx", "evaluate flow events.h5"],
        description="Ask networks (ONNX files, run by onnxruntime) whether they accept a recording's events.",
        epilog="Exit codes: 0 done; 2 bad input (arguments, files, a missing package); 1 a control does not "
        "fail, so that the other figures say nothing.",
    )
    tasks = parser.add_subparsers(dest="task", required=True, metavar="TASK")
    reconstruct = tasks.add_parser(
        "reconstruct",
        help="reconstruct pictures, and compare them with frames",
        examples=[
            "evaluate reconstruct events.h5 --network firenet.onnx",
            "evaluate reconstruct spinner --network firenet.onnx --ladder --figure ladder.png",
        ],
    )
    flow = tasks.add_parser(
        "flow",
        help="hold events against exact optical flow, and a network's",
        examples=["evaluate flow events.h5", "evaluate flow events.h5 --network flow.onnx --windows-ms 50"],
    )
    match = tasks.add_parser(
        "match",
        help="match views 200 ms apart, and of two cameras",
        examples=["evaluate match events.h5 --network xfeat.onnx --cameras left,right"],
    )
    for task in (reconstruct, flow, match):
        task.add_argument(
            "source",
            metavar="SCENE_OR_FILE",
            help="a recording with labels, as evis run writes them; or a built-in scene or scene file, "
            "which is simulated",
        )
        scene, output = task.headed("Scene"), task.headed("Output")
        windows, networks = task.headed("Windows and cameras"), task.headed("Networks")
        scene.add_argument("--size", type=_size, metavar="WxH", help="of a scene: pixels (320x240)")
        scene.add_argument("--duration", type=float, metavar="S", help="of a scene: seconds (1)")
        scene.add_argument("--quality", choices=_QUALITIES, help="of a scene: the preset (draft)")
        scene.add_argument(
            "--ladder",
            action="store_true",
            help="of a scene: once for each of: " + ", ".join(evaluate.LADDER),
        )
        output.add_argument("--figure", metavar="OUT.png", help="with --ladder: draw it")
        output.add_argument("--no-controls", action="store_true", help="leave the controls out")
        output.add_argument("--json", action="store_true", help="print JSON in place of a table")
        windows.add_argument("--skip", type=int, metavar="N", help="windows at the start that do not count")
        networks.add_argument("--no-normalize", action="store_true", help="do not normalize voxel grids")
        networks.add_argument("--network", metavar="N.onnx", required=task is not flow, help="the network")
    for task, usual in ((reconstruct, "20,40"), (flow, "20,40,100")):
        task.headed("Windows and cameras").add_argument(
            "--windows-ms", type=_times, metavar="MS,MS", help=f"windows in milliseconds ({usual})"
        )
        task.headed("Windows and cameras").add_argument(
            "--camera", metavar="NAME", help="the camera (the first)"
        )
    for task in (reconstruct, match):
        task.headed("Networks").add_argument(
            "--post",
            choices=["none", "standard", "robust", "exprobust"],
            default="none",
            help="what EVREAL does to reconstructions before they are compared (%(default)s)",
        )
    reconstruct.headed("Networks").add_argument(
        "--lpips", metavar="L.onnx", help="a network for LPIPS: two pictures to a number"
    )
    networks, windows = match.headed("Networks"), match.headed("Windows and cameras")
    networks.add_argument("--reconstructor", metavar="R.onnx", help="a network that makes pictures of events")
    windows.add_argument("--window-ms", type=_milliseconds, metavar="MS", help="events per picture (20)")
    windows.add_argument("--apart-ms", type=_milliseconds, metavar="MS", help="time between two views (200)")
    windows.add_argument("--pairs", type=int, metavar="N", help="pairs of views, at most (10)")
    windows.add_argument("--cameras", metavar="A,B", help="one camera, or two (the first two)")
    return parser


def _scene_of(source: str) -> Scene:
    scene = scene_named(source)
    if scene is None:
        raise ConfigError(
            f"'{source}' is no scene; --ladder simulates one: {', '.join(scenes())}, or a .toml, .glb or "
            f".gltf file{_check.did_you_mean(source, scenes())}"
        )
    return scene


def _evaluated(
    task: str,
    source: str,
    network: str | None,
    scene_settings: Mapping[str, Any],
    settings: Mapping[str, Any],
) -> evaluate.Evaluation:
    """Evaluate a recording, or a scene that is recorded for it."""
    run: Callable[..., evaluate.Evaluation] = getattr(evaluate, task)
    scene = scene_named(source)
    if scene is None:
        if scene_settings:
            raise ConfigError(
                f"--size, --duration and --quality are for scenes, and '{source}' is none; leave them out, "
                f"or give one of {', '.join(scenes())}"
            )
        if not Path(source).exists():
            raise FileNotFoundError(
                f"{source} does not exist; give a recording, one of the scenes {', '.join(scenes())}, or a "
                f"scene file{_check.did_you_mean(source, scenes())}"
            )
        return run(source, network, **settings)
    evaluate.check_network(network)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{scene.name.replace('/', '_')}.h5"
        evaluate.record(scene, path, task, progress=True, **scene_settings)
        return run(path, network, **settings)


def run_evaluate(arguments: Sequence[str]) -> int:
    """Run ``evis evaluate`` and return its exit code."""
    given = vars(_parser().parse_args(arguments))
    task, source = given.pop("task"), given.pop("source")
    as_json, network = given.pop("json"), given.pop("network")
    as_ladder, picture = given.pop("ladder"), given.pop("figure")
    scene_settings = {
        own: value
        for name, own in (("size", "size"), ("duration", "duration_s"), ("quality", "quality"))
        if (value := given.pop(name)) is not None
    }
    settings = {name: value for name, value in given.items() if value is not None}
    settings["normalize"] = not settings.pop("no_normalize")
    if settings.pop("no_controls"):
        settings["controls"] = ()
    for name in ("windows_ms", "window_ms", "apart_ms"):
        if name in settings:
            settings[f"{name[:-3]}_us"] = settings.pop(name)
    if "cameras" in settings:
        settings["cameras"] = settings["cameras"].split(",")
    try:
        if picture is not None and not as_ladder:
            raise ConfigError("--figure draws a ladder; add --ladder")
        if as_ladder:
            if "quality" in scene_settings:
                raise ConfigError("--ladder has presets among its settings; leave --quality out")
            _check_picture("--figure", picture or "ladder.png")
            rungs = evaluate.ladder(
                task, _scene_of(source), network, progress=True, **scene_settings, **settings
            )
            if picture is not None:
                _save_figure(rungs.figure(), Path(picture))
            found: evaluate.Evaluation | evaluate.Ladder = rungs
        else:
            found = _evaluated(task, source, network, scene_settings, settings)
    except (EvisError, OSError) as error:
        _complain(error)
        return 2
    print(found.to_json(indent=2) if as_json else printable(str(found)))
    if found.controls_fail is False:
        one_by_one = found.evaluations if isinstance(found, evaluate.Ladder) else {"": found}
        wrong = sorted(
            {
                f"{f'{name}: ' if name else ''}{row.stream} ({row.setting})"
                for name, each in one_by_one.items()
                for row in each.rows
                if row.fails is False
            }
        )
        print(f"error: these controls do not fail: {', '.join(wrong)}", file=sys.stderr)
        return 1
    return 0


def _seconds(text: str) -> int:
    """Return microseconds of an argument in seconds."""
    with suppress(ValueError):
        time_us = float(text) * 1e6
        if abs(time_us) < 2**52:
            return round(time_us)
    raise argparse.ArgumentTypeError(f"it is {text!r}; it must be a time in seconds, such as 0.5")


def _part(parser: _Parser, camera: str) -> None:
    """Add the options that choose a part of a recording."""
    part = parser.headed("Part of the recording")
    part.add_argument("--camera", metavar="NAME", help=f"the camera ({camera})")
    part.add_argument("--start", type=_seconds, metavar="S", help="where to start, seconds (at the start)")
    part.add_argument("--duration", type=_seconds, metavar="S", help="how much, seconds (to the end)")


def _end_us(given: argparse.Namespace) -> int | None:
    """Return one past the last microsecond that is asked for."""
    if given.duration is None:
        return None
    if given.duration <= 0:
        raise ConfigError(f"--duration is {given.duration / 1e6:g}; it must be above 0 seconds")
    return int((given.start or 0) + given.duration)


def _view_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="evis view",
        examples=["view events.h5", "view events.h5 --save events.rrd --start 0.1 --duration 0.2"],
        description="Show a recording in the viewer Rerun: events, frames, depth, flow, camera and poses on "
        "one timeline; of files of other programs, events.",
        epilog="Exit codes: 0 done; 2 bad input (arguments, files, a missing package, no display).",
    )
    parser.add_argument("file", metavar="FILE", help="a file of events of any format")
    parser.headed("Output").add_argument(
        "--save", metavar="OUT.rrd", help="write a file for the viewer; needs no display"
    )
    parser.headed("Output").add_argument(
        "--window-ms", type=_milliseconds, default=10_000, metavar="MS", help="events per picture (10)"
    )
    _part(parser, "all")
    return parser


def run_view(arguments: Sequence[str]) -> int:
    """Run ``evis view`` and return its exit code."""
    given = _view_parser().parse_args(arguments)
    rows = rerun.view(
        given.file,
        save=given.save,
        window_us=given.window_ms,
        camera=given.camera,
        start_us=given.start,
        end_us=_end_us(given),
        progress=True,
    )
    if given.save:
        print(given.save)
    for path, count in rows.items():
        print(f"{count:8}  {path}")
    return 0


_PICTURES = (".png", ".jpg", ".svg", ".pdf")
_WINDOWS = {"thumbnails": "window_us", "surface": "tau_us", "rates": "bin_us"}
"""What ``--window-ms`` is to each plot that has such a time."""


def _plot_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="evis plot",
        examples=[
            "plot events.h5 -o events.png",
            "plot events.h5 -o rates.svg --kind rates",
            "plot events.raw --video cloud.mp4 --kind xyt --slow 20",
        ],
        description="Draw the events of a recording, as a picture or as a film.",
        epilog="Exit codes: 0 done; 2 bad input (arguments, files, a missing package).",
    )
    parser.add_argument("file", metavar="FILE", help="a file of events of any format")
    parser.headed("Output").add_argument(
        "-o", "--output", metavar="OUT", help=f"the picture: {', '.join(_PICTURES)}"
    )
    parser.headed("Output").add_argument("--video", metavar="OUT.mp4", help="the film")
    parser.headed("Picture").add_argument(
        "--kind",
        choices=list(plot.KINDS),
        help=f"what is drawn (summary; films: {', '.join(plot.FILMS)}, of which the first)",
    )
    parser.headed("Picture").add_argument(
        "--window-ms",
        type=_milliseconds,
        metavar="MS",
        help="events per frame or thumbnail; time in which a surface fades to 1/e; bin of rates",
    )
    parser.headed("Picture").add_argument("--fps", type=float, help="frames per second of a film (30)")
    parser.headed("Picture").add_argument("--slow", type=float, metavar="N", help="so many times slower (1)")
    _part(parser, "the first")
    return parser


def _events_of(given: argparse.Namespace) -> EventArray:
    """Read the events that are asked for."""
    end_us = _end_us(given)
    recording = load(given.file, camera=given.camera)
    view = next(iter(recording.values())) if given.camera is None else recording[given.camera]
    if not len(view):
        raise ConfigError(
            f"{given.file}: camera '{view.camera.name}' has no events; there is nothing to draw"
        )
    start_us = -_check.MOST_US if given.start is None else given.start
    events = view.slice_time(start_us, _check.MOST_US if end_us is None else end_us)
    if not len(events):
        first, last = (int(view.events.t[at]) / 1e6 for at in (0, -1))
        raise ConfigError(
            f"{given.file}: camera '{view.camera.name}' has no events in that part, but from {first} s to "
            f"{last} s; choose another --start or --duration"
        )
    return events


def _same_file(a: str, b: str) -> bool:
    with suppress(OSError):
        return Path(a).samefile(b)
    return False


def _check_picture(option: str, name: str) -> None:
    if Path(name).suffix.lower() not in _PICTURES:
        raise ConfigError(f"{option} is {name}; it must end with {', '.join(_PICTURES)}")


def _save_figure(figure: Any, path: Path) -> None:
    part = path.with_name(f"{path.name}.part")
    try:
        figure.savefig(part, format=path.suffix[1:].lower())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _draw(given: argparse.Namespace) -> str:
    """Write a picture, and say what it shows."""
    path, kind = Path(given.output), given.kind or "summary"
    options: dict[str, Any] = {}
    _check_picture("--output", given.output)
    if given.window_ms is not None and not given.video:
        if kind not in _WINDOWS:
            raise ConfigError(
                f"--window-ms says nothing for --kind {kind}; it does for {', '.join(_WINDOWS)} and films, "
                "and --start and --duration choose a part"
            )
        options[_WINDOWS[kind]] = given.window_ms
    events = _events_of(given)
    figure = plot.KINDS[kind](events, **options)
    _save_figure(figure, path)
    return f"{kind} of {len(events)} events"


def run_plot(arguments: Sequence[str]) -> int:
    """Run ``evis plot`` and return its exit code."""
    parser = _plot_parser()
    given = parser.parse_args(arguments)
    if not given.output and not given.video:
        parser.error("nothing is asked for; name a picture, -o OUT.png, or a film, --video OUT.mp4")
    if not given.video and (given.fps is not None or given.slow is not None):
        parser.error("--fps and --slow are for films; add --video OUT.mp4")
    for option, out in (("--output", given.output), ("--video", given.video)):
        if out and _same_file(given.file, out):
            raise ConfigError(f"{option} is the recording itself; choose another name")
    if given.output:
        print(f"{given.output}  {_draw(given)}")
    if given.video:
        options = {"fps": given.fps, "slow": given.slow, "window_us": given.window_ms, "kind": given.kind}
        chosen: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
        count = plot.video(_events_of(given), given.video, progress=True, **chosen)
        print(f"{given.video}  {count} frames")
    return 0


def _dataset_parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="evis dataset",
        examples=[
            "dataset objects2d -o data --workers 8",
            "dataset spec.toml --dry-run",
            "dataset objects2d --print > spec.toml",
            "dataset --check data",
        ],
        description="Simulate a data set: scenes x trajectories x sensors x seeds, in sharded HDF5 files "
        "with a manifest. After a kill the same command goes on; finished shards are not simulated again.",
        epilog="Exit codes: 0 done; 2 bad input (arguments, files, a missing package); 130 interrupted. "
        f"Specifications that come with EVIS: {', '.join(dataset.shipped())}.",
    )
    parser.add_argument("spec", metavar="SPEC", nargs="?", help="a TOML file, or the name of a shipped one")
    parser.headed("Output").add_argument("-o", "--output", metavar="DIR", help="the folder of the data set")
    parser.headed("Workers").add_argument(
        "--workers", type=int, metavar="N", help="processes (one per CPU); 0: this one"
    )
    parser.headed("Workers").add_argument(
        "--ray",
        nargs="?",
        const=True,
        default=False,
        metavar="ADDRESS",
        help="simulate on a Ray cluster, auto or ray://HOST:10001; without ADDRESS one on this machine",
    )
    parser.headed("Output").add_argument(
        "--force", action="store_true", help="replace shards of another specification"
    )
    parser.headed("Checks").add_argument(
        "--dry-run", action="store_true", help="check, and list what would be simulated"
    )
    parser.headed("Checks").add_argument("--print", action="store_true", help="print the specification")
    parser.headed("Checks").add_argument(
        "--check", metavar="DIR", help="compare a data set with the hashes in its manifest"
    )
    return parser


def run_dataset(arguments: Sequence[str]) -> int:
    """Run ``evis dataset`` and return its exit code."""
    parser = _dataset_parser()
    given = parser.parse_args(arguments)
    if given.check:
        held = dataset.load(given.check)
        held.check()
        print(f"{held.folder}  {len(held)} recordings are what was made")
        return 0
    if not given.spec:
        if isinstance(given.ray, str) and given.ray.endswith(".toml"):
            parser.error(f"--ray takes '{given.ray}' for its address; write the specification before --ray")
        parser.error("no specification is given; name a TOML file, or one of " + ", ".join(dataset.shipped()))
    spec = dataset.read_spec(given.spec)
    if given.print:
        print(spec.text, end="")
        return 0
    if given.dry_run:
        shards = spec.shards()
        for split in dataset.SPLITS:
            own = [shard for shard in shards if shard.split == split]
            print(
                f"{split:10} {sum(len(shard.recordings) for shard in own):8} recordings {len(own):6} shards"
            )
        return 0
    if not given.output:
        parser.error("no folder is given; write -o DIR, or --dry-run to list what would be simulated")
    begun = time.monotonic()
    made = dataset.make(
        spec, given.output, workers=given.workers, ray=given.ray, overwrite=given.force, progress=True
    )
    events, size = made.manifest["events"], made.manifest["bytes"]
    seconds = time.monotonic() - begun
    print(f"{made.folder}  {len(made)} recordings, {events} events, {size / 1e6:.1f} MB, {seconds:.1f} s")
    return 0


COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {
    "evaluate": run_evaluate,
    "view": run_view,
    "plot": run_plot,
    "dataset": run_dataset,
}
"""What runs each command, and returns its exit code."""


_OPTIONS = {
    "overwrite=True": "--force",
    "save='OUT.rrd'": "--save OUT.rrd",
}
"""Python's arguments in messages, and the options that set them here."""


def _complain(error: Exception) -> None:
    """Print an error, with options in place of Python's arguments."""
    text = str(error)
    for argument, option in _OPTIONS.items():
        text = text.replace(argument, option)
    print(f"error: {printable(text)}", file=sys.stderr)


def run(name: str, arguments: Sequence[str]) -> int:
    """Run a command and return its exit code: 2 for input that can be put right, 130 after Ctrl-C."""
    try:
        return COMMANDS[name](arguments)
    except (EvisError, OSError) as error:
        _complain(error)
        return 2
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
