"""Scenes for training sets that code makes: a seed in, a `Scene` out."""

from __future__ import annotations

import inspect
import struct
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _check, _limits
from ._builder import SceneBuilder
from ._evis import ConfigError
from ._scene import EventCamera, Scene
from .motion import Keys, Placement

__all__ = ["RECIPES", "objects2d", "random_texture"]

PICTURES = (".png", ".jpg", ".jpeg")
"""Endings of the files that a folder of pictures is searched for."""

_KEYS_HZ = 40.0
"""Keys per second of random motions. Between keys positions follow cubics with the exact velocities: at the
fastest component, 3 Hz, they are off by (w h)^4 / 384 = 1.3e-4 of its amplitude at most, h = 1/40 s."""

_MOST_HZ = 3.0
_VIEW = 2.0
"""Height of the view at the background, metres."""

_FAR = 3.0
"""Distance of the background from the camera, metres."""


def pictures(folder: str | PathLike[str]) -> list[Path]:
    """Return the pictures of a folder, PNG and JPEG, by name.

    Raises
    ------
    OSError
        If the folder cannot be read.
    ConfigError
        If there is no picture in it.
    """
    found = sorted(path for path in Path(folder).iterdir() if path.suffix.lower() in PICTURES)
    if not found:
        raise ConfigError(f"{folder} has no picture; it must have files that end with {', '.join(PICTURES)}")
    return found


def objects2d(
    seed: int = 0,
    *,
    images: str | PathLike[str] | Sequence[str | PathLike[str]] | None = None,
    objects: Sequence[int] = (5, 20),
    speed: Sequence[float] = (0.1, 1.5),
    background_speed: Sequence[float] = (0.05, 0.5),
    object_size: Sequence[float] = (0.15, 0.6),
    size: Sequence[int] = (240, 180),
    duration: float = 10.0,
) -> Scene:
    """Make flat objects that move before a background: what reconstruction networks are trained on.

    Textured cards translate and turn in planes parallel to the picture, each along a smooth random path,
    before a textured background that moves as well, as in the "multi-object 2D" sequences of ESIM
    (H. Rebecq, D. Gehrig, D. Scaramuzza, CoRL 2018). Paths are sums of two sines per coordinate. Materials
    are unlit: a texture is the light that it shows.

    Parameters
    ----------
    seed : int
        0 or more; everything random follows from it.
    images : path or sequence of path, optional
        A folder of PNG and JPEG pictures, or such files: textures, each used as often as the seed says. PNG
        files with alpha are cut out. Where not given, textures are made by code.
    objects : (int, int)
        Fewest and most cards, 1 to 200.
    speed, background_speed : (float, float)
        Root mean square speed of each card, and of the background, in heights of the picture per second.
    object_size : (float, float)
        Height of a card, in heights of the picture.
    size : (int, int)
        Width and height of the camera in pixels, which is called ``camera``.
    duration : float
        Seconds that paths last; afterwards everything rests.

    Returns
    -------
    Scene
        With one camera at rest.

    Raises
    ------
    ConfigError
        If a value cannot be used, or a folder has no picture.
    OSError, FormatError
        If a picture cannot be read.

    Examples
    --------
    >>> from evis.recipes import objects2d
    >>> objects2d(3, objects=(4, 4), duration=1.0).cameras
    ('camera',)
    """
    seed = _check.whole("seed", seed, 0, 2**64 - 1)
    fewest, most = _range("objects", objects, 1, 200, whole=True)
    width, height = _check.size(size, 8192)
    length = _check.duration_us("duration", duration) / 1e6
    speeds = {
        "card": _range("speed", speed, 0, 100),
        "wall": _range("background_speed", background_speed, 0, 100),
    }
    heights = _range("object_size", object_size, 0.01, 10)
    files = _files(images)
    # The legacy generator: NumPy promises that its numbers stay the same in all versions (NEP 19).
    words = [int(word) for word in np.random.SeedSequence(seed).generate_state(8)]
    random = np.random.RandomState(words)

    builder = SceneBuilder(f"objects2d {seed}", duration=length)
    aspect = width / height
    # The background never shows its border: it reaches beyond its path, however it is turned.
    sway = 0.5 * _VIEW
    side = 2.0 * (float(np.hypot(aspect, 1.0)) * _VIEW / 2 + 2 * sway)
    _picture(builder, random, "wall", files, 256)
    builder.card(
        "wall",
        size=(side, side),
        material="wall",
        uv_repeat=(side / _VIEW, side / _VIEW),
        pose=_path(random, (0.0, 0.0, -_FAR), (sway, sway), speeds["wall"], length, 0.3),
        semantic_id=1,
    )
    count = int(random.randint(int(fewest), int(most) + 1))
    for index in range(count):
        name = f"card {index}"
        shape = _picture(builder, random, name, files, 128)
        tall = _VIEW * float(random.uniform(*heights))
        middle = (random.uniform(-0.35, 0.35) * _VIEW * aspect, random.uniform(-0.35, 0.35) * _VIEW)
        reach = (0.35 * _VIEW * aspect, 0.35 * _VIEW)
        depth = -_FAR + 0.01 * (index + 1)
        builder.card(
            name,
            size=(tall * shape, tall),
            material=name,
            pose=_path(random, (*middle, depth), reach, speeds["card"], length, 1.0),
            semantic_id=2,
        )
    view = float(np.degrees(2 * np.arctan(_VIEW / 2 / _FAR)))
    builder.camera(EventCamera(name="camera", width=width, height=height, fov_y_degrees=view))
    return builder.build()


def _range(what: str, value: Any, least: float, most: float, *, whole: bool = False) -> tuple[float, float]:
    ends = (_check.wholes if whole else _check.numbers)(what, value)
    if len(ends) != 2 or not least <= ends[0] <= ends[1] <= most:
        raise ConfigError(
            f"{what} is {_check.shown(value)}; it must be (low, high), between {least:g} and {most:g}"
        )
    return ends[0], ends[1]


def _files(images: Any) -> list[Path] | None:
    if images is None:
        return None
    if isinstance(images, (str, PathLike)):
        return pictures(images)
    files = [Path(each) for each in _check.items("images", images, "['a.png', 'b.jpg']")]
    if not files:
        raise ConfigError("images is empty; it must name a picture, or be None for textures by code")
    return files


def _path(
    random: np.random.RandomState,
    middle: tuple[float, float, float],
    reach: tuple[float, float],
    speeds: tuple[float, float],
    length: float,
    turning: float,
) -> Placement:
    """Return a smooth random path about ``middle``; half-axes ``reach`` in metres, ``turning`` in rad/s."""
    speed = _VIEW * float(random.uniform(*speeds))
    steps = max(int(np.ceil(length * _KEYS_HZ)), 1)
    times = np.arange(steps + 1) * (length / steps)
    positions, velocities = np.zeros((steps + 1, 3)), np.zeros((steps + 1, 3))
    heading = random.uniform(0, 2 * np.pi)
    for axis, share in enumerate((abs(np.cos(heading)), abs(np.sin(heading)))):
        for part in (0.8, 0.6):  # squares sum to 1
            wanted = max(part * share * speed, 1e-6)
            # v_rms = amplitude * w / sqrt(2); the slower it goes within its reach, the smoother.
            least_w = np.sqrt(2) * wanted / (0.5 * reach[axis])
            w = min(least_w * random.uniform(1.0, 2.0), 2 * np.pi * _MOST_HZ)
            amplitude = min(np.sqrt(2) * wanted / w, 0.5 * reach[axis])
            phase = random.uniform(0, 2 * np.pi)
            positions[:, axis] += amplitude * np.sin(w * times + phase)
            velocities[:, axis] += amplitude * w * np.cos(w * times + phase)
    spin, swing = random.uniform(-turning, turning), random.uniform(0, turning)
    angle = random.uniform(0, 2 * np.pi) + spin * times + swing * np.sin(2.5 * times + random.uniform(0, 6))
    rotations = np.zeros((steps + 1, 4))
    rotations[:, 2], rotations[:, 3] = np.sin(angle / 2), np.cos(angle / 2)
    motion = Keys(
        times_s=times,
        positions=positions,
        rotations=rotations,
        velocities=velocities,
        interpolation="hermite",
    )
    return Placement(position=middle, motion=motion)


def _picture(
    builder: SceneBuilder, random: np.random.RandomState, name: str, files: Sequence[Path] | None, texels: int
) -> float:
    """Add a texture and its material, and return its width by its height."""
    gain = float(np.exp(random.uniform(np.log(0.3), np.log(1.5))))
    cutoff = None
    if files is None:
        aspect = float(np.exp(random.uniform(-0.5, 0.5)))
        builder.texture(name, random_texture(random, texels), wrap="mirror")
    else:
        file = files[int(random.randint(len(files)))]
        wide, high, alpha = _size_of(file)
        aspect = wide / high
        cutoff = 0.5 if alpha and name != "wall" else None
        builder.texture(name, file=file.absolute(), wrap="mirror")
    builder.material(name, model="unlit", texture=name, color=(gain, gain, gain), alpha_cutoff=cutoff)
    return aspect


def random_texture(random: np.random.RandomState, size: int = 128) -> npt.NDArray[np.float32]:
    """Return a texture with structure at many scales: smooth noise, stripes, and flat shapes.

    Parameters
    ----------
    random : numpy.random.RandomState
        Where random numbers come from.
    size : int
        Texels per edge.

    Returns
    -------
    numpy.ndarray
        float32 (size, size, 3), linear light between 0.02 and 1.
    """
    down, across = np.mgrid[0:size, 0:size] / size
    # Value noise: octaves from 2 to 64 cells per edge, each with a smooth step between its values.
    noise = np.zeros((size, size))
    slope = random.uniform(0.4, 0.9)
    for octave in range(1, 7):
        cells = 2**octave
        if cells > size // 2:
            break
        values = random.uniform(-1, 1, (cells + 1, cells + 1))
        y, x = down * cells, across * cells
        row, column = y.astype(int), x.astype(int)
        fy, fx = ((f := part % 1.0) * f * (3 - 2 * f) for part in (y, x))
        above = values[row, column] * (1 - fx) + values[row, column + 1] * fx
        below = values[row + 1, column] * (1 - fx) + values[row + 1, column + 1] * fx
        noise += slope**octave * (above * (1 - fy) + below * fy)
    level = (noise - noise.min()) / max(float(np.ptp(noise)), 1e-9)
    dark, bright = random.uniform(0, 0.5, 3), random.uniform(0.4, 1, 3)
    color = dark + level[:, :, None] * (bright - dark)
    if random.uniform() < 0.4:
        angle, lines = random.uniform(0, np.pi), random.uniform(3, 12)
        wave = np.sin(2 * np.pi * lines * (across * np.cos(angle) + down * np.sin(angle)))
        color *= 1 - random.uniform(0.2, 0.8) * (wave > random.uniform(-0.5, 0.5))[:, :, None]
    for _ in range(int(random.randint(0, 9))):
        cy, cx, angle = random.uniform(0, 1), random.uniform(0, 1), random.uniform(0, np.pi)
        u = (across - cx) * np.cos(angle) + (down - cy) * np.sin(angle)
        v = (down - cy) * np.cos(angle) - (across - cx) * np.sin(angle)
        a, b = random.uniform(0.03, 0.3, 2)
        inside = np.hypot(u / a, v / b) < 1 if random.uniform() < 0.5 else (abs(u) < a) & (abs(v) < b)
        color[inside] = random.uniform(0, 1, 3) * (0.5 + 0.5 * level[inside][:, None])
    return np.asarray(np.clip(color, 0.02, 1.0), np.float32)


def _size_of(path: Path) -> tuple[int, int, bool]:
    """Read width, height, and whether there is alpha, of a PNG or JPEG file; 1, 1 where unknown."""
    with _limits.readable(path).open("rb") as file:
        head = file.read(33)
        if head[:8] == b"\x89PNG\r\n\x1a\n" and len(head) > 25:
            wide, high = struct.unpack(">II", head[16:24])
            return max(wide, 1), max(high, 1), head[25] in (4, 6)
        if head[:2] != b"\xff\xd8":
            return 1, 1, False
        file.seek(2)
        while len(mark := file.read(4)) == 4 and mark[0] == 0xFF:
            kind, length = mark[1], struct.unpack(">H", mark[2:])[0]
            # Start of frame: baseline, progressive and their kin (ITU-T T.81, table B.1).
            if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
                body = file.read(5)
                if len(body) == 5:
                    high, wide = struct.unpack(">HH", body[1:])
                    return max(wide, 1), max(high, 1), False
                break
            file.seek(max(length - 2, 0), 1)
    return 1, 1, False


RECIPES: dict[str, Callable[..., Scene]] = {"objects2d": objects2d}
"""Functions that make a scene of a seed and keyword arguments, by name."""


def keys(name: str) -> list[str]:
    """Return the keyword arguments of a recipe."""
    parameters = inspect.signature(RECIPES[name]).parameters.values()
    return [each.name for each in parameters if each.kind is inspect.Parameter.KEYWORD_ONLY]


def check(name: str, settings: Mapping[str, Any], base: Path) -> None:
    """Make a small scene of a recipe, to find what is wrong with its settings."""
    given = dict(settings)
    if "images" in given:
        if not isinstance(given["images"], str):
            raise ConfigError(f"images is {_check.shown(given['images'])}; it must be a folder")
        given["images"] = pictures(base / given["images"])[:1]
    RECIPES[name](0, **given)
