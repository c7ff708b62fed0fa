"""Measure what docs/accuracy.md states: run its commands, keep their output, and fill in the tables.

Usage: tools/accuracy.py EVIS [--fill-only]
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "accuracy.md"
HISTORY = ROOT / "docs" / "notes" / "accuracy-history.md"
OUTPUTS = ROOT / "docs" / "accuracy"

COMMANDS = {
    "closed-forms": "verify -o docs/images/verify-closed-forms.png",
    "spinner-640x480": "verify --scene spinner --size 640x480 --truth-pixels 1000 --rates 250,480,1000,2000 "
    "--samples 1,4,16 -o docs/images/verify-spinner-640x480.png",
    "spinner-160x120": "verify --scene spinner -o docs/images/verify-spinner-160x120.png",
    "spinner-256-samples": "verify --scene spinner --rates 1000 --samples 256 --triggers crossing",
    "spinner-low-threshold": "verify --scene spinner --size 640x480 --truth-pixels 200 --rates 1000 "
    "--samples 16 --triggers crossing,latch --threshold-on 0.1 --threshold-off 0.1",
    "failures": "verify --failures -o docs/images/verify-failures.png",
}

TOLERANCES = ("2 ms", "1 ms", "300 us", "100 us")
Key = tuple[str, int, int]
"""Trigger, rate in Hz, samples; the oracle's own row has no rate."""

ORACLE: Key = ("oracle's own error", 0, 0)


class Report:
    """The output of ``evis verify --scene``."""

    def __init__(self, text: str) -> None:
        self.head = text.splitlines()[0]
        events, times = text.split("\nTime errors", 1)
        self.f1 = {
            key: dict(zip(TOLERANCES, zip(row[:8:2], row[1:8:2], strict=True), strict=True))
            for key, row in rows(events)
        }
        self.median_us = {key: row[0] for key, row in rows(times.split("\nOrders", 1)[0])}
        self.regions = {key: row[4:] for key, row in rows(times.split("\nOrders", 1)[0])}

    def cell(self, key: Key) -> str:
        """F1 within 1 ms, scaled, and the median time error."""
        if key not in self.f1:
            return ""
        return f"{self.f1[key]['1 ms'][1]:.3f}, {self.median_us[key]:.0f} µs"

    def table(self) -> str:
        """One row per trigger and number of samples, one column per rate."""
        keys = [key for key in self.f1 if key != ORACLE]
        rates = sorted({rate for _, rate, _ in keys})
        families = list(dict.fromkeys((trigger, samples) for trigger, _, samples in keys))
        lines = ["| trigger, samples | " + " | ".join(f"{rate} Hz" for rate in rates) + " |"]
        lines.append("|---" * (len(rates) + 1) + "|")
        for trigger, samples in families:
            cells = [self.cell((trigger, rate, samples)) for rate in rates]
            lines.append(f"| {trigger}, {samples} | " + " | ".join(cells) + " |")
        own = self.f1[ORACLE]["1 ms"][1]
        lines.append(f"\nThe oracle's own error: F1 {own:.4f}, {self.median_us[ORACLE]:.0f} µs.")
        return "\n".join(lines)


def rows(text: str) -> list[tuple[Key, list[float]]]:
    """Rows of a table in a report."""
    found: list[tuple[Key, list[float]]] = []
    for line in text.splitlines():
        setting = re.match(r"(crossing|latch) +(\d+) Hz +(\d+) +(.*)", line)
        own = re.match(r"oracle's own error +(.*)", line)
        if setting:
            trigger, rate, samples, values = setting.groups()
            found.append(((trigger, int(rate), int(samples)), numbers(values)))
        elif own:
            found.append((ORACLE, numbers(own.group(1))))
    return found


def numbers(text: str) -> list[float]:
    """Cells of a row; a dash is unknown."""
    return [float(word) if word != "-" else float("nan") for word in text.split()]


def planning(small: Report, own: Report) -> str:
    """Beside the figures that were measured while planning: rate, samples, F1 within 100 us and 1 ms."""
    planned = [
        (480, 4, 0.72, 0.973),
        (1000, 4, 0.80, 0.987),
        (1000, 16, 0.88, 0.992),
        (2000, 16, 0.93, 0.994),
    ]
    lines = [
        "| setting | planning, 160x120 | `spinner`, 640x480 | `spinner`, 160x120 |",
        "|---|---|---|---|",
    ]

    def cell(report: Report, rate: int, samples: int) -> str:
        f1 = report.f1["crossing", rate, samples]
        return " and ".join(f"{f1[t][0]:.3f} ({f1[t][1]:.3f})" for t in ("100 us", "1 ms"))

    for rate, samples, strict, wide in planned:
        # The default rates of the small picture are powers of two.
        near = 500 if rate == 480 else rate
        note = " (500 Hz)" if near != rate else ""
        lines.append(
            f"| {rate} Hz, {samples} samples | {strict:.2f} and {wide:.3f} | {cell(own, rate, samples)} "
            f"| {cell(small, near, samples)}{note} |"
        )
    return "\n".join(lines)


def fill(page: str, name: str, block: str) -> str:
    """Put `block` between the markers called `name`."""
    pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    if not pattern.search(page):
        raise SystemExit(f"there is no block {name}")
    return pattern.sub(lambda found: f"{found.group(1)}\n{block}\n\n{found.group(2)}", page)


def main(evis: str, *, fill_only: bool) -> None:
    """Measure and fill in."""
    OUTPUTS.mkdir(exist_ok=True)
    (ROOT / "docs" / "images").mkdir(exist_ok=True)
    page = PAGE.read_text(encoding="utf-8")
    texts: dict[str, str] = {}
    for name, command in COMMANDS.items():
        kept = OUTPUTS / f"{name}.txt"
        if not fill_only:
            print(f"evis {command}", flush=True)
            done = subprocess.run(
                [evis, *shlex.split(command)], cwd=ROOT, check=True, capture_output=True, text=True
            )
            kept.write_text(done.stdout, encoding="utf-8")
        texts[name] = kept.read_text(encoding="utf-8")
    reports = {name: Report(text) for name, text in texts.items() if name.startswith("spinner")}
    for name in ("spinner-640x480", "spinner-160x120"):
        shown = f"```sh\nevis {COMMANDS[name]}\n```\n\n{reports[name].head}\n\n{reports[name].table()}"
        page = fill(page, name, shown)
    PAGE.write_text(page, encoding="utf-8")
    planned = planning(reports["spinner-160x120"], reports["spinner-640x480"])
    HISTORY.write_text(fill(HISTORY.read_text(encoding="utf-8"), "planning", planned), encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    main(sys.argv[1], fill_only="--fill-only" in sys.argv[2:])
