"""Stand-ins for hosts: textured pictures that move; Isaac Lab's classes, with fields and order of calls.

What the stand-in has was read from the published sources of Isaac Lab 2.3.2 and 3.0.0; `FIELDS` is held
against them in test_isaaclab.py where they are there.
"""

from __future__ import annotations

import copy
import dataclasses
import enum
import inspect
import sys
import types
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

WIDTH, HEIGHT = 64, 48

Outputs = dict[str, npt.NDArray[Any]]


def sliding(k: int, envs: int = 2, step: tuple[float, float] = (3.0, 2.0)) -> Outputs:
    """Textured pictures that move by `step` pixels per keyframe, in Isaac's shapes."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    picture = (
        0.5
        + 0.2 * np.sin((x - step[0] * k) / 3)
        + 0.2 * np.cos((y - step[1] * k) / 4 + (x - step[0] * k) / 9)
    )
    light = np.repeat(picture[..., None], 3, axis=-1).astype(np.float32)
    motion = np.zeros((HEIGHT, WIDTH, 2), np.float32)
    motion[...] = -np.float32(step)
    depth = np.full((HEIGHT, WIDTH, 1), 2.0, np.float32)
    return {
        "rgb_radiance": np.stack([light] * envs),
        "distance_to_image_plane": np.stack([depth] * envs),
        "motion_vectors": np.stack([motion] * envs),
    }


MISSING = dataclasses.MISSING

# Defaults of `SensorBaseCfg` and `CameraCfg`, by release; None stands for objects of Isaac Lab.
_BOTH: dict[str, Any] = {
    "class_type": None,
    "prim_path": MISSING,
    "update_period": 0.0,
    "debug_vis": False,
    "offset": None,
    "spawn": MISSING,
    "depth_clipping_behavior": "none",
    "data_types": ["rgb"],
    "width": MISSING,
    "height": MISSING,
    "update_latest_camera_pose": False,
    "semantic_filter": "*:*",
    "colorize_semantic_segmentation": True,
    "colorize_instance_id_segmentation": True,
    "colorize_instance_segmentation": True,
    "semantic_segmentation_mapping": {},
}
FIELDS: dict[str, dict[str, Any]] = {
    "2.3.2": _BOTH | {"history_length": 0},
    "3.0.0": _BOTH
    | {"cloning_contexts": (), "background_color": None, "renderer_cfg": None, "isp_cfg": None},
}

# Members of `RenderBufferKind` in 3.0.0; 2.3.2 passes names on to Replicator.
BUFFERS = {
    "rgb",
    "rgba",
    "rgb_hdr",
    "albedo",
    "depth",
    "distance_to_image_plane",
    "distance_to_camera",
    "normals",
    "motion_vectors",
    "semantic_segmentation",
    "instance_segmentation",
    "instance_id_segmentation_fast",
    "simple_shading_constant_diffuse",
    "simple_shading_diffuse_mdl",
    "simple_shading_full_mdl",
}


def configclass(cls: Any) -> Any:
    """A dataclass whose fields have defaults of their own each, and a copy and a check."""
    for name in inspect.get_annotations(cls):
        default = cls.__dict__.get(name, MISSING)
        setattr(cls, name, dataclasses.field(default_factory=lambda default=default: copy.deepcopy(default)))

    def validate(self: Any) -> None:
        missing = [
            field.name
            for field in dataclasses.fields(self)
            if isinstance(getattr(self, field.name), type(MISSING))
        ]
        if missing:
            raise TypeError(f"Missing values: {missing}")

    cls.copy = lambda self: dataclasses.replace(self)
    cls.validate = validate
    return dataclasses.dataclass(cls)


class HostTensor(np.ndarray[Any, Any]):
    """A tensor on the CPU, as far as the adapter and its tests use one."""

    def to(self, device: str) -> HostTensor:
        assert device.startswith("cpu")
        return self

    def float(self) -> HostTensor:
        return self.astype(np.float32, copy=False)  # type: ignore[return-value]

    def clone(self) -> HostTensor:
        return self.copy()  # type: ignore[return-value]

    def detach(self) -> HostTensor:
        return self

    def numpy(self) -> npt.NDArray[Any]:
        return self.view(np.ndarray)


def torch_or_stand_in(patch: pytest.MonkeyPatch) -> None:
    """Put a stand-in where PyTorch would be, unless it is installed: `make test-torch` runs with it."""
    try:
        import torch  # noqa: F401
    except ImportError:
        module: Any = types.ModuleType("torch")
        module.from_numpy = lambda array: array.view(HostTensor)
        module.tensor = lambda values: np.array(values).view(HostTensor)
        module.float32 = np.dtype("float32")
        patch.setitem(sys.modules, "torch", module)


class OnCard:
    """A tensor on a graphics card, as far as a host sees it."""

    device = "cuda:0"

    def __init__(self, array: npt.NDArray[Any]) -> None:
        self._array = array

    def __dlpack_device__(self) -> tuple[int, int]:
        return (2, 0)

    def detach(self) -> OnCard:
        return self

    def cpu(self) -> npt.NDArray[Any]:
        return self._array.copy()

    def __array__(self, *_: Any, **__: Any) -> npt.NDArray[Any]:
        raise TypeError("can't convert cuda:0 device type tensor to numpy")


class ProxyArray:
    """A tensor behind `.torch`, as outputs are from 3.0 on; taken for a tensor, it would warn."""

    def __init__(self, array: Any) -> None:
        self._array = array

    @property
    def torch(self) -> Any:
        return self._array

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"{name} of a proxy: use .torch")


class Mask:
    """A warp array of bools, as far as cameras use it."""

    def __init__(self, values: npt.NDArray[np.bool_]) -> None:
        self._values = values

    def numpy(self) -> npt.NDArray[np.bool_]:
        return self._values


class _Data:
    """Camera data whose output cannot be set, as from 3.0 on."""

    image_shape = None

    def __init__(self) -> None:
        self._output: dict[str, Any] = {}
        self.info: Any = {}

    @property
    def output(self) -> dict[str, Any]:
        return self._output


class Camera2:
    """The order of calls of `Camera` and `SensorBase` in 2.3.2."""

    num_envs = 2
    render: Callable[[], dict[str, Any]]

    def __init__(self, cfg: Any) -> None:
        cfg.validate()
        self.cfg = cfg.copy()
        self._is_initialized = False

    @property
    def num_instances(self) -> int:
        return self._num_envs

    def play(self) -> None:
        """What happens when the simulation first plays."""
        self._initialize_impl()
        self._is_initialized = True

    def _initialize_impl(self) -> None:
        self._device = "cpu"
        self._num_envs = type(self).num_envs
        self._ALL_INDICES = np.arange(self._num_envs)
        self._ALL_ENV_MASK = Mask(np.ones(self._num_envs, np.bool_))
        self._is_outdated = np.ones(self._num_envs, np.bool_)
        self._timestamp = np.zeros(self._num_envs, np.float32)
        self._timestamp_last_update = np.zeros(self._num_envs, np.float32)
        self._data = _Data()

    @property
    def data(self) -> Any:
        self._update_outdated_buffers()
        return self._data

    def reset(self, env_ids: Any = None) -> None:
        ids = slice(None) if env_ids is None else env_ids
        self._timestamp[ids] = 0.0
        self._timestamp_last_update[ids] = 0.0
        self._is_outdated[ids] = True

    def update(self, dt: float, force_recompute: bool = False) -> None:
        self._timestamp += np.float32(dt)
        passed = self._timestamp - self._timestamp_last_update + 1e-6
        self._is_outdated |= passed >= self.cfg.update_period
        if force_recompute:
            self._update_outdated_buffers()

    def _update_outdated_buffers(self) -> None:
        (due,) = np.nonzero(self._is_outdated)
        if len(due):
            self._update_buffers_impl(due)
            self._timestamp_last_update[due] = self._timestamp[due]
            self._is_outdated[due] = False

    def _update_buffers_impl(self, env_ids: Any) -> None:
        outputs = self.render()
        assert set(outputs) == set(self.cfg.data_types), "what was asked for, and nothing else"
        made = {name: self._given(array) for name, array in outputs.items()}
        if not self._data.output:
            self._data._output = made
        for name, array in made.items():
            # Of what was rendered last, those that are due are read; others keep what they had.
            self._data.output[name][env_ids] = array[env_ids]

    def _given(self, array: Any) -> Any:
        import torch

        return torch.from_numpy(array)


class Camera3(Camera2):
    """The order of calls of `Camera` and `SensorBase` in 3.0.0: masks, and proxies of tensors."""

    def _initialize_impl(self) -> None:
        super()._initialize_impl()
        self._data_dirty = True

    def reset(self, env_ids: Any = None, env_mask: Any = None) -> None:
        super().reset(env_ids if env_mask is None else env_mask.numpy())
        self._data_dirty = True

    def update(self, dt: float, force_recompute: bool = False) -> None:
        if not self._is_initialized:
            return
        self._data_dirty = True
        super().update(dt, force_recompute)

    def _env_mask_has_any(self, env_mask: Mask) -> bool:
        return self.cfg.update_period <= 0.0 or bool(np.any(env_mask.numpy()))

    def _update_outdated_buffers(self) -> None:
        if not self._data_dirty:
            return
        due = self._is_outdated.copy()
        # Called also where nothing is due: implementations look for themselves.
        self._update_buffers_impl(Mask(due))
        self._timestamp_last_update[due] = self._timestamp[due]
        self._is_outdated[due] = False
        self._data_dirty = False

    def _update_buffers_impl(self, env_mask: Any) -> None:
        if self._env_mask_has_any(env_mask):
            # One picture of all environments is rendered and taken apart.
            outputs = self.render()
            assert set(outputs) == set(self.cfg.data_types), "what was asked for, and nothing else"
            self._data._output = {name: self._given(array) for name, array in outputs.items()}

    def _given(self, array: Any) -> Any:
        return ProxyArray(super()._given(array))


def install(patch: pytest.MonkeyPatch, release: str, buffers: set[str] = BUFFERS) -> types.ModuleType:
    """Put the stand-in of a release where Isaac Lab would be; return `isaaclab.sensors`."""
    import evis.isaaclab

    torch_or_stand_in(patch)
    defaults = FIELDS[release]
    namespace = {"__annotations__": dict.fromkeys(defaults, Any), "OffsetCfg": object, **defaults}
    camera = types.new_class("Camera", (Camera2 if release < "3" else Camera3,))
    modules = {
        "isaaclab": {},
        "isaaclab.sensors": {"Camera": camera, "CameraCfg": configclass(type("CameraCfg", (), namespace))},
        "isaaclab.utils": {"configclass": configclass},
        "isaaclab.utils.warp": {},
        "warp": {},
    }
    if release >= "3":
        modules["isaaclab.utils.warp"] = {"ProxyArray": ProxyArray}
        modules["warp"] = {"from_torch": lambda tensor: tensor}
        kinds = enum.Enum("RenderBufferKind", {name.upper(): name for name in sorted(buffers)})
        modules |= {
            "isaaclab.renderers": {},
            "isaaclab.renderers.output_contract": {"RenderBufferKind": kinds},
        }
    for name in ("isaaclab.renderers", "isaaclab.renderers.output_contract"):
        patch.setitem(sys.modules, name, None)
    for name, content in modules.items():
        module = types.ModuleType(name)
        module.__dict__.update(content)
        module.__path__ = []
        patch.setitem(sys.modules, name, module)
    evis.isaaclab._classes.cache_clear()
    return sys.modules["isaaclab.sensors"]
