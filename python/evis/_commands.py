"""The commands of ``evis`` that are written in Python: ``evis evaluate``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress

from . import evaluate
from ._evis import EvisError

HELP = """
Commands in Python:
  evaluate   Ask networks whether they accept a recording's events: reconstruction, flow, matching
"""
"""What ``evis --help`` says beside the help of ``evis-rs``."""


def _milliseconds(text: str) -> int:
    """Return microseconds of an argument in milliseconds."""
    with suppress(ValueError):
        time_us = float(text) * 1000
        if 1 <= time_us < 2**32:
            return round(time_us)
    raise argparse.ArgumentTypeError(f"it is {text!r}; it must be a time in milliseconds, such as 20")


def _times(text: str) -> list[int]:
    return [_milliseconds(part) for part in text.split(",")]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="evis evaluate",
        description="Ask networks (ONNX files, run by onnxruntime) whether they accept a recording's events.",
        epilog="Exit codes: 0 done; 2 bad input (arguments, files, a missing package); 1 a control does not "
        "fail, so that the other figures say nothing.",
    )
    tasks = parser.add_subparsers(dest="task", required=True, metavar="TASK")
    reconstruct = tasks.add_parser("reconstruct", help="reconstruct pictures, and compare them with frames")
    flow = tasks.add_parser("flow", help="hold events against exact optical flow, and a network's")
    match = tasks.add_parser("match", help="match views 200 ms apart, and of two cameras")
    for task in (reconstruct, flow, match):
        task.add_argument("file", metavar="FILE", help="a recording with labels, as evis run writes them")
        task.add_argument("--no-controls", action="store_true", help="leave the controls out")
        task.add_argument("--json", action="store_true", help="print JSON in place of a table")
        task.add_argument("--skip", type=int, metavar="N", help="windows at the start that do not count")
        task.add_argument("--no-normalize", action="store_true", help="do not normalize voxel grids")
        task.add_argument("--network", metavar="N.onnx", required=task is not flow, help="the network")
    for task, windows in ((reconstruct, "20,40"), (flow, "20,40,100")):
        task.add_argument(
            "--windows-ms", type=_times, metavar="MS,MS", help=f"windows in milliseconds ({windows})"
        )
        task.add_argument("--camera", metavar="NAME", help="the camera (the first)")
    for task in (reconstruct, match):
        task.add_argument(
            "--post",
            choices=["none", "standard", "robust", "exprobust"],
            default="none",
            help="what EVREAL does to reconstructions before they are compared (%(default)s)",
        )
    reconstruct.add_argument(
        "--lpips", metavar="L.onnx", help="a network for LPIPS: two pictures to a number"
    )
    match.add_argument("--reconstructor", metavar="R.onnx", help="a network that makes pictures of events")
    match.add_argument("--window-ms", type=_milliseconds, metavar="MS", help="events per picture (20)")
    match.add_argument("--apart-ms", type=_milliseconds, metavar="MS", help="time between two views (200)")
    match.add_argument("--pairs", type=int, metavar="N", help="pairs of views, at most (10)")
    match.add_argument("--cameras", metavar="A,B", help="one camera, or two (the first two)")
    return parser


def run_evaluate(arguments: Sequence[str]) -> int:
    """Run ``evis evaluate`` and return its exit code."""
    given = vars(_parser().parse_args(arguments))
    task, file = given.pop("task"), given.pop("file")
    as_json, network = given.pop("json"), given.pop("network")
    settings = {name: value for name, value in given.items() if value is not None}
    settings["normalize"] = not settings.pop("no_normalize")
    if settings.pop("no_controls"):
        settings["controls"] = ()
    for name in ("windows_ms", "window_ms", "apart_ms"):
        if name in settings:
            settings[f"{name[:-3]}_us"] = settings.pop(name)
    if "cameras" in settings:
        settings["cameras"] = settings["cameras"].split(",")
    run: Callable[..., evaluate.Evaluation] = getattr(evaluate, task)
    try:
        found = run(file, network, **settings)
    except (EvisError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(found.to_json(indent=2) if as_json else found)
    if found.controls_fail is False:
        wrong = sorted({f"{row.stream} ({row.setting})" for row in found.rows if row.fails is False})
        print(f"error: these controls do not fail: {', '.join(wrong)}", file=sys.stderr)
        return 1
    return 0
