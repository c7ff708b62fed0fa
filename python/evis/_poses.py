"""What a host says of a step, as the engine takes it: poses, what is seen, materials, lights, lenses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from . import _check
from ._evis import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

#: Base colour, metallic, emitted radiance, roughness; None for what stays.
Factors: TypeAlias = tuple[list[float] | None, float | None, list[float] | None, float | None]

#: Colour, intensity, whether it shines; None for what stays.
LightValues: TypeAlias = tuple[list[float] | None, float | None, bool | None]

#: Times, poses of seven numbers, velocities, angular velocities, after the environment and the node.
NodePoses: TypeAlias = tuple[
    int, int, list[int], list[list[float]], list[list[float]] | None, list[list[float]] | None
]

#: What may change of a material, by name, and how many numbers it has.
_FACTORS = {"color": 3, "metallic": 1, "emissive": 3, "roughness": 1}

#: How far the columns of a rotation matrix may be from an orthonormal basis.
_RIGID = 1e-3

_SHAPES = "(7,) for x, y, z, qx, qy, qz, qw, or (4, 4); with one per environment or time in front"


def node_poses(
    names: Sequence[str],
    environments: int,
    until_us: int,
    poses: Mapping[str, ArrayLike],
    times_us: ArrayLike | None,
    velocities: Mapping[str, ArrayLike] | None,
    angular_velocities: Mapping[str, ArrayLike] | None = None,
) -> list[NodePoses]:
    """Per environment and node: times, poses of seven numbers, velocities, angular velocities."""
    times = [until_us] if times_us is None else _times(times_us)
    given = {"velocities": velocities or {}, "angular_velocities": angular_velocities or {}}
    found: list[NodePoses] = []
    for name, value in poses.items():
        node = _index(names, name, "poses")
        size = (environments, len(times))
        seven = _as_seven(name, value, range(environments), times_us is None)
        values = _spread(f"poses[{name!r}]", seven, size, times_us is None)
        linear, angular = (
            _speeds(f"{argument}[{name!r}]", of[name], size, times_us is None) if name in of else None
            for argument, of in given.items()
        )
        for environment in range(environments):
            own = [None if each is None else each[environment].tolist() for each in (linear, angular)]
            found.append((environment, node, times, values[environment].tolist(), own[0], own[1]))
    for argument, of in given.items():
        for name in of:
            if name not in poses:
                raise ConfigError(f"{argument} name {name!r}, and poses do not; give both")
    return found


def _speeds(what: str, value: ArrayLike, size: tuple[int, int], at_end: bool) -> NDArray[np.float64]:
    """Shape (environments, times, 3)."""
    speeds = _spread(what, _numbers(what, value), size, at_end)
    if speeds.shape[-1] != 3:
        raise ConfigError(f"{what} has the shape {np.shape(value)}; give (3,) per pose")
    return speeds


def node_visible(
    names: Sequence[str],
    environments: int,
    until_us: int,
    visible: Mapping[str, ArrayLike],
    times_us: ArrayLike | None,
) -> list[tuple[int, int, list[tuple[int, bool]]]]:
    """Per environment and node: whether it is seen up to each time."""
    times = [until_us] if times_us is None else _times(times_us)
    found = []
    for name, value in visible.items():
        node = _index(names, name, "visible")
        what = f"visible[{name!r}]"
        seen = _spread(what, _seen(what, value)[..., None], (environments, len(times)), times_us is None)
        for environment in range(environments):
            row = [bool(one) for one in seen[environment, :, 0]]
            found.append((environment, node, list(zip(times, row, strict=True))))
    return found


def visible_jumps(
    names: Sequence[str], environments: Sequence[int], visible: Mapping[str, ArrayLike]
) -> list[tuple[int, int, bool]]:
    """Per environment of ``environments`` and node: whether it is seen."""
    found = []
    for name, value in visible.items():
        node = _index(names, name, "visible")
        what = f"visible[{name!r}]"
        seen = _spread(what, _seen(what, value)[..., None], (len(environments), 1), True)
        found += [(e, node, bool(seen[row, 0, 0])) for row, e in enumerate(environments)]
    return found


def material_changes(
    names: Sequence[str], environments: Iterable[int], materials: Mapping[str, Mapping[str, ArrayLike]]
) -> list[tuple[int, int, Factors]]:
    """Per environment of ``environments`` and material: new factors."""
    each = list(environments)
    found = []
    for name, factors in materials.items():
        index = _index(names, name, "materials")
        what = f"materials[{name!r}]"
        if not hasattr(factors, "items"):
            raise ConfigError(
                f"{what} is {_check.shown(factors)}; it must be a mapping such as {{'color': (1, 0, 0)}}"
            )
        columns = {}
        for key, value in factors.items():
            if key not in _FACTORS:
                raise ConfigError(f"{what} has {key!r}; only {_check.one_of(_FACTORS)} can change in a step")
            columns[key] = _factor(f"{what}[{key!r}]", value, len(each), _FACTORS[key])
        for row, environment in enumerate(each):
            color, emissive = (
                columns[k][row].tolist() if k in columns else None for k in ("color", "emissive")
            )
            metallic, roughness = (
                float(columns[k][row, 0]) if k in columns else None for k in ("metallic", "roughness")
            )
            found.append((environment, index, (color, metallic, emissive, roughness)))
    return found


def light_changes(
    names: Sequence[str], environments: Iterable[int], lights: Mapping[str, Mapping[str, ArrayLike]]
) -> list[tuple[int, int, LightValues]]:
    """Per environment of ``environments`` and light: new values."""
    each = list(environments)
    found = []
    for name, values in lights.items():
        index = _index(names, name, "lights")
        what = f"lights[{name!r}]"
        if not hasattr(values, "items"):
            raise ConfigError(
                f"{what} is {_check.shown(values)}; it must be a mapping such as {{'intensity': 2.0}}"
            )
        color = intensity = on = None
        for key, value in values.items():
            if key == "color":
                color = _factor(f"{what}['color']", value, len(each), 3)
            elif key == "intensity":
                intensity = _factor(f"{what}['intensity']", value, len(each), 1)
            elif key == "on":
                on = _factor(f"{what}['on']", _seen(f"{what}['on']", value), len(each), 1)
            else:
                known = _check.one_of(("color", "intensity", "on"))
                raise ConfigError(f"{what} has {key!r}; only {known} can change in a step")
        for row, environment in enumerate(each):
            own: LightValues = (
                None if color is None else color[row].tolist(),
                None if intensity is None else float(intensity[row, 0]),
                None if on is None else bool(on[row, 0]),
            )
            found.append((environment, index, own))
    return found


_LENSES = (("fov_y_degrees",), ("orthographic_height", "far"), ("fx", "fy", "cx", "cy"))
"""What a lens is given by."""


def lens_changes(
    names: Sequence[str], environments: Sequence[int], lenses: Mapping[str, Any]
) -> list[tuple[int, int, list[float]]]:
    """Per environment of ``environments`` and camera: one of `_LENSES`, a field of view in radians."""
    found = []
    for name, value in lenses.items():
        if name not in names:
            raise ConfigError(f"lenses name the camera {name!r}; it must be {_check.one_of(names)}")
        what = f"lenses[{name!r}]"
        if not hasattr(value, "items"):
            raise ConfigError(
                f"{what} is {_check.shown(value)}; it must be a mapping such as {{'fov_y_degrees': 60.0}}"
            )
        for key in value:
            known = [each for keys in _LENSES for each in keys]
            if key not in known:
                raise ConfigError(f"{what} has {key!r}; it takes {_check.one_of(known)}")
        columns = {
            key: _factor(f"{what}[{key!r}]", numbers, len(environments), 1)[:, 0]
            for key, numbers in value.items()
        }
        keys = next((keys for keys in _LENSES if set(keys) == set(columns)), None)
        if keys is None:
            raise ConfigError(
                f"{what} has {', '.join(map(repr, columns)) or 'nothing'}; give 'fov_y_degrees', or both of "
                "'orthographic_height' and 'far', or all of 'fx', 'fy', 'cx', 'cy'"
            )
        rows = np.stack([columns[key] for key in keys], axis=1)
        if keys == ("fov_y_degrees",):
            rows = np.radians(rows)
        found += [(e, list(names).index(name), rows[row].tolist()) for row, e in enumerate(environments)]
    return found


def _factor(what: str, value: ArrayLike, environments: int, count: int) -> NDArray[np.float64]:
    """Shape (environments, count)."""
    array = _numbers(what, value)
    per_environment = array if count > 1 else array[..., None]
    wanted = (environments, count)
    if per_environment.shape not in {(count,), (1, count), wanted}:
        one = "a number" if count == 1 else f"({count},)"
        raise ConfigError(
            f"{what} has the shape {array.shape}; give {one}, or one per environment, of which there are "
            f"{environments}"
        )
    return np.broadcast_to(per_environment, wanted)


def node_jumps(
    names: Sequence[str], environments: Sequence[int], poses: Mapping[str, ArrayLike]
) -> list[tuple[int, int, list[float]]]:
    """Per environment of ``environments`` and node: a pose of seven numbers."""
    found = []
    for name, value in poses.items():
        node = _index(names, name, "poses")
        size = (len(environments), 1)
        values = _spread(f"poses[{name!r}]", _as_seven(name, value, environments, True), size, True)
        found += [(e, node, values[row, 0].tolist()) for row, e in enumerate(environments)]
    return found


def _index(names: Sequence[str], name: str, argument: str) -> int:
    """Return the index of what ``argument`` of a step names, among what the simulator left to the host."""
    if name not in names:
        own, does = (argument, "changes") if argument in {"materials", "lights"} else ("poses", "moves")
        known = ", ".join(repr(n) for n in names) or f"none: name them as {own}=[...] of the Simulator"
        hint = _check.did_you_mean(str(name), names)
        raise ConfigError(
            f"{argument} name{'' if argument == 'poses' else 's'} {name!r}, which no host {does}; "
            f"there is {known}{hint}"
        )
    return list(names).index(name)


def _seen(what: str, value: Any) -> NDArray[np.bool_]:
    array = np.asarray(value)
    if array.dtype != np.bool_:
        raise ConfigError(f"{what} is {_check.shown(value)}; give True or False, one per environment or time")
    return array


def _times(times_us: ArrayLike) -> list[int]:
    times = np.asarray(times_us)
    if times.ndim != 1 or times.size == 0 or not np.issubdtype(times.dtype, np.integer):
        raise ConfigError("pose_times_us must be whole microseconds, one per pose of the step, in order")
    return [_check.time_us("pose_times_us", int(t)) for t in times]


def _numbers(what: str, value: ArrayLike) -> NDArray[np.float64]:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{what} is no array of numbers: {error}") from None


def _as_seven(name: str, value: ArrayLike, environments: Sequence[int], at_end: bool) -> NDArray[np.float64]:
    """Poses of seven numbers, of these environments; `at_end` without times."""
    array = _numbers(f"poses[{name!r}]", value)
    if array.ndim >= 2 and array.shape[-2:] == (4, 4):
        per_environment = array.ndim == 4 or (array.ndim == 3 and at_end)
        each = per_environment and array.shape[0] == len(environments) > 1
        return _from_matrices(name, array, environments if each else None)
    if array.ndim < 1 or array.shape[-1] != 7:
        raise ConfigError(f"poses[{name!r}] has the shape {array.shape}; give {_SHAPES}")
    return array


def _from_matrices(
    name: str, matrices: NDArray[np.float64], environments: Sequence[int] | None = None
) -> NDArray[np.float64]:
    """Position and quaternion (x, y, z, w) of rigid transforms, by Shepperd's method.

    `environments`: those of the first axis, where it is theirs.
    """
    rotation = matrices[..., :3, :3]
    off = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max(axis=(-2, -1))
    last = np.abs(matrices[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max(axis=-1)
    # A NaN is no rigid transform either.
    with np.errstate(invalid="ignore"):
        rigid = (off < _RIGID) & (last < _RIGID) & (np.linalg.det(rotation) > 0.0)
    if not rigid.all():
        whose = ""
        if environments is not None:
            first = int(np.flatnonzero(~rigid.reshape(len(environments), -1).all(axis=1))[0])
            whose = f" for environment {environments[first]}"
        raise ConfigError(
            f"poses[{name!r}] holds a matrix{whose} that is not rigid; give a rotation and a translation, "
            "and 0, 0, 0, 1 as the last row"
        )
    trace = np.trace(rotation, axis1=-2, axis2=-1)
    diagonal = np.stack([rotation[..., i, i] for i in range(3)] + [trace], axis=-1)
    largest = diagonal.argmax(axis=-1)
    quaternion = np.empty((*rotation.shape[:-2], 4))
    for axis in range(3):
        j, k = (axis + 1) % 3, (axis + 2) % 3
        where = largest == axis
        own = rotation[where]
        quaternion[where, axis] = 1.0 + own[..., axis, axis] - own[..., j, j] - own[..., k, k]
        quaternion[where, j] = own[..., j, axis] + own[..., axis, j]
        quaternion[where, k] = own[..., k, axis] + own[..., axis, k]
        quaternion[where, 3] = own[..., k, j] - own[..., j, k]
    where = largest == 3
    own = rotation[where]
    quaternion[where, 0] = own[..., 2, 1] - own[..., 1, 2]
    quaternion[where, 1] = own[..., 0, 2] - own[..., 2, 0]
    quaternion[where, 2] = own[..., 1, 0] - own[..., 0, 1]
    quaternion[where, 3] = 1.0 + trace[where]
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.concatenate([matrices[..., :3, 3], quaternion], axis=-1)


def _spread(what: str, array: NDArray[Any], size: tuple[int, int], at_end: bool) -> NDArray[Any]:
    """Shape (environments, times, columns)."""
    environments, times = size
    # What has one column is given without it.
    columns = array.ndim == 0 or array.shape[-1] > 1
    shape = array.shape
    wanted = (*size, shape[-1] if shape else 0)
    if at_end and array.ndim == 2 and shape[0] == environments:
        array = array[:, None]
    if array.ndim > 3 or any(a not in {1, b} for a, b in zip(array.shape[::-1], wanted[::-1], strict=False)):
        raise ConfigError(
            f"{what} has the shape {shape if columns else shape[:-1]}; for {environments} environment(s) and "
            f"{times} time(s) give {wanted if columns else size}, or leave out what is the same for all"
        )
    return np.broadcast_to(array, wanted)
