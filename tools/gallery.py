"""Draw the pictures of docs/gallery.md: simulate built-in scenes, and show them in many ways.

Usage: tools/gallery.py [NAME]...   (all pictures where none is named)
"""

from __future__ import annotations

import socket
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import evis
from evis import plot, recipes
from evis import rerun as evis_rerun
from evis._pictures import flow_of, full_speed, polarity_picture, reference_of, surface_picture, tone_mapped
from evis.motion import Placement, Spin

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "docs" / "images" / "gallery"
SIZE = (240, 180)
STARTS = {"warehouse": 1.0, "spinner": 0.3, "street": 1.5, "desk": 1.0}
"""Seconds of each scene at which recordings start."""

LABELS = ["hdr", "depth", "flow", "instance", "normal"]


def recorded(folder: Path, scene: evis.Scene | str, duration: float = 0.1, **options: Any) -> evis.Recording:
    """Simulate a scene, or a built-in one, for some tenths of a second."""
    settings: dict[str, Any] = {"size": SIZE, "label_rate_hz": 50, "quality": "standard", "seed": 1}
    if isinstance(scene, str):
        settings["start"] = STARTS[scene]
        scene = evis.Scene.builtin(scene)
    path = folder / "recording.h5"
    sim = evis.Simulator(scene, **(settings | options))
    evis.save(path, sim.stream(duration=duration), overwrite=True)
    return evis.load(path)


def frame_of(recording: evis.Recording, index: int) -> Any:
    """Return an HDR frame as screens show it."""
    image = recording.labels["hdr"][index]
    return tone_mapped(image, reference_of(recording, image))


def events_of(recording: evis.Recording, until_us: int, window_us: int) -> Any:
    """Return the last polarities of a window."""
    events = recording.slice_time(until_us - window_us, until_us)
    return polarity_picture(events.to_numpy(), (events.width, events.height))


def sheet(rows: int, columns: int, width: float = 9.0, aspect: float = 0.75) -> tuple[Figure, Any]:
    """Make a figure of pictures without axes."""
    cell = width / columns
    figure = Figure(figsize=(width, rows * (cell * aspect + 0.24)), dpi=100, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for each in axes.flat:
        each.set_xticks([])
        each.set_yticks([])
    return figure, axes


def put(axes: Any, title: str, picture: Any, **how: Any) -> None:
    """Show a picture under its title."""
    axes.imshow(picture, interpolation="nearest", **how)
    axes.set_title(title, fontsize=9, pad=3)


def keep(figure: Figure, name: str, dpi: int = 100) -> None:
    """Write a figure."""
    from PIL import Image

    with tempfile.TemporaryDirectory() as folder:
        raw = Path(folder) / "raw.png"
        figure.savefig(raw, dpi=dpi)
        store(Image.open(raw).convert("RGB"), name)


def store(picture: Any, name: str) -> None:
    """Write a picture; photographs as JPEG, else PNG with a palette, whose colours are few."""
    from PIL import Image

    path = OUT / name
    if path.suffix == ".jpg":
        picture.save(path, quality=75, optimize=True, progressive=True)
    else:
        picture.quantize(200, method=Image.Quantize.MAXCOVERAGE, dither=0).save(path, optimize=True)
    print(f"{path.relative_to(ROOT)}  {path.stat().st_size // 1000} kB", flush=True)


# Pictures.


def scenes(folder: Path) -> None:
    """Draw the built-in scenes, a frame and 10 ms of events each."""
    figure, axes = sheet(2, 4, width=9)
    for column, scene in enumerate(STARTS):
        recording = recorded(folder, scene, labels=["hdr"])
        put(axes[0, column], scene, frame_of(recording, 3))
        put(
            axes[1, column],
            f"{len(recording.events) / 100:.0f} thousand events/s",
            events_of(recording, 60_000, 10_000),
        )
    keep(figure, "scenes.jpg")


def labels(folder: Path) -> None:
    """Draw what comes with the events of the warehouse."""
    recording = recorded(folder, "warehouse", labels=LABELS)
    view, held = recording.view, recording.labels
    figure, axes = sheet(2, 3)
    put(axes[0, 0], "HDR frame", frame_of(recording, 3))
    put(axes[0, 1], "events of 10 ms", events_of(recording, 60_000, 10_000))
    depth = held["depth"][3]
    put(axes[0, 2], "depth", np.log(np.where(np.isfinite(depth), depth, np.nan)), cmap="viridis_r")
    speed = full_speed(view, "flow_forward")
    put(axes[1, 0], "optical flow", flow_of(view, "flow_forward", 3, speed))
    ids = held["instance"][3]
    put(axes[1, 1], "instances", ids * 7919 % 20, cmap="tab20", vmin=0, vmax=19)
    put(axes[1, 2], "normals", np.clip(0.5 + 0.5 * held["normal"][3], 0, 1))
    keep(figure, "labels.jpg")


def moving(folder: Path) -> None:
    """Show frame, events and depth of the warehouse side by side, ten times slower than real time."""
    from PIL import Image

    step_us = 10_000
    recording = recorded(folder, "warehouse", 0.4, labels=["hdr", "depth"], label_rate_hz=1e6 / step_us)
    held = recording.labels
    depths = np.stack([held["depth"][index] for index in range(len(held["depth"]))])
    near, far = np.log(np.percentile(depths[np.isfinite(depths)], [1, 99]))
    pictures = []
    for index in range(1, len(held["hdr"])):
        depth = np.nan_to_num(np.log(depths[index]), posinf=far)
        shade = np.clip((far - depth) / (far - near), 0, 1) * 255
        panels = [
            as_bytes(frame_of(recording, index)),
            as_bytes(events_of(recording, index * step_us, step_us)),
            np.repeat(shade.astype(np.uint8)[..., None], 3, axis=2),
        ]
        pictures.append(Image.fromarray(np.hstack(panels)).quantize(64, dither=0))
    path = OUT / "moving.gif"
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=100, loop=0, optimize=True)
    print(f"{path.relative_to(ROOT)}  {path.stat().st_size // 1000} kB", flush=True)


def as_bytes(picture: Any) -> Any:
    """Return a picture of bytes, whatever it was of."""
    picture = np.asarray(picture)[..., :3]
    return picture if picture.dtype == np.uint8 else np.clip(picture * 255, 0, 255).astype(np.uint8)


def cloud(folder: Path) -> None:
    """Draw a bar that turns twice a second, in space and time."""
    builder = evis.SceneBuilder("propeller", ambient=(1, 1, 1))
    builder.material("wall", model="unlit", color=(0.2, 0.2, 0.2))
    builder.material("bar", model="unlit", color=(0.5, 0.5, 0.5))
    builder.card("wall", size=(9, 9), material="wall")
    turning = Placement(position=(0, 0, 0.2), motion=Spin(degrees_per_s=720, axis=(0, 0, 1)))
    builder.box("bar", size=(2.2, 0.3, 0.02), material="bar", pose=turning)
    eye = Placement(position=(0, 0, 3), look_at=(0, 0, 0))
    builder.camera(evis.EventCamera(name="eye", fov_y_degrees=50, pose=eye))
    recording = recorded(folder, builder.build(), 0.4)
    keep(plot.xyt(recording, most=12_000), "cloud.png")


def summary(folder: Path) -> None:
    """Draw what ``evis plot`` draws unless told otherwise."""
    keep(plot.summary(recorded(folder, "warehouse", size=(160, 120))), "summary.png", dpi=80)


def surface(folder: Path) -> None:
    """Draw time surfaces of the street that fade at different speeds."""
    recording = recorded(folder, "street")
    figure, axes = sheet(1, 3, width=9)
    for column, tau_ms in enumerate((5, 20, 60)):
        shown = surface_picture(recording.time_surface(1000 * tau_ms, at_us=99_999))
        put(axes[0, column], f"time surface, tau {tau_ms} ms", shown)
    keep(figure, "surface.png")


def dense(folder: Path) -> None:
    """Draw dense arrays of the same 20 ms of events."""
    events = recorded(folder, "spinner").slice_time(40_000, 60_000)
    spread = {"cmap": "RdBu", "vmin": -3, "vmax": 3}
    figure, axes = sheet(2, 4, width=9)
    off, on = events.counts()
    grid = events.voxel_grid(bins=5)
    for place, (title, picture, how) in zip(
        axes.flat,
        [
            ("event frame", events.event_frame(), spread),
            ("counts, ON", on, {"cmap": "Oranges", "vmax": 4}),
            ("counts, OFF", off, {"cmap": "Blues", "vmax": 4}),
            ("voxel grid, bin 3 of 5", grid[2], spread),
            ("time surface, ON", events.time_surface(10_000)[1], {"cmap": "magma"}),
            ("averaged timestamps, ON", events.averaged_timestamps(empty=np.nan)[1], {"cmap": "viridis"}),
            (
                "spike tensor, ON, bin 5 of 9",
                events.event_spike_tensor(bins=9)[1, 4],
                {"cmap": "magma", "vmax": 0.5},
            ),
            ("Bina-Rep, ON, 8 bits", events.bina_rep(bits=8)[0, 1], {"cmap": "magma"}),
        ],
        strict=True,
    ):
        put(place, title, picture, **how)
    keep(figure, "dense.png")


def sensors(folder: Path) -> None:
    """Draw what different sensors make of the same light."""
    figure, axes = sheet(2, 4, width=9)
    for column, name in enumerate(("ideal", "davis346", "dvxplorer-like", "gen4-like")):
        events = recorded(folder, "spinner", sensor=name).events
        shown = events.slice_time(40_000, 50_000)
        put(axes[0, column], name, polarity_picture(shown.to_numpy(), (events.width, events.height)))
        rate = axes[1, column]
        for polarity, color in ((1, "#e69f00"), (0, "#004278")):
            counts = np.bincount(events.t[events.p == polarity] // 1000, minlength=100)
            rate.stairs(counts / 1e-3 / 1e6, baseline=None, color=color)
        rate.set_ylim(0, 0.8)
        rate.set_yticks([0, 0.2, 0.4, 0.6] if column == 0 else [])
        rate.set_xticks([0, 50, 100])
        rate.set_xlabel("ms", fontsize=8)
        rate.tick_params(labelsize=8)
    axes[1, 0].set_ylabel("million events/s", fontsize=8)
    keep(figure, "sensors.png")


def objects2d(folder: Path) -> None:
    """Draw scenes of the recipe objects2d: a frame and 10 ms of events each."""
    figure, axes = sheet(2, 4, width=9)
    for column, seed in enumerate((1, 2, 3, 4)):
        scene = recipes.objects2d(seed, size=SIZE, duration=1.0)
        recording = recorded(folder, scene, labels=["hdr"], start=0.3)
        put(axes[0, column], f"seed {seed}", frame_of(recording, 3))
        put(
            axes[1, column],
            f"{len(recording.events) / 100:.0f} thousand events/s",
            events_of(recording, 60_000, 10_000),
        )
    keep(figure, "objects2d.jpg")


def viewer(folder: Path) -> None:
    """Take a picture of the viewer itself, which newer ones allow without a display."""
    from PIL import Image

    try:
        from rerun.experimental import ViewerClient
    except ImportError:
        print("viewer.jpg  left as it is: this rerun-sdk needs a display", flush=True)
        return
    recording = recorded(folder, "warehouse", labels=LABELS)
    file, shot = folder / "warehouse.rrd", folder / "viewer.png"
    evis_rerun.view(recording, save=file)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    program = str(Path(sys.executable).with_name("rerun"))
    with ViewerClient.spawn(
        headless=True, port=port, hide_welcome_screen=True, executable_path=program
    ) as it:
        time.sleep(3)
        it.open(str(file))
        # Messages of the start go away by themselves.
        time.sleep(10)
        it.set_time(evis_rerun.TIMELINE, duration=0.06, play_state="paused")
        time.sleep(4)
        it.save_screenshot(str(shot))
        it.quit()
    picture = Image.open(shot).convert("RGB")
    store(picture.resize((1100, round(1100 * picture.height / picture.width))), "viewer.jpg")


PICTURES: dict[str, Callable[[Path], None]] = {
    each.__name__: each
    for each in (scenes, labels, moving, cloud, summary, surface, dense, sensors, objects2d, viewer)
}


def main() -> int:
    """Draw the pictures that are named."""
    names = sys.argv[1:] or list(PICTURES)
    if unknown := set(names) - set(PICTURES):
        print(
            f"gallery: no picture {', '.join(sorted(unknown))}; there is {', '.join(PICTURES)}",
            file=sys.stderr,
        )
        return 2
    OUT.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            PICTURES[name](Path(folder))
    return 0


if __name__ == "__main__":
    sys.exit(main())
