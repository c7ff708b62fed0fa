"""Rigs: calibrated cameras that are fixed to one body, and the calibration files of Kalibr and DSEC.

Files have OpenCV's convention (x right, y down, z forward; pixel centres at whole numbers), everything here
that of EVIS (x right, y up, cameras look along -z; pixel centres at +0.5). `Rig.load` and `Rig.save` convert.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._evis import ConfigError
from ._scene import EventCamera
from .lens import Distortion, Lens, distortion_of
from .motion import Placement

IDENTITY = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))

Rows = tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class RigCamera:
    """A camera of a rig.

    Attributes
    ----------
    name : str
        Unique name.
    width, height : int
        Pixels.
    fx, fy, cx, cy : float
        Intrinsics in pixels; pixel centres at +0.5.
    distortion : RadialTangential or Fisheye, optional
        Distortion of the lens; a pinhole where not given.
    body_from_camera : tuple of rows
        4x4, a rigid transform in metres, in glTF's axes: the pose of the camera on its body.
    """

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion | None = None
    body_from_camera: Rows = IDENTITY

    @property
    def lens(self) -> Lens:
        """The lens, which projects points and unprojects pixels."""
        return Lens(fx=self.fx, fy=self.fy, cx=self.cx, cy=self.cy, distortion=self.distortion)

    @property
    def pose(self) -> npt.NDArray[np.float64]:
        """The pose on the body, float64 (4, 4), ``body_from_camera``."""
        return np.array(self.body_from_camera, np.float64)

    def _json(self) -> dict[str, Any]:
        distortion = self.distortion
        return {
            "name": self.name,
            "size": [self.width, self.height],
            "intrinsics": [self.fx, self.fy, self.cx, self.cy],
            "distortion": None if distortion is None else [distortion.model, list(distortion.coefficients)],
            "body_from_camera": [list(map(float, row)) for row in self.body_from_camera],
        }


@dataclass(frozen=True, slots=True)
class Rig:
    """Cameras that are fixed to one body.

    Attributes
    ----------
    cameras : tuple of RigCamera
        In the order of the file.

    Examples
    --------
    >>> import evis
    >>> camera = evis.EventCamera(name="camera", width=640, height=480, fx=560, fy=560, cx=320, cy=240)
    >>> rig = evis.rig.Rig.stereo(0.12, camera)
    >>> [camera.name for camera in rig.cameras]
    ['left', 'right']
    """

    cameras: tuple[RigCamera, ...]

    @classmethod
    def stereo(cls, baseline: float, camera: EventCamera) -> Rig:
        """Make a rectified pair: two cameras like `camera`, parallel, named ``left`` and ``right``.

        Parameters
        ----------
        baseline : float
            Metres from the left to the right one, above 0; the body lies in the left one.
        camera : EventCamera
            Width, height, intrinsics and distortion of both; its name and pose are not used.

        Raises
        ------
        ConfigError
            If a number is missing or cannot be used.
        """
        baseline = _check.number("baseline", baseline)
        if baseline <= 0.0:
            raise ConfigError(f"baseline is {baseline}; it must be above 0 metres")
        width, height = camera.width, camera.height
        fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
        if width is None or height is None or fx is None:
            raise ConfigError("a stereo pair takes a camera with width, height and fx")
        left = RigCamera(
            name="left",
            width=width,
            height=height,
            fx=float(fx),
            fy=float(fx if fy is None else fy),
            cx=float(width / 2 if cx is None else cx),
            cy=float(height / 2 if cy is None else cy),
            distortion=camera.distortion,
        )
        aside = ((1.0, 0.0, 0.0, baseline), *IDENTITY[1:])
        rig = cls((left, replace(left, name="right", body_from_camera=aside)))
        _evis.rig_text(rig._json(), "kalibr")
        return rig

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Rig:
        """Read Kalibr's ``camchain.yaml`` or DSEC's ``cam_to_cam.yaml``; the content tells which.

        Cameras are named ``cam0``, ``cam1``, … as in the file; the body lies in ``cam0``. Of DSEC's four
        cameras 0 and 3 see events.

        Raises
        ------
        OSError
            If the file cannot be read.
        FormatError
            If it is neither, or holds a model or a number that cannot be used.
        """
        return cls._of(_evis.load_rig(Path(path)))

    @classmethod
    def parse(cls, text: str) -> Rig:
        """Read the text of such a file.

        Raises
        ------
        ConfigError
            If it is neither, or holds a model or a number that cannot be used.
        """
        return cls._of(_evis.parse_rig(text))

    @classmethod
    def _of(cls, text: str) -> Rig:
        def camera(of: dict[str, Any]) -> RigCamera:
            (width, height), (fx, fy, cx, cy) = of["size"], of["intrinsics"]
            distortion = of["distortion"]
            return RigCamera(
                name=of["name"],
                width=width,
                height=height,
                fx=fx,
                fy=fy,
                cx=cx,
                cy=cy,
                distortion=None if distortion is None else distortion_of(*distortion),
                body_from_camera=tuple(tuple(row) for row in of["body_from_camera"]),
            )

        return cls(tuple(camera(of) for of in json.loads(text)["cameras"]))

    def text(self, format: Literal["kalibr", "dsec"] = "kalibr") -> str:
        """Return the text of a calibration file.

        Parameters
        ----------
        format : {"kalibr", "dsec"}
            ``camchain.yaml`` or ``cam_to_cam.yaml``; the latter takes one, two or four cameras.

        Raises
        ------
        ConfigError
            If the format does not exist, or a camera cannot be used.
        """
        return _evis.rig_text(self._json(), str(format))

    def save(self, path: str | PathLike[str], format: Literal["kalibr", "dsec"] = "kalibr") -> None:
        """Write a calibration file: see `text`.

        Raises
        ------
        OSError
            If the file cannot be written.
        ConfigError
            If the format does not exist, or a camera cannot be used.
        """
        Path(fspath(path)).write_text(self.text(format), encoding="utf-8")

    def event_cameras(self, parent: str | None = None, **settings: Any) -> tuple[EventCamera, ...]:
        """Return the cameras for a scene.

        Parameters
        ----------
        parent : str, optional
            Node that is their body; the world where not given.
        **settings
            Further fields of every `EventCamera`, such as ``near`` and ``sensor``.

        Examples
        --------
        >>> import evis
        >>> camera = evis.EventCamera(name="camera", width=64, height=48, fx=56)
        >>> rig = evis.rig.Rig.stereo(0.1, camera)
        >>> evis.Scene.builtin("spinner").with_cameras(rig.event_cameras()).cameras[-2:]
        ('left', 'right')
        """
        made = []
        for camera in self.cameras:
            pose = camera.pose
            made.append(
                EventCamera(
                    name=camera.name,
                    width=camera.width,
                    height=camera.height,
                    fx=camera.fx,
                    fy=camera.fy,
                    cx=camera.cx,
                    cy=camera.cy,
                    distortion=camera.distortion,
                    pose=Placement(
                        position=tuple(map(float, pose[:3, 3])),
                        rotation=_quaternion(pose[:3, :3]),
                        parent=parent,
                    ),
                    **settings,
                )
            )
        return tuple(made)

    def transform(self, destination: str, source: str) -> npt.NDArray[np.float64]:
        """Return ``destination_from_source`` of two cameras, float64 (4, 4).

        It takes points, in metres, from the axes of the camera ``source`` to those of ``destination``:
        glTF's, x right, y up, -z forward.

        Raises
        ------
        ConfigError
            If there is no such camera.
        """
        moved = np.linalg.solve(self.camera(destination).pose, self.camera(source).pose)
        return np.asarray(moved, np.float64)

    @property
    def T_right_left(self) -> npt.NDArray[np.float64]:  # noqa: N802 - the field's name for it
        """Of a rig of two cameras, ``right_from_left`` in OpenCV's axes, float64 (4, 4).

        It takes points, in metres, from the left camera's axes (x right, y down, z forward) to the right
        one's: Kalibr's ``T_cn_cnm1`` of the second camera, R and T of OpenCV's ``stereoRectify``. The first
        camera is the left one.

        Raises
        ------
        ConfigError
            If there are not two cameras; `transform` takes names.
        """
        if len(self.cameras) != 2:
            raise ConfigError(
                f"T_right_left is of two cameras; the rig has {len(self.cameras)}: use transform(to, of)"
            )
        left, right = (camera.name for camera in self.cameras)
        flip = np.diag([1.0, -1.0, -1.0, 1.0])
        made: npt.NDArray[np.float64] = flip @ self.transform(right, left) @ flip
        return made

    def camera(self, name: str) -> RigCamera:
        """Return the camera of this name.

        Raises
        ------
        ConfigError
            If there is none; lists those that exist.
        """
        for camera in self.cameras:
            if camera.name == name:
                return camera
        known = ", ".join(camera.name for camera in self.cameras)
        raise ConfigError(f"the rig has no camera {name!r}; it has {known}")

    def _json(self) -> str:
        return json.dumps({"cameras": [camera._json() for camera in self.cameras]})


def _quaternion(rotation: npt.NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of a rotation matrix (Shepperd's method)."""
    m = rotation
    choices = np.array([m[0, 0], m[1, 1], m[2, 2], np.trace(m)])
    i = int(choices.argmax())
    q = np.empty(4)
    if i == 3:
        q[:] = (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1.0 + choices[3])
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1.0 - choices[3] + 2.0 * m[i, i]
        q[j] = m[j, i] + m[i, j]
        q[k] = m[k, i] + m[i, k]
        q[3] = m[k, j] - m[j, k]
    q /= np.linalg.norm(q)
    return (float(q[0]), float(q[1]), float(q[2]), float(q[3]))
