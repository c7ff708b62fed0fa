"""Scenes by Python: the vocabulary of scene files, with NumPy arrays for pictures."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check, _evis, _toml
from ._evis import ConfigError
from ._scene import EventCamera, Scene
from .motion import HERE, Placement, Vector, Waveform, fields_of, table_of

Wrap: TypeAlias = Literal["repeat", "mirror", "clamp"]
Color: TypeAlias = Vector | str
"""Linear RGB, or an sRGB colour as "#rrggbb"."""
ColorSpace: TypeAlias = Literal["srgb", "linear"]


class SceneBuilder:
    """Puts a `Scene` together; names connect textures, materials, objects and cameras.

    Everything goes the way of a scene file (`toml` shows it), so that both give the same scene; `build` says
    what is wrong.

    Parameters
    ----------
    name : str
        Name for reports.
    duration : float, optional
        Seconds that the scene lasts.
    background : sequence of float or str, optional
        Colour where nothing is: linear RGB, or sRGB as ``"#rrggbb"``; so for every colour below.
    ambient : sequence of float or str, optional
        Light from everywhere: irradiance / pi, linear RGB.
    classes : dict of str to int, optional
        Ids of semantic classes, above 0, by name: a ``semantic_id`` may then be a name, and recordings with
        semantic labels store the names.

    Examples
    --------
    >>> import evis
    >>> import numpy as np
    >>> from evis.motion import Placement, Spin
    >>> builder = evis.SceneBuilder("cube", ambient=(1, 1, 1))
    >>> builder.texture("noise", np.random.default_rng(0).random((64, 64), np.float32))
    >>> builder.material("painted", texture="noise")
    >>> builder.box("cube", size=(1, 1, 1), material="painted", pose=Placement(motion=Spin(degrees_per_s=90)))
    >>> builder.camera(evis.EventCamera(name="eye", pose=Placement(position=(0, 1, 3), look_at=(0, 0, 0))))
    >>> builder.build()
    Scene('cube', 2 nodes, cameras eye)
    """

    def __init__(
        self,
        name: str = "scene",
        *,
        duration: float | None = None,
        background: Color | None = None,
        ambient: Color | None = None,
        classes: Mapping[str, int] | None = None,
    ) -> None:
        self._top: dict[str, Any] = {
            "name": name,
            "duration_s": duration,
            "background": background,
            "ambient": ambient,
            "classes": classes,
        }
        self._tables: dict[str, list[dict[str, Any]]] = {}
        self._pictures: dict[str, npt.NDArray[np.float32]] = {}

    def _add(self, table: str, /, **keys: Any) -> None:
        self._tables.setdefault(table, []).append(
            {key: item for key, item in keys.items() if item is not None}
        )

    def environment_map(
        self,
        file: str | PathLike[str],
        *,
        intensity: float = 1.0,
        rotation_degrees: float = 0.0,
        visible: bool = True,
    ) -> None:
        """Light the scene with an OpenEXR or Radiance panorama.

        Parameters
        ----------
        file : path
            ``.exr`` or ``.hdr``, equirectangular.
        intensity : float
            Factor on its light.
        rotation_degrees : float
            Turn about +Y.
        visible : bool
            Whether it is seen behind everything.
        """
        self._top["environment_map"] = {
            "file": file,
            "intensity": intensity,
            "rotation_degrees": rotation_degrees,
            "visible": visible,
        }

    def dynamics(
        self,
        *,
        gravity: Vector | None = None,
        rate_hz: float | None = None,
        substeps: int | None = None,
    ) -> None:
        """Say how rigid bodies (`evis.motion.RigidBody`) are simulated.

        Parameters
        ----------
        gravity : sequence of float, optional
            Metres per second squared; (0, -9.81, 0) if not given.
        rate_hz : float, optional
            Steps per second, 100 to 100000; 1000 if not given.
        substeps : int, optional
            Parts in which the solver takes a step, 1 to 64; 4 if not given.
        """
        self._top["dynamics"] = {"gravity": gravity, "rate_hz": rate_hz, "substeps": substeps}

    def texture(
        self,
        name: str,
        pixels: npt.ArrayLike | None = None,
        *,
        file: str | PathLike[str] | None = None,
        pattern: str | None = None,
        color_space: ColorSpace | None = None,
        size: int | None = None,
        seed: int | None = None,
        colors: tuple[Color, Color] | None = None,
        wrap: Wrap = "repeat",
        filter: Literal["linear", "nearest"] = "linear",
    ) -> None:
        """Add a picture: pixels, a file, or a pattern made by code.

        Parameters
        ----------
        name : str
            What materials call it.
        pixels : array_like, optional
            (H, W), (H, W, 3) or (H, W, 4), from the top. Floats are linear light; uint8 are sRGB-encoded
            unless ``color_space="linear"``.
        file : path, optional
            PNG, JPEG, OpenEXR or Radiance file.
        pattern : str, optional
            Name of a pattern: ``noise``, ``checker``, ``bricks``, ``wood``, … (the error lists them).
        color_space : {"srgb", "linear"}, optional
            What the integers of `pixels` or `file` mean; ``srgb`` if not given.
        size : int, optional
            Texels per edge of a pattern.
        seed : int, optional
            Seed of a pattern.
        colors : (sequence of float, sequence of float), optional
            Linear RGB of a pattern's surface and detail.
        wrap : {"repeat", "mirror", "clamp"}
            What lies beyond the picture.
        filter : {"linear", "nearest"}
            How it is read.

        Raises
        ------
        ConfigError
            If not exactly one of pixels, file and pattern is given, or pixels have another shape or type.
        """
        if sum(given is not None for given in (pixels, file, pattern)) != 1:
            raise ConfigError(f"texture '{name}' takes exactly one of pixels, file and pattern")
        if pixels is not None:
            self._pictures[name] = linear_rgba(name, pixels, color_space)
            # Stands in for the pixels, which no text can hold.
            self._add("textures", name=name, pattern="checker", size=16, wrap=wrap, filter=filter)
            return
        self._add(
            "textures",
            name=name,
            file=file,
            pattern=pattern,
            color_space=color_space,
            size=size,
            seed=seed,
            colors=colors,
            wrap=wrap,
            filter=filter,
        )

    def material(
        self,
        name: str,
        *,
        model: Literal["unlit", "diffuse", "metallic_roughness"] = "diffuse",
        color: Color | None = None,
        texture: str | None = None,
        metallic: float | None = None,
        roughness: float | None = None,
        metallic_roughness_texture: str | None = None,
        normal_texture: str | None = None,
        normal_scale: float | None = None,
        occlusion_texture: str | None = None,
        occlusion_strength: float | None = None,
        emissive: Color | None = None,
        emissive_strength: float | None = None,
        emissive_texture: str | None = None,
        waveform: Waveform | None = None,
        alpha: float | None = None,
        alpha_cutoff: float | None = None,
        double_sided: bool | None = None,
    ) -> None:
        """Add a material; colours are linear RGB, textures are named.

        Parameters
        ----------
        name : str
            What objects call it.
        model : {"unlit", "diffuse", "metallic_roughness"}
            ``unlit`` shows its colour whatever the light, ``diffuse`` is matt, ``metallic_roughness`` is
            glTF 2.0's (appendix B).
        color : sequence of float or str, optional
            Multiplies `texture`.
        texture, metallic_roughness_texture, normal_texture : str, optional
            Names of textures.
        occlusion_texture, emissive_texture : str, optional
            Names of textures.
        metallic, roughness : float, optional
            For ``metallic_roughness``, in [0, 1].
        normal_scale, occlusion_strength : float, optional
            Strength of these textures.
        emissive : sequence of float, optional
            Emitted radiance, times `emissive_strength`.
        emissive_strength : float, optional
            Factor on `emissive`.
        waveform : Waveform, optional
            Factor over time on what is emitted (``unlit``: on the colour).
        alpha, alpha_cutoff : float, optional
            Alpha; drawn where it reaches the cutoff.
        double_sided : bool, optional
            Draw back faces.
        """
        self._add(
            "materials",
            name=name,
            model=model,
            color=color,
            texture=texture,
            metallic=metallic,
            roughness=roughness,
            metallic_roughness_texture=metallic_roughness_texture,
            normal_texture=normal_texture,
            normal_scale=normal_scale,
            occlusion_texture=occlusion_texture,
            occlusion_strength=occlusion_strength,
            emissive=emissive,
            emissive_strength=emissive_strength,
            emissive_texture=emissive_texture,
            waveform=None if waveform is None else fields_of(waveform),
            alpha=alpha,
            alpha_cutoff=alpha_cutoff,
            double_sided=double_sided,
        )

    def node(self, name: str, *, pose: Placement = HERE) -> None:
        """Add an empty node that others can hang on."""
        self._add("nodes", name=name, **table_of(name, pose))

    def gltf(
        self,
        name: str,
        file: str | PathLike[str],
        *,
        animation: str | None = None,
        semantic_id: int | str | None = None,
        instance_id: int | None = None,
        pose: Placement = HERE,
    ) -> None:
        """Add a ``.gltf`` or ``.glb`` file; its first animation plays, or that of this name or index."""
        self._add(
            "gltf",
            name=name,
            file=file,
            animation=animation,
            semantic_id=semantic_id,
            instance_id=instance_id,
            **table_of(name, pose),
        )

    def plane(self, name: str, *, size: Vector, material: str, pose: Placement = HERE, **more: Any) -> None:
        """Add a horizontal plane of size (x, z) in metres, facing +Y; for ``more`` see `box`."""
        self._primitive("plane", name, material, pose, more, size=size)

    def card(self, name: str, *, size: Vector, material: str, pose: Placement = HERE, **more: Any) -> None:
        """Add an upright card of size (x, y) in metres, facing +Z; for ``more`` see `box`."""
        self._primitive("card", name, material, pose, more, size=size)

    def box(self, name: str, *, size: Vector, material: str, pose: Placement = HERE, **more: Any) -> None:
        """Add a box.

        Parameters
        ----------
        name : str
            Unique name.
        size : sequence of float
            Edges (x, y, z) in metres.
        material : str
            Name of its material.
        pose : Placement
            Where it is and how it moves.
        **more
            ``semantic_id`` (int, or a name in `classes`), ``instance_id`` (int), ``segments`` ((int, int)),
            ``uv_repeat`` ((float, float)).
        """
        self._primitive("box", name, material, pose, more, size=size)

    def sphere(self, name: str, *, radius: float, material: str, pose: Placement = HERE, **more: Any) -> None:
        """Add a sphere; radius in metres; for ``more`` see `box`."""
        self._primitive("sphere", name, material, pose, more, radius=radius)

    def cylinder(
        self, name: str, *, radius: float, height: float, material: str, pose: Placement = HERE, **more: Any
    ) -> None:
        """Add a cylinder along y; metres; for ``more`` see `box`."""
        self._primitive("cylinder", name, material, pose, more, radius=radius, height=height)

    def capsule(
        self, name: str, *, radius: float, height: float, material: str, pose: Placement = HERE, **more: Any
    ) -> None:
        """Add a capsule along y; metres; for ``more`` see `box`."""
        self._primitive("capsule", name, material, pose, more, radius=radius, height=height)

    def _primitive(
        self, shape: str, name: str, material: str, pose: Placement, more: dict[str, Any], **keys: Any
    ) -> None:
        self._add(
            "primitives", name=name, shape=shape, material=material, **keys, **more, **table_of(name, pose)
        )

    def light(
        self,
        name: str,
        *,
        kind: Literal["directional", "point", "spot"],
        intensity: float,
        color: Color = (1.0, 1.0, 1.0),
        range: float | None = None,
        casts_shadow: bool = False,
        inner_degrees: float | None = None,
        outer_degrees: float | None = None,
        waveform: Waveform | None = None,
        pose: Placement = HERE,
    ) -> None:
        """Add a light that shines along the -Z of its pose.

        Parameters
        ----------
        name : str
            Unique name.
        kind : {"directional", "point", "spot"}
            Parallel light, light from a point, or a cone of it.
        intensity : float
            Lux for ``directional``, candela for the others.
        color : sequence of float
            Linear RGB.
        range : float, optional
            Metres beyond which it does not shine.
        casts_shadow : bool
            Whether it throws shadows; not for ``point``.
        inner_degrees, outer_degrees : float, optional
            Half angles of a spot's full and zero cone.
        waveform : Waveform, optional
            Factor over time.
        pose : Placement
            Where it is and how it moves.
        """
        self._add(
            "lights",
            name=name,
            kind=kind,
            intensity=intensity,
            color=color,
            range=range,
            casts_shadow=casts_shadow,
            inner_degrees=inner_degrees,
            outer_degrees=outer_degrees,
            waveform=None if waveform is None else fields_of(waveform),
            **table_of(name, pose),
        )

    def camera(self, camera: EventCamera) -> None:
        """Add an event camera."""
        if not isinstance(camera, EventCamera):
            raise ConfigError(f"camera is {_check.shown(camera)}; it must be an evis.EventCamera")
        self._add("cameras", **camera.table())

    def environments(
        self,
        count: int = 1,
        *,
        seed_offset: int | None = None,
        time_offset_s: float | None = None,
        time_step_s: float | None = None,
        offsets: dict[str, Placement] | None = None,
        materials: Mapping[str, Mapping[str, Any]] | None = None,
        lights: Mapping[str, Mapping[str, Any]] | None = None,
        cameras: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        """Add environments of a batch: the scene again, with other seeds, clocks, places, looks and lenses.

        Parameters
        ----------
        count : int
            How many.
        seed_offset : int, optional
            Added to the run's seed, one more for each; the environment's index if not given.
        time_offset_s, time_step_s : float, optional
            Scene time at which the first starts, and how much later each further one does.
        offsets : dict of str to Placement, optional
            Per object, light or camera: a pose that comes before its motion.
        materials : dict of str to dict, optional
            Per material, what is otherwise: ``color``, ``emissive`` (strength included), ``metallic``,
            ``roughness``.
        lights : dict of str to dict, optional
            Per light, what is otherwise: ``color``, ``intensity`` (lux or candela), ``on``.
        cameras : dict of str to dict, optional
            Per camera, its lens: ``fov_y_degrees``, or ``fx``, ``fy``, ``cx`` and ``cy`` in pixels, or
            ``orthographic_height`` and ``far`` in metres.
        """
        places = {name: table_of(name, pose) for name, pose in (offsets or {}).items()}
        self._add(
            "environments",
            count=count,
            seed_offset=seed_offset,
            time_offset_s=time_offset_s,
            time_step_s=time_step_s,
            offsets=None if offsets is None else places,
            materials=_tables("materials", materials),
            lights=_tables("lights", lights),
            cameras=_tables("cameras", cameras),
        )

    def toml(self) -> str:
        """Return the scene file; a pattern stands for each picture that was given as pixels."""
        return _toml.document({**self._top, **self._tables})

    def __repr__(self) -> str:
        """Count what was added, by kind."""
        counts = ", ".join(f"{len(rows)} {kind}" for kind, rows in self._tables.items() if rows)
        return f"SceneBuilder({self._top['name']!r}, {counts or 'empty'})"

    def build(self, *, base: str | PathLike[str] = ".") -> Scene:
        """Make the scene.

        Parameters
        ----------
        base : path
            Folder at which relative paths of files start.

        Raises
        ------
        ConfigError, FormatError
            If something is wrong; names the table and key, and what would work.
        OSError
            If a file cannot be read.
        """
        return Scene._of_text(self.toml(), base, list(self._pictures.items()))


def _tables(what: str, named: Mapping[str, Mapping[str, Any]] | None) -> dict[str, dict[str, Any]] | None:
    """Plain numbers, lists and words by name."""
    if named is None:
        return None
    if not hasattr(named, "items") or not all(hasattr(own, "items") for own in named.values()):
        raise ConfigError(f"{what} is {_check.shown(named)}; it must map names to what is otherwise")

    def plain(value: Any) -> Any:
        return np.asarray(value).tolist() if isinstance(value, (np.ndarray, np.generic)) else value

    return {name: {key: plain(value) for key, value in own.items()} for name, own in named.items()}


def linear_rgba(name: str, pixels: npt.ArrayLike, color_space: ColorSpace | None) -> npt.NDArray[np.float32]:
    """Return ``pixels`` as linear RGBA, float32 (H, W, 4)."""
    array: npt.NDArray[Any] = np.asarray(pixels)
    if array.ndim == 2:
        array = array[:, :, np.newaxis].repeat(3, axis=2)
    if array.ndim != 3 or array.shape[2] not in (3, 4):
        raise ConfigError(
            f"texture '{name}' has shape {array.shape}; it takes (H, W), (H, W, 3) or (H, W, 4)"
        )
    if array.dtype == np.uint8:
        color = array[:, :, :3] / np.float32(255)
        if color_space != "linear":
            color = np.array(_evis.srgb_table(), np.float32)[array[:, :, :3]]
        alpha = array[:, :, 3:] / np.float32(255)
    elif array.dtype.kind == "f":
        if color_space == "srgb":
            raise ConfigError(f"texture '{name}' holds floats, which are linear; it takes uint8 for sRGB")
        color, alpha = array[:, :, :3], array[:, :, 3:]
    else:
        raise ConfigError(f"texture '{name}' has dtype {array.dtype}; it takes floats or uint8")
    made: npt.NDArray[np.float32] = np.ones((*array.shape[:2], 4), np.float32)
    made[:, :, :3] = color
    if alpha.shape[2]:
        made[:, :, 3:] = alpha
    if not (np.isfinite(made).all() and made.min(initial=0) >= 0 and made.max(initial=0) <= 65504):
        raise ConfigError(f"texture '{name}' holds values outside [0, 65504]; it takes linear light")
    return made
