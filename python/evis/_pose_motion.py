"""Motion vectors of depth, poses and instance ids, for renderers that give none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from . import _check
from ._evis import ConfigError
from ._host_arrays import Copies

Float = npt.NDArray[np.float32]

Axes: TypeAlias = Literal["opengl", "ros", "world"]
"""Where a camera looks, as Isaac Lab names it: ``opengl`` along -Z with +Y up, ``ros`` along +Z with -Y up,
``world`` along +X with +Z up."""

_FROM_CV: dict[str, npt.NDArray[np.float64]] = {
    "opengl": np.diag([1.0, -1.0, -1.0, 1.0]),
    "ros": np.eye(4),
    "world": np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
}
"""From x right, y down, z forward to a camera's own axes."""

_RIGID = 1e-3
"""How far the columns of a rotation may be from an orthonormal basis."""


def motion_from_poses(
    depth: Any,
    intrinsics: Any,
    camera: Any,
    camera_before: Any,
    *,
    instances: Any = None,
    bodies: Mapping[int, tuple[Any, Any]] | None = None,
    axes: Axes = "opengl",
) -> Float:
    """Make motion vectors of rigid bodies, for renderers that give none.

    The surface at pixel p and depth z is K^-1 p z in the camera, B_before B^-1 C of that in the world when
    the last keyframe was rendered, with the poses C of the camera and B of the body that it is on, and K
    C_before^-1 of that in the last picture (the pinhole camera of R. Hartley, A. Zisserman, "Multiple View
    Geometry in Computer Vision", 2nd edition, 2004, section 6.1). What bends, reflects or is seen through
    moves otherwise.

    Parameters
    ----------
    depth : array_like
        Planar z in metres, +inf where nothing is (it moves with the camera's rotation alone): (H, W),
        (H, W, 1), or (N, H, W), (N, H, W, 1).
    intrinsics : array_like
        (3, 3) or (N, 3, 3), pixels, with pixel centres at +0.5: the centre of a picture is (W / 2, H / 2).
    camera, camera_before : array_like
        World-from-camera now and at the last keyframe, (4, 4), or (7,) for x, y, z, qx, qy, qz, qw in metres;
        with N in front for N environments.
    instances : array_like, optional
        Integers, as ``depth``: ids of what is seen.
    bodies : mapping, optional
        By id, world-from-body now and at the last keyframe, as ``camera``. What is not among them is at rest.
    axes : {"opengl", "ros", "world"}
        Along which of its own axes the camera looks.

    Returns
    -------
    numpy.ndarray
        float32 (H, W, 2) or (N, H, W, 2), pixels, x right, y down: from each place to where its surface was
        at the last keyframe. NaN where depth is none, or what lay behind the camera.

    Raises
    ------
    ConfigError
        If shapes do not fit, or a pose is not rigid.

    Examples
    --------
    >>> import numpy as np
    >>> from evis.gbuffer import motion_from_poses
    >>> depth = np.full((48, 64), 2.0, np.float32)
    >>> intrinsics = [[64, 0, 32], [0, 64, 24], [0, 0, 1]]
    >>> now, before = [0.1, 0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 0, 1]  # the camera moved right by 10 cm
    >>> motion_from_poses(depth, intrinsics, now, before)[20, 30].tolist()  # what it sees was further right
    [3.200000047683716, 0.0]
    """
    z = Copies().take("depth", depth)
    single = z.ndim == 2 or (z.ndim == 3 and z.shape[-1] == 1 and Copies().take("camera", camera).ndim <= 2)
    z = _maps("depth", z, single)
    count = len(z)
    named = {"camera": camera, "camera_before": camera_before}
    for body, pair in (bodies or {}).items():
        _check.whole("an id of bodies", body)
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise ConfigError(f"bodies[{body}] is {_check.shown(pair)}; it must be its pose now and before")
        named |= {f"bodies[{body}]": pair[0], f"bodies[{body}] before": pair[1]}
    poses = {}
    for what, value in named.items():
        poses[what], good = _poses(what, value, count)
        if not good.all():
            raise ConfigError(
                f"{what} of environment {int(np.flatnonzero(~good)[0])} is not rigid or not finite; give a "
                "rotation and a translation"
            )
    pairs = {body: (poses[f"bodies[{body}]"], poses[f"bodies[{body}] before"]) for body in bodies or {}}
    ids = _instances(instances, z.shape, single, bool(pairs))
    made = _motion_field(
        z, _intrinsics(intrinsics, count), (poses["camera"], poses["camera_before"]), ids, pairs, axes
    )
    return made[0] if single else made


class MotionFromPoses:
    """Motion vectors of N environments from poses, step by step: `motion_from_poses` that remembers.

    For renderers without motion vectors: Newton's Warp renderer, Genesis, ManiSkill, Gazebo, PyBullet.

    Parameters
    ----------
    num_envs : int
        Environments.
    intrinsics : array_like
        (3, 3) or (N, 3, 3), as in `motion_from_poses`.
    axes : {"opengl", "ros", "world"}
        Along which of its own axes the camera looks.

    Raises
    ------
    ConfigError
        If a value cannot be used.
    """

    def __init__(self, num_envs: int, intrinsics: Any, *, axes: Axes = "opengl") -> None:
        self._num_envs = _check.whole("num_envs", num_envs, 1, 2**31)
        self._intrinsics = _intrinsics(intrinsics, self._num_envs)
        if axes not in _FROM_CV:
            raise ConfigError(f"axes is {_check.shown(axes)}; it must be {_check.one_of(_FROM_CV)}")
        self._axes: Axes = axes
        self._camera = np.full((self._num_envs, 4, 4), np.nan)
        self._bodies: dict[int, npt.NDArray[np.float64]] = {}
        self._held = np.zeros(self._num_envs, np.bool_)

    @property
    def held(self) -> tuple[int, ...]:
        """Environments that had a pose that is not rigid or not finite; `reset` lets them go on."""
        return tuple(int(env) for env in np.flatnonzero(self._held))

    def __call__(
        self, depth: Any, camera: Any, *, instances: Any = None, bodies: Mapping[int, Any] | None = None
    ) -> Float:
        """Return how the pictures moved since the last call.

        Parameters
        ----------
        depth : array_like
            (N, H, W) or (N, H, W, 1), planar z in metres.
        camera : array_like
            World-from-camera now: (N, 4, 4) or (N, 7) for x, y, z, qx, qy, qz, qw.
        instances : array_like, optional
            Integers, as ``depth``: ids of what is seen.
        bodies : mapping, optional
            By id, world-from-body now, as ``camera``.

        Returns
        -------
        numpy.ndarray
            float32 (N, H, W, 2), for ``EventPipeline.push(motion_vectors=)``. NaN in an environment's first
            picture, where it is held, on bodies that were not there before, and where depth is none.

        Raises
        ------
        ConfigError
            If shapes do not fit.
        """
        z = _maps("depth", Copies().take("depth", depth), False)
        if len(z) != self._num_envs:
            raise ConfigError(f"depth is of {len(z)} environments; there are {self._num_envs}")
        now, good = _poses("camera", camera, self._num_envs)
        placed = {}
        for body, value in (bodies or {}).items():
            body = _check.whole("an id of bodies", body)
            placed[body], fine = _poses(f"bodies[{body}]", value, self._num_envs)
            good &= fine
        self._held |= ~good
        unknown = np.full((self._num_envs, 4, 4), np.nan)
        pairs = {body: (pose, self._bodies.get(body, unknown)) for body, pose in placed.items()}
        ids = _instances(instances, z.shape, False, bool(pairs))
        made = _motion_field(z, self._intrinsics, (now, self._camera), ids, pairs, self._axes)
        made[self._held] = np.nan
        self._camera, self._bodies = now, placed
        return made

    def reset(self, env_ids: Sequence[int] | npt.NDArray[np.integer[Any]] | None = None) -> None:
        """Forget the poses of environments, all if not given, and hold them no longer.

        Raises
        ------
        ConfigError
            If there is no such environment.
        """
        ids = np.arange(self._num_envs) if env_ids is None else np.atleast_1d(np.asarray(env_ids))
        if ids.size and (ids.dtype.kind not in "iu" or ids.min() < 0 or ids.max() >= self._num_envs):
            raise ConfigError(
                f"env_ids is {_check.shown(env_ids)}; it must be numbers from 0 to {self._num_envs - 1}"
            )
        ids = ids.astype(np.intp)
        self._held[ids] = False
        self._camera[ids] = np.nan
        for pose in self._bodies.values():
            pose[ids] = np.nan


def _motion_field(
    depth: npt.NDArray[np.float64],
    intrinsics: npt.NDArray[np.float64],
    camera: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]],
    instances: npt.NDArray[Any] | None,
    bodies: Mapping[int, tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]],
    axes: Axes,
) -> Float:
    if axes not in _FROM_CV:
        raise ConfigError(f"axes is {_check.shown(axes)}; it must be {_check.one_of(_FROM_CV)}")
    count, height, width = depth.shape
    y, x = np.mgrid[0:height, 0:width] + 0.5
    pixels = np.stack([x, y, np.ones_like(x)], axis=-1)
    now, before = (pose @ _FROM_CV[axes] for pose in camera)
    made = np.empty((count, height, width, 2), np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        # 0 where nothing is: a direction, which only turns.
        inverse = np.where(depth > 0, 1.0 / depth, np.nan)[..., None]
        for env in range(count):
            rays = pixels @ np.linalg.inv(intrinsics[env]).T
            back = _inverse(before[env])

            def seen(step: npt.NDArray[np.float64], where: Any, env: int = env, rays: Any = rays) -> Any:
                place = rays[where] @ step[:3, :3].T + inverse[env][where] * step[:3, 3]
                place = np.where(place[..., 2:] > 1e-6, place, np.nan) @ intrinsics[env].T
                return place[..., :2] / place[..., 2:] - pixels[where][..., :2]

            made[env] = seen(back @ now[env], ...)
            for body, (there, then) in bodies.items():
                assert instances is not None, "checked by _instances"
                where = (instances[env] == body) & np.isfinite(depth[env])
                if where.any():
                    made[env][where] = seen(back @ then[env] @ _inverse(there[env]) @ now[env], where)
    return made


def _inverse(pose: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Inverse of a rigid transform; NaN stays NaN."""
    made = np.eye(4)
    made[:3, :3] = pose[:3, :3].T
    made[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return made


def _poses(what: str, value: Any, count: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """Matrices (N, 4, 4), and which of them are rigid."""
    array = Copies().take(what, value).astype(np.float64)
    if array.ndim >= 1 and array.shape[-1] == 7 and array.ndim <= 2:
        x, y, z, w = np.moveaxis(array[..., 3:], -1, 0)
        norm = np.sqrt(x * x + y * y + z * z + w * w)
        fine = np.abs(norm - 1.0) < _RIGID
        x, y, z, w = (part / np.where(fine, norm, np.nan) for part in (x, y, z, w))
        matrices = np.zeros((*array.shape[:-1], 4, 4))
        rows = (
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        )
        matrices[..., :3, :3] = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
        matrices[..., :3, 3] = array[..., :3]
        matrices[..., 3, 3] = 1.0
    elif array.shape[-2:] == (4, 4) and array.ndim <= 3:
        matrices = array
    else:
        matrices = np.empty(0)
    if matrices.shape not in ((4, 4), (1, 4, 4), (count, 4, 4)):
        raise ConfigError(
            f"{what} has shape {array.shape}; it must be (7,) for x, y, z, qx, qy, qz, qw, or (4, 4), with "
            f"{count} in front for the environments"
        )
    matrices = np.array(np.broadcast_to(matrices, (count, 4, 4)))
    rotation = matrices[:, :3, :3]
    with np.errstate(invalid="ignore"):
        off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
        last = np.abs(matrices[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1)
        good = (off < _RIGID) & (last < _RIGID) & (np.linalg.det(rotation) > 0)
    return matrices, good & np.isfinite(matrices).all(axis=(1, 2))


def _intrinsics(value: Any, count: int) -> npt.NDArray[np.float64]:
    array = Copies().take("intrinsics", value).astype(np.float64)
    if array.shape not in ((3, 3), (1, 3, 3), (count, 3, 3)):
        raise ConfigError(f"intrinsics has shape {array.shape}; it must have (3, 3) or ({count}, 3, 3)")
    if not (np.isfinite(array).all() and (array[..., [0, 1], [0, 1]] > 0).all()):
        raise ConfigError(
            f"intrinsics is {_check.shown(array.tolist())}; it must be finite, with fx and fy above 0"
        )
    return np.broadcast_to(array, (count, 3, 3))


def _maps(what: str, array: npt.NDArray[Any], single: bool) -> npt.NDArray[np.float64]:
    """Return (N, H, W) of whatever shape holds one number per pixel."""
    given = array.shape
    if array.ndim == (3 if single else 4) and array.shape[-1] == 1:
        array = array[..., 0]
    array = array[None] if single else array
    if array.ndim != 3 or array.dtype.kind != "f":
        raise ConfigError(
            f"{what} is {array.dtype} of shape {given}; it must be floating-point numbers (N, H, W) or "
            "(N, H, W, 1)"
        )
    return array.astype(np.float64)


def _instances(
    value: Any, shape: tuple[int, ...], single: bool, needed: bool
) -> npt.NDArray[np.integer[Any]] | None:
    if value is None:
        if needed:
            raise ConfigError("bodies is given without instances; give the ids of what pixels show")
        return None
    array = Copies().take("instances", value)
    array = array[None] if single else array
    array = array[..., 0] if array.ndim == 4 and array.shape[-1] == 1 else array
    if array.dtype.kind not in "iu" or array.shape != shape:
        raise ConfigError(
            f"instances is {array.dtype} of shape {array.shape}; it must be whole numbers {shape}: ids, not "
            "the colours that renderers make of them"
        )
    return array
