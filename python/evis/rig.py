"""Rigs: calibrated cameras that are fixed to one body, and the calibration files of Kalibr and DSEC.

Files have OpenCV's convention (x right, y down, z forward; pixel centres at whole numbers), everything here
that of EVIS (x right, y up, cameras look along -z; pixel centres at +0.5). `Rig.load` and `Rig.save` convert.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from . import _check, _evis
from ._events import EventArray, EventCarrier, EventWindow
from ._evis import ConfigError
from ._packets import AnyEvents
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


@dataclass(frozen=True, slots=True, eq=False)
class Rectification:
    """Two cameras of a rig whose pictures are rectified: what one shows lies in the same row of the other.

    Made by `Rig.rectify`. Both are seen through one pinhole, `lens`, along the same axes: the baseline runs
    along +x. A point at depth z along the rectified axis has the disparity ``lens.fx * baseline / z`` in
    pixels, its column in the left rectified picture less that in the right one. Pixel centres lie at +0.5.

    Attributes
    ----------
    left, right : RigCamera
        The cameras; their pictures and the rectified ones have one size.
    lens : Lens
        The pinhole of both rectified pictures.
    baseline : float
        Metres between the cameras.
    rectified_from_left, rectified_from_right : numpy.ndarray
        float64 (3, 3), rotations from the cameras' axes to the rectified ones (x right, y up, -z forward).

    Examples
    --------
    >>> import evis
    >>> bent = evis.lens.RadialTangential(k1=-0.3, k2=0.1)
    >>> camera = evis.EventCamera(name="camera", width=64, height=48, fx=56, distortion=bent)
    >>> pair = evis.rig.Rig.stereo(0.1, camera).rectify()
    >>> pair.map("left").shape
    (48, 64, 2)
    """

    left: RigCamera
    right: RigCamera
    lens: Lens
    baseline: float
    rectified_from_left: npt.NDArray[np.float64]
    rectified_from_right: npt.NDArray[np.float64]
    _maps: dict[str, npt.NDArray[np.float64]] = field(default_factory=dict, repr=False)

    def pixels(self, camera: str, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return where places in the picture of a camera lie in its rectified one.

        Parameters
        ----------
        camera : str
            Name of the left or the right camera.
        pixels : array_like
            (N, 2), places in the distorted picture; pixel centres at +0.5.

        Returns
        -------
        numpy.ndarray
            float64 (N, 2), which may be outside of the picture; NaN where the lens sees nothing (beyond the
            radius up to which its model is one to one), or nothing before the rectified plane.

        Raises
        ------
        ConfigError
            If there is no such camera, or the shape is another.
        """
        own, rotation = self._of(camera)
        made: npt.NDArray[np.float64] = self.lens.project(own.lens.unproject(pixels) @ rotation.T)
        return made

    def sources(self, camera: str, pixels: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Return where places in the rectified picture of a camera lie in its own one: inverts `pixels`.

        Parameters
        ----------
        camera : str
            Name of the left or the right camera.
        pixels : array_like
            (N, 2), places in the rectified picture; pixel centres at +0.5.

        Returns
        -------
        numpy.ndarray
            float64 (N, 2), which may be outside of the picture; NaN where the lens shows nothing.

        Raises
        ------
        ConfigError
            If there is no such camera, or the shape is another.
        """
        own, rotation = self._of(camera)
        made: npt.NDArray[np.float64] = own.lens.project(self.lens.unproject(pixels) @ rotation)
        return made

    def map(self, camera: str) -> npt.NDArray[np.float64]:
        """Return the rectified place of every pixel, float64 (H, W, 2): x and y, computed once.

        NaN as in `pixels`. DSEC's ``rectify_map`` is 0.5 less, as float32, with -1 in the place of NaN.

        Raises
        ------
        ConfigError
            If there is no such camera.
        """
        own, _ = self._of(camera)
        if camera not in self._maps:
            y, x = np.mgrid[: own.height, : own.width] + 0.5
            places = self.pixels(camera, np.column_stack([x.ravel(), y.ravel()]))
            made = places.reshape(own.height, own.width, 2)
            made.flags.writeable = False
            self._maps[camera] = made
        return self._maps[camera]

    def events(self, camera: str, events: AnyEvents) -> npt.NDArray[np.float64]:
        """Return the rectified places of events.

        Parameters
        ----------
        camera : str
            Name of the left or the right camera.
        events : EventArray, View or other carrier of events
            N events of this camera.

        Returns
        -------
        numpy.ndarray
            float64 (N, 2), x and y of the middle of each event's pixel in the rectified picture; NaN as in
            `pixels`. Times and polarities are those of the events.

        Raises
        ------
        ConfigError
            If there is no such camera, or the events have another size.
        """
        own, _ = self._of(camera)
        array = events._event_array() if isinstance(events, EventCarrier) else events
        if not isinstance(array, (EventArray, EventWindow)):
            raise ConfigError(
                f"events is {_check.shown(events)}; it must be an EventArray, a window or a view of them"
            )
        if (array.width, array.height) != (own.width, own.height):
            raise ConfigError(
                f"events are {array.width}x{array.height}, and camera {camera!r} has "
                f"{own.width}x{own.height} pixels; give events of this camera"
            )
        return self.map(camera)[array.y, array.x]

    def opencv(self) -> tuple[npt.NDArray[np.float64], ...]:
        """Return R1, R2, P1, P2 and Q as OpenCV's ``stereoRectify`` does.

        Returns
        -------
        tuple of numpy.ndarray
            float64: R1 and R2 (3, 3), rotations from the cameras' axes to the rectified ones; P1 and P2
            (3, 4), projections of points in the rectified axes of the left camera; Q (4, 4), which takes
            (x, y, disparity, 1) there. x right, y down, z forward; pixel centres at whole numbers.
        """
        sign = np.diag([1.0, -1.0, -1.0])
        lens = self.lens
        left = np.zeros((3, 4))
        left[:, :3] = [[lens.fx, 0.0, lens.cx - 0.5], [0.0, lens.fy, lens.cy - 0.5], [0.0, 0.0, 1.0]]
        right = left.copy()
        right[0, 3] = -lens.fx * self.baseline
        tall = lens.fx / lens.fy
        depth = np.array(
            [
                [1.0, 0.0, 0.0, -left[0, 2]],
                [0.0, tall, 0.0, -left[1, 2] * tall],
                [0.0, 0.0, 0.0, lens.fx],
                [0.0, 0.0, 1.0 / self.baseline, 0.0],
            ]
        )
        turned = (sign @ of @ sign for of in (self.rectified_from_left, self.rectified_from_right))
        return (*turned, left, right, depth)

    def _of(self, camera: str) -> tuple[RigCamera, npt.NDArray[np.float64]]:
        if camera == self.left.name:
            return self.left, self.rectified_from_left
        if camera == self.right.name:
            return self.right, self.rectified_from_right
        raise ConfigError(
            f"camera is {_check.shown(camera)}; it must be {_check.one_of((self.left.name, self.right.name))}"
        )


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
            ``camchain.yaml`` or ``cam_to_cam.yaml``; the latter takes one, two or four cameras, and holds the
            rectified ones too where the first and the last are a pair that `rectify` takes (of four, the two
            in the middle as well), or there is one camera.

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

    def rectify(
        self, left: str | None = None, right: str | None = None, *, alpha: float = 0.0
    ) -> Rectification:
        """Return how the pictures of two cameras are rectified, whatever their lenses and relative pose.

        The rotations are those of OpenCV's ``stereoRectify`` and ``fisheye.stereoRectify`` (Bouguet's
        method): each camera takes half of the rotation between both, and the smallest rotation that lays the
        baseline along +x is added. Both get one focal length and one principal point
        (``CALIB_ZERO_DISPARITY``), chosen as ``stereoRectify`` does from the edges of the pictures; of wide
        lenses from the largest part around the centre whose corners are less than 80 degrees from the
        rectified axis. A pair of equal pinholes that is parallel already stays as it is.

        Parameters
        ----------
        left, right : str, optional
            Names of the cameras; those of a rig of two where not given.
        alpha : float
            0: every pixel of the rectified pictures shows something; 1: they hold all that the cameras see;
            between them the focal length is.

        Raises
        ------
        ConfigError
            If there is no such camera, or the rig has others and none is named; for cameras of different
            sizes, at one place, one of which is not to the right of the other, or that look away from each
            other; for an ``alpha`` outside of 0 to 1.
        """
        names = [camera.name for camera in self.cameras]
        if left is None and right is None and len(names) == 2:
            left, right = names
        if left is None or right is None:
            raise ConfigError(
                f"rectify takes the names of two cameras, left and right; the rig has {', '.join(names)}"
            )
        pair = self.camera(left), self.camera(right)
        first, second, (fx, fy, cx, cy), baseline = _evis.rig_rectify(
            self._json(), names.index(left), names.index(right), _check.number("alpha", alpha)
        )
        lens = Lens(fx=fx, fy=fy, cx=cx, cy=cy)
        return Rectification(*pair, lens, baseline, np.array(first), np.array(second))

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
