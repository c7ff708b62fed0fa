"""Keyframes to events in PyTorch: warp and trigger where the renderer's tensors are.

The algorithm is that of the engine's `EventEmulator.push_keyframe` (``emulator/keyframes`` and
``emulator/ideal.rs`` of evis-core): the same float32 arithmetic in the same order, so that on a CPU the
events are the same to the byte. Nearest surfaces and indices are maxima, which no order of threads changes.
Only sums of ``evis-paper`` (float64) depend on it on a graphics card, in their last bits.

Letters in shapes: N environments, M of them at once, S pixels of a keyframe (margin included), P of the
sensor.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import torch

from ._check import shown
from ._device_events import DeviceEvents
from ._emulator import EventEmulator, KeyframeReport
from ._evis import ConfigError
from ._host_arrays import Copies, unwrapped
from ._luminance import EXACT_WEIGHTS, SRGB_LIGHT
from ._method import Warp
from ._sensor import Sensor

_SUBPIXEL_BITS = 10
_SUBPIXELS = 1 << _SUBPIXEL_BITS
_SAME_SURFACE = 0.95
"""Depths at least this part of one another are of one surface."""
_SAME_OVER_TIME = 0.7
"""The same at two times: a surface may have come nearer."""
_MOTION_LIMIT = 16_384.0
"""A motion vector with a component of so many pixels is none."""
_MOST_PIXELS = 1 << 24
_NO_DEPTH = 2e6
_NEARNESS_PER_PX = 0.05
_LARGEST_INVERSE_DEPTH = 1e6
_LEAST_LINKED = 0.2
_FASTEST_SHARE = 1e-3
_ROUNDS = 16
_UNDIVIDED_PX = 1.0
_STEP_PX = 0.3
_MOST_STEPS = 256
_WARN_GAP_PX = 4.0
_SHARPNESS = 12.0
_MOST_EXPONENT = 600.0
_HOLE_BELOW = 1e-4
_MOST_EVENTS = 65_535.0
_MOST_INTERVAL_US = 1 << 30

_CHUNK_PIXELS = 1 << 20
"""Pixels that are warped at once, at most, or one environment: bounds what a push takes beside its state."""

_AROUND = [(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1)]


class TorchKeyframes:
    """An ideal sensor's events between keyframes of N environments, in PyTorch operations on one device.

    It does what `EventEmulator.push_keyframe` does for sensors of thresholds, ``log_eps`` and the triggers
    ``crossing`` and ``latch``; without ``motion_forward``, ``motion_steps`` and declared cuts.

    Parameters
    ----------
    num_envs, height, width : int
        Environments, and size of the sensor in pixels.
    sensor : Sensor
        One of thresholds alone (`Sensor.thresholds_only`).
    warp : Warp
        How the instants between keyframes are made.
    reference_luminance : float
        Y_ref of the sensor's formula.
    device : torch.device or str
        Where tensors come from and events stay.

    Raises
    ------
    ConfigError
        If the sensor has other stages, or a value cannot be used.
    """

    def __init__(
        self,
        num_envs: int,
        height: int,
        width: int,
        *,
        sensor: Sensor,
        warp: Warp,
        reference_luminance: float,
        device: Any,
    ) -> None:
        if not sensor.thresholds_only:
            raise ConfigError(
                f"sensor is {shown(sensor)}; in PyTorch it must be one of thresholds, log_eps and trigger "
                "alone: the engine has the other stages"
            )
        margin = warp.margin or 0
        canvas = (height + 2 * margin, width + 2 * margin)
        if canvas[0] * canvas[1] >= _MOST_PIXELS:
            raise ConfigError(
                f"size of a keyframe is {canvas[1]}x{canvas[0]}; it must be below {_MOST_PIXELS} pixels"
            )
        # The engine checks values: those of the warp with a keyframe.
        tried = EventEmulator(1, 1, sensor, reference_luminance=reference_luminance)
        nothing = np.zeros((1 + 2 * margin, 1 + 2 * margin, 2), np.float32)
        tried.push_keyframe(nothing[..., 0], None, nothing, 0, warp=warp)
        self._num_envs, self._size, self._canvas, self._margin = num_envs, (height, width), canvas, margin
        self._sensor, self._warp = sensor, warp
        self._y_ref = float(np.float32(reference_luminance))
        self._inverse = float(np.float32(1) / np.float32(self._y_ref))
        self._eps = float(np.float32(sensor.log_eps))
        self._device = torch.device(device)
        thresholds = np.array([sensor.threshold_on, sensor.threshold_off], np.float32)
        self._on, self._off = torch.from_numpy(thresholds).to(self._device)
        with torch.inference_mode(False):
            self._reference = self._unseen()
            self._log = self._unseen()
        self._started = np.zeros(num_envs, np.bool_)
        self._now_us: int | None = None
        self._last: _Keyframe | None = None
        self._reports: tuple[KeyframeReport, ...] = ()

    @property
    def device(self) -> Any:
        """Where tensors come from and events stay: a ``torch.device``."""
        return self._device

    @property
    def reports(self) -> tuple[KeyframeReport, ...]:
        """What became of the last keyframe, per environment; empty before the first one."""
        return self._reports

    def nothing(self) -> DeviceEvents:
        """Return no events."""
        return _Fired().packed(self._num_envs, self._size, 0, self._device)

    def is_last(self, light: Any, motion: Any) -> bool:
        """Whether these are luminance and motion vectors of the last keyframe, bit by bit."""
        last = self._last
        if last is None:
            return False
        pairs = ((light.flatten(1), last.light), (motion, last.given))
        return all(torch.equal(_bits(new), _bits(old)) for new, old in pairs)

    def check_device(self, what: str, values: Any) -> None:
        """Raise `ConfigError` if a tensor is elsewhere."""
        if values.device != self._device:
            raise ConfigError(
                f"{what} is on {values.device}; it must be on {self._device}, where events are made, or set "
                "backend='engine'"
            )

    @property
    def last_light(self) -> Any:
        """Luminance of the last keyframe, float32 (N, H, W), not to be changed; None before the first one."""
        return None if self._last is None else self._last.light.unflatten(1, self._canvas)

    def luminance(self, light: Any) -> Any:
        """Return linear luminance of pictures.

        Parameters
        ----------
        light : torch.Tensor
            (N, H, W, 1) or (N, H, W, 3): linear float32, or uint8 under the sRGB curve.

        Returns
        -------
        torch.Tensor
            float32 (N, H, W); shares memory with `light` where that has one channel of floats.
        """
        weights = EXACT_WEIGHTS if light.shape[-1] == 3 else (1.0,)
        if light.dtype == torch.uint8:
            tables = [
                (weight * SRGB_LIGHT).astype(np.float32) * np.float32(self._inverse) for weight in weights
            ]
            parts = [
                torch.from_numpy(table).to(light.device)[light[..., channel].long()]
                for channel, table in enumerate(tables)
            ]
            return sum(parts[1:], parts[0]) * self._y_ref
        if len(weights) == 1:
            return light[..., 0]
        r, g, b = weights
        return r * light[..., 0] + g * light[..., 1] + b * light[..., 2]

    def push(self, light: Any, depth: Any, motion: Any, t_us: int) -> DeviceEvents:
        """Take keyframes of one time; return the events since the last ones.

        Parameters
        ----------
        light : torch.Tensor
            float32 (N, H, W), `luminance`, H and W with the margin; at least 0, NaN unknown.
        depth : torch.Tensor, optional
            float32 (N, H, W): planar metres, +inf where nothing is.
        motion : torch.Tensor
            float32 (N, H, W, 2): pixels to where each surface was at the last keyframe.
        t_us : int
            Microseconds, above the last time.

        Returns
        -------
        DeviceEvents
            Events in ``(t0, t1]``.

        Raises
        ------
        ConfigError
            If a tensor is on another device, of another shape or type, light is negative or infinite, or the
            time cannot be used. Nothing has changed then.
        """
        # What is kept must outlive a caller's inference mode, and has no history.
        with torch.inference_mode(False), torch.no_grad():
            return self._push(light, depth, motion, t_us)

    def _push(self, light: Any, depth: Any, motion: Any, t_us: int) -> DeviceEvents:
        self._check(light, depth, motion)
        gap_us = self._gap_us(t_us)
        now, bad = self._read(light, depth, motion)
        before = self._last
        linked = self._started.copy()
        motion_px, share = np.zeros(self._num_envs, np.float32), np.zeros(self._num_envs, np.float32)
        if before is not None and linked.any():
            found = _links(before, now, self._canvas).cpu().numpy()
            motion_px, share = (np.where(linked, values, np.float32(0)) for values in found)
        detects = self._warp.detect_cuts
        if detects is None:
            detects = self._warp.variant == "splat"
        cut = linked & (share < np.float32(_LEAST_LINKED)) & detects
        warped = linked & ~cut
        steps = np.where(warped, np.minimum(self._wanted(motion_px), max(gap_us, 1)), 1)
        now.gap_us = np.where(warped, gap_us, 0)
        fired = _Fired()
        unknown = torch.zeros(self._num_envs, dtype=torch.int64, device=self._device)
        for chunk in _chunks(steps, max(1, _CHUNK_PIXELS // (self._canvas[0] * self._canvas[1]))):
            unknown[chunk] = self._advance(before, now, chunk, steps[chunk], gap_us, fired)
        # From here on nothing fails.
        self._last, self._now_us = now, t_us
        self._started[:] = True
        kinds = np.where(linked, np.where(cut, "detected", "none"), "start").tolist()
        counts = torch.stack([unknown, *bad]).tolist()
        self._reports = tuple(
            _report(int(steps[env]), float(motion_px[env]), float(share[env]), counts, env, kinds[env])
            for env in range(self._num_envs)
        )
        return fired.packed(self._num_envs, self._size, t_us - gap_us, self._device)

    def reset(self, environments: Iterable[int]) -> None:
        """Let environments start again with their next keyframe."""
        ids = list(environments)
        self._started[ids] = False
        with torch.inference_mode(False):
            # Of a pixel without a reference, nothing else is used.
            self._reference[ids] = math.nan

    def _unseen(self) -> Any:
        pixels = self._size[0] * self._size[1]
        return torch.full((self._num_envs, pixels), math.nan, dtype=torch.float32, device=self._device)

    def _check(self, light: Any, depth: Any, motion: Any) -> None:
        shape = (self._num_envs, *self._canvas)
        for what, values, wanted in (
            ("light", light, shape),
            ("depth", depth, shape),
            ("motion_vectors", motion, (*shape, 2)),
        ):
            if values is None and what == "depth":
                continue
            if not isinstance(values, torch.Tensor):
                raise ConfigError(f"{what} is {shown(values)}; it must be a tensor on {self._device}")
            self.check_device(what, values)
            if tuple(values.shape) != wanted or values.dtype != torch.float32:
                raise ConfigError(
                    f"{what} has shape {tuple(values.shape)} and dtype {values.dtype}; it must have {wanted} "
                    "and torch.float32"
                )
        impossible = torch.isinf(light) | (light < 0)
        if bool(impossible.any()):
            env, y, x = torch.nonzero(impossible)[0].tolist()
            raise ConfigError(
                f"light of pixel ({x}, {y}) of environment {env} is {float(light[env, y, x])}; it must be "
                "finite and at least 0, or NaN where unknown"
            )
        if self._last is not None and self._started.any() and self._last.has_depth == (depth is None):
            given = ("not given", "given") if depth is None else ("given", "left out")
            raise ConfigError(
                f"depth is {given[0]}; it must be {given[1]}, as at the last keyframe; or reset all "
                "environments first"
            )

    def _gap_us(self, t_us: int) -> int:
        if self._now_us is None or not self._started.any():
            return 0
        gap_us = t_us - self._now_us
        if not 0 < gap_us <= _MOST_INTERVAL_US:
            raise ConfigError(
                f"t_us is {t_us}; it must be above {self._now_us}, that of the last keyframe, and at most "
                f"{_MOST_INTERVAL_US} microseconds after it"
            )
        return gap_us

    def _wanted(self, motion_px: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """Instants of each environment's gap."""
        if self._warp.steps is not None:
            return np.full(self._num_envs, self._warp.steps, np.int64)
        step_px = np.float32(_STEP_PX if self._warp.step_px is None else self._warp.step_px)
        steps = np.clip(np.ceil(motion_px / step_px), 1, _MOST_STEPS).astype(np.int64)
        return np.where(motion_px > _UNDIVIDED_PX, steps, 1)

    def _read(self, light: Any, depth: Any, motion: Any) -> tuple[_Keyframe, list[Any]]:
        """Return what is kept of a keyframe; and how many depths and vectors are none, int64 (N,) each."""
        motion = motion.clone()
        flat = motion.flatten(1, 2)
        bad_motion = (~_is_motion(flat)).sum(1)
        if depth is None:
            nearness, bad_depth = torch.full_like(light, _NO_DEPTH).flatten(1), torch.zeros_like(bad_motion)
        else:
            depth = depth.flatten(1)
            is_depth = depth > 0
            bad_depth = (~is_depth).sum(1)
            inverse = (1.0 / depth).clamp(max=_LARGEST_INVERSE_DEPTH)
            nearness = torch.where(is_depth, inverse / (1.0 + 1e-3 * inverse), 0.0)
        back = flat
        if depth is not None and self._warp.variant == "splat":
            nearest = _nearest_around(nearness, self._canvas)
            back = flat.gather(1, nearest[..., None].expand(-1, -1, 2))
            nearness = nearness.gather(1, nearest)
        light = light.flatten(1).clone()
        gaps = np.zeros(self._num_envs, np.int64)
        return _Keyframe(gaps, light, nearness, back, motion, depth is not None), [bad_depth, bad_motion]

    def _advance(
        self,
        before: _Keyframe | None,
        now: _Keyframe,
        chunk: npt.NDArray[np.int64],
        steps: npt.NDArray[np.int64],
        gap_us: int,
        fired: _Fired,
    ) -> Any:
        """Warp and trigger the gap of the environments `chunk`, those of most instants first.

        Returns how many pixels were unknown at all instants, int64 (M,).
        """
        ids = torch.from_numpy(chunk).to(self._device)
        most = int(steps[0])
        k = np.arange(most + 1)[:, None]
        ends = np.minimum((k * gap_us + steps // 2) // steps, gap_us)
        elapsed = torch.from_numpy((ends / max(gap_us, 1)).astype(np.float32)).to(self._device)
        reference, log = self._reference[ids], self._log[ids]
        end = self._crop(now.light[ids])
        gap = None
        divided = int((steps > 1).sum())
        if before is not None and divided:
            gap = self._gap(before.of(ids[:divided], chunk[:divided]), now.of(ids[:divided], chunk[:divided]))
        offsets = torch.from_numpy(ends).to(self._device)
        unknown = torch.zeros(len(chunk), dtype=torch.int64, device=self._device)
        for step in range(1, most + 1):
            active, between = int((steps >= step).sum()), int((steps > step).sum())
            light = end[:active]
            if gap is not None and between:
                made = gap.instant(elapsed[step, :between], between)
                light = torch.cat([made, end[between:active]])
            interval = (offsets[step - 1, :active], offsets[step, :active])
            unknown[:active] += self._fire(
                light, reference[:active], log[:active], interval, ids[:active], fired
            )
        self._reference[ids], self._log[ids] = reference, log
        return unknown

    def _crop(self, light: Any) -> Any:
        """Return the sensor's part (M, P) of pictures (M, S)."""
        (height, width), margin = self._size, self._margin
        if not margin:
            return light
        whole = light.unflatten(1, self._canvas)
        return whole[:, margin : margin + height, margin : margin + width].flatten(1)

    def _gap(self, older: _Keyframe, newer: _Keyframe) -> _Gap:
        forward = _forward_motion(older, newer, self._canvas)
        near, near_now = older.nearness, newer.nearness
        if not newer.has_depth:
            near, near_now = (_by_motion(m, self._warp.variant) for m in (forward, newer.back))
        kind = _Splat if self._warp.variant == "splat" else _Paper
        floor = float(np.float32(self._eps) * np.float32(self._y_ref))
        sides = ((older.light, near, forward), (newer.light, near_now, newer.back))
        return kind(sides, self._canvas, self._size, self._margin, floor)

    def _fire(
        self,
        light: Any,
        reference: Any,
        log: Any,
        interval: tuple[Any, Any],
        ids: Any,
        fired: _Fired,
    ) -> Any:
        """Trigger on light (M, P) at an interval's end; move references and logarithms on.

        Returns how many pixels were unknown, int64 (M,).
        """
        is_known = ~torch.isnan(light)
        now = _ln(light * self._inverse + self._eps)
        change = now - reference
        steps = change.abs() / torch.where(change >= 0, self._on, self._off)
        # Of a pixel that was never seen, the reference is NaN, and so are these.
        firing = torch.nonzero(is_known & (steps >= 1))
        env, pixel = firing[:, 0], firing[:, 1]
        start, end = interval[0][env], interval[1][env]
        r, l0, l1 = reference[env, pixel], log[env, pixel], now[env, pixel]
        rises = l1 - r >= 0
        c = torch.where(rises, self._on, self._off)
        if self._sensor.trigger == "latch":
            fired.add(ids[env], pixel, end, rises)
            moved = l1
        else:
            whole = steps[env, pixel].clamp(max=_MOST_EVENTS + 1).trunc()
            number = whole.clamp(max=_MOST_EVENTS)
            run_up = number * c
            moved = torch.where(whole > _MOST_EVENTS, l1, r + torch.where(rises, run_up, -run_up))
            sign = rises.float() * 2.0 - 1.0
            rise_start, rise_end = (l0 - r) * sign, (l1 - r) * sign
            run, us = rise_end - rise_start, end - start
            copies = number.long()
            of = torch.repeat_interleave(copies)
            k = (torch.arange(len(of), device=of.device) - (copies.cumsum(0) - copies)[of] + 1).float()
            part = torch.where(run[of] > 0, (k * c[of] - rise_start[of]) / run[of], 1.0).clamp(0.0, 1.0)
            after = (part * us[of].float()).long().clamp(min=1).minimum(us[of])
            fired.add(ids[env][of], pixel[of], start[of] + after, rises[of])
        reference[env, pixel] = moved
        reference.copy_(torch.where(torch.isnan(reference) & is_known, now, reference))
        log.copy_(torch.where(is_known, now, log))
        return (~is_known).sum(1)


def as_tensor(what: str, values: Any, dtypes: Sequence[str] = ("float32",)) -> Any:
    """Return tensors, proxies of them and arrays as a tensor where they are, of one of `dtypes`.

    Floats of other sizes become float32.

    Raises
    ------
    ConfigError
        If it is neither, or of another dtype.
    """
    tensor = unwrapped(values)
    if not isinstance(tensor, torch.Tensor):
        array = np.ascontiguousarray(Copies().take(what, tensor))
        tensor = torch.from_numpy(array if array.flags.writeable else array.copy())
    given = tensor.dtype
    if given.is_floating_point:
        tensor = tensor.to(torch.float32)
    if tensor.dtype not in [getattr(torch, name) for name in dtypes]:
        name = str(given).removeprefix("torch.")
        raise ConfigError(f"dtype of {what} is {name}; it must be {' or '.join(dtypes)}")
    return tensor


# What is asked of pictures of N environments, (N, H, W, C); answers are on the host.


def any_depth(depth: Any) -> bool:
    """Whether there is any depth, where there is one at all."""
    return depth is not None and bool((torch.isfinite(depth) & (depth > 0)).any())


def fastest(motion: Any) -> list[float]:
    """Largest component of the motion vectors of each environment, 0 where none is known."""
    return _numbers(motion.abs().nan_to_num(0.0, posinf=math.inf).flatten(1).amax(1))


def speeds(motion: Any) -> list[float]:
    """Sum of the components of the motion vectors of each environment."""
    return _numbers(motion.abs().nan_to_num(0.0, posinf=0.0).flatten(1).sum(1))


def known_shares(motion: Any) -> list[float]:
    """Share of the motion vectors of each environment that are finite."""
    return _numbers(torch.isfinite(motion).flatten(1).float().mean(1))


def on_host(env: int, *pictures: Any) -> tuple[npt.NDArray[Any], ...]:
    """Copy pictures of one environment to the CPU."""
    return tuple(picture[env].cpu().numpy().copy() for picture in pictures)


def _numbers(values: Any) -> list[float]:
    return [float(value) for value in values.tolist()]


@dataclass
class _Keyframe:
    """What is kept of the keyframes of N environments until the next ones come."""

    gap_us: npt.NDArray[np.int64]
    """Since the ones before, on the host; 0: there was none, so that `back` says nothing."""
    light: Any
    """(N, S)"""
    nearness: Any
    """(N, S): 1 / (depth + 1e-3), 0 where nothing is."""
    back: Any
    """(N, S, 2)"""
    given: Any
    """(N, H, W, 2): motion vectors as they came."""
    has_depth: bool

    def of(self, ids: Any, numbers: npt.NDArray[np.int64]) -> _Keyframe:
        """Those of some environments, by their numbers on the device and on the host."""
        own = (self.light[ids], self.nearness[ids], self.back[ids])
        # `given` is for comparison with the next one alone.
        return _Keyframe(self.gap_us[numbers], *own, None, self.has_depth)


class _Fired:
    """Events as they are found, by instant, pixel and firing order."""

    def __init__(self) -> None:
        self._parts: list[tuple[Any, Any, Any, Any]] = []

    def add(self, env: Any, pixel: Any, after_us: Any, rises: Any) -> None:
        """Events of environments and pixels, `after_us` the gap's start, ON where it `rises`."""
        self._parts.append((env, pixel, after_us, rises))

    def packed(self, num_envs: int, size: tuple[int, int], start_us: int, device: Any) -> DeviceEvents:
        """All of them, by environment and time."""
        none = torch.zeros(0, dtype=torch.int64, device=device)
        parts = self._parts or [(none, none, none, none.bool())]
        env, pixel, after_us, rises = (torch.cat(column) for column in zip(*parts, strict=True))
        # Stable: what fires at one time stays in the order of pixels.
        order = torch.sort((env << 31) | after_us, stable=True).indices
        env, pixel, after_us, rises = env[order], pixel[order], after_us[order], rises[order]
        offsets = torch.zeros(num_envs + 1, dtype=torch.int64, device=device)
        offsets[1:] = torch.bincount(env, minlength=num_envs).cumsum(0)
        x, y = (pixel % size[1]).int(), (pixel // size[1]).int()
        columns = (start_us + after_us, x, y, rises.to(torch.int8))
        return DeviceEvents(columns, offsets, width=size[1], height=size[0])


def _report(
    steps: int,
    motion_px: float,
    linked: float,
    counts: list[list[int]],
    env: int,
    cut: Literal["none", "start", "declared", "detected"],
) -> KeyframeReport:
    """One environment's report, in the engine's words."""
    said = []
    if cut == "detected":
        said.append(
            f"{linked * 100:.0f} % of the picture is linked to the last keyframe: a cut that was not "
            "declared, or motion vectors of another convention, which check_motion names"
        )
    if motion_px > _WARN_GAP_PX and cut == "none":
        said.append(
            f"{motion_px:.1f} px per gap: render faster, {math.ceil(motion_px / _WARN_GAP_PX)} times as "
            f"often for {_WARN_GAP_PX:g} px"
        )
    unknown, bad_depth, bad_motion = (column[env] for column in counts)
    return KeyframeReport(
        steps=steps,
        motion_px=motion_px,
        linked=linked,
        unknown=unknown,
        bad_depth=bad_depth,
        bad_motion=bad_motion,
        strayed=0.0,
        cut=cut,
        warnings=tuple(said),
    )


def _chunks(steps: npt.NDArray[np.int64], most: int) -> list[npt.NDArray[np.int64]]:
    """Environments in groups of at most so many, those of most instants first."""
    order = np.argsort(-steps, kind="stable")
    return [order[first : first + most] for first in range(0, len(order), most)]


# Arithmetic of the engine (`evis_core::simd`), in float32.

_ROOT_HALF = 0x3F35_04F3
_LN2_HIGH, _LN2_LOW = float(np.float32(0.693_359_4)), float(np.float32(2.121_944_4e-4))
_LOG2_E = float(np.float32(math.log2(math.e)))
_MAGIC, _MAGIC_BITS = 12_582_912.0, 0x4B40_0000


def _bits(x: Any) -> Any:
    return x.contiguous().view(torch.int32)


def _inverse(n: int) -> float:
    return float(np.float32(1) / np.float32(n))


def _ln(x: Any) -> Any:
    """Natural logarithm of positive, normal float32; NaN of NaN."""
    bits = x.view(torch.int32)
    exponent = (bits - _ROOT_HALF) >> 23
    m = (bits - (exponent << 23)).view(torch.float32)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    tail = z * (_inverse(3) + z * (_inverse(5) + z * (_inverse(7) + z * _inverse(9))))
    k = exponent.float()
    found = k * _LN2_HIGH + (2.0 * s + (2.0 * s * tail - k * _LN2_LOW))
    return torch.where(torch.isnan(x), x, found)


def _exp(x: Any) -> Any:
    """e^x in float32, from -87 to 88."""
    x = x.clamp(-87.0, 88.0)
    shifted = x * _LOG2_E + _MAGIC
    k = shifted - _MAGIC
    f = (x - k * _LN2_HIGH) + k * _LN2_LOW
    series = 1.0 + f * (
        1.0 + f * (0.5 + f * (_inverse(6) + f * (_inverse(24) + f * (_inverse(120) + f * _inverse(720)))))
    )
    power = (shifted.view(torch.int32) - (_MAGIC_BITS - 127)) << 23
    return series * power.view(torch.float32)


def _exact(value: float, like: Any) -> Any:
    """Return a number as a tensor: where one divides by a number, a card multiplies by its reciprocal."""
    return like.new_full((), value)


def _hypot(x: Any, y: Any) -> Any:
    """Length in float32, rounded once."""
    return (x.double() ** 2 + y.double() ** 2).sqrt().float()


def _is_motion(motion: Any) -> Any:
    """Whether vectors (..., 2) move a pixel."""
    return (motion.abs() < _MOTION_LIMIT).all(-1)


def _may_be_one(a: Any, b: Any, part: float) -> Any:
    """Whether points at two nearnesses may be on one surface."""
    return torch.minimum(a, b) >= torch.maximum(a, b) * part


def _by_motion(motion: Any, variant: str) -> Any:
    """Return what stands for nearness where depth is not known: how far pixels move."""
    length = torch.where(_is_motion(motion), _hypot(motion[..., 0], motion[..., 1]), 0.0)
    return length if variant == "evis-paper" else 1.0 + _NEARNESS_PER_PX * length


def _shifted(values: Any, canvas: tuple[int, int], down: int, right: int, beyond: float) -> Any:
    """Of pictures (M, S), what is `down` and `right` of each pixel; `beyond` outside of the picture."""
    height, width = canvas
    padded = torch.nn.functional.pad(values.unflatten(1, canvas), (1, 1, 1, 1), value=beyond)
    return padded[:, 1 + down : 1 + down + height, 1 + right : 1 + right + width].flatten(1)


def _nearest_around(nearness: Any, canvas: tuple[int, int]) -> Any:
    """Of pictures (N, S), the number of the nearest pixel among the nine around each, int64 (N, S).

    Itself where none is nearer; of several that are, the first.
    """
    best = nearness
    way = torch.zeros_like(nearness, dtype=torch.int64)
    for down, right in _AROUND:
        there = _shifted(nearness, canvas, down, right, -1.0)
        is_nearer = there > best
        best = torch.where(is_nearer, there, best)
        way = torch.where(is_nearer, down * canvas[1] + right, way)
    return torch.arange(nearness.shape[1], device=nearness.device) + way


def _places(canvas: tuple[int, int], device: Any) -> tuple[Any, Any]:
    """Column and row of each pixel, float32 (S,)."""
    at = torch.arange(canvas[0] * canvas[1], device=device)
    return (at % canvas[1]).float(), (at // canvas[1]).float()


def _pixel_at(x: Any, y: Any, canvas: tuple[int, int]) -> tuple[Any, Any]:
    """Return the pixel nearest to a place, 0 where that is not in the picture, and whether it is."""
    x, y = (x + 0.5).floor(), (y + 0.5).floor()
    inside = (x >= 0) & (y >= 0) & (x < canvas[1]) & (y < canvas[0])
    at = torch.where(inside, y, 0.0).long() * canvas[1] + torch.where(inside, x, 0.0).long()
    return at, inside


def _found_again(before: _Keyframe, now: _Keyframe, canvas: tuple[int, int]) -> tuple[Any, Any, Any]:
    """Where each of the newer pixels was, whether it moves, and whether the older picture shows it there."""
    is_motion = _is_motion(now.back)
    x, y = _places(canvas, now.back.device)
    there, inside = _pixel_at(x + now.back[..., 0], y + now.back[..., 1], canvas)
    same = _may_be_one(before.nearness.gather(1, there), now.nearness, _SAME_OVER_TIME)
    return there, is_motion, is_motion & inside & same


def _links(before: _Keyframe, now: _Keyframe, canvas: tuple[int, int]) -> Any:
    """How far all but a thousandth of the pixels moved at most, and which part was found again: (2, N)."""
    _, is_motion, found = _found_again(before, now, canvas)
    length = _hypot(now.back[..., 0], now.back[..., 1])
    length = torch.where(is_motion, length, math.inf).sort(1).values
    count = is_motion.sum(1)
    rank = (count.double() * (1.0 - _FASTEST_SHARE)).long().minimum((count - 1).clamp(min=0))
    motion_px = torch.where(count > 0, length.gather(1, rank[:, None])[:, 0], 0.0)
    linked = found.sum(1).float() / _exact(float(canvas[0] * canvas[1]), length)
    return torch.stack([motion_px, linked])


def _forward_motion(before: _Keyframe, now: _Keyframe, canvas: tuple[int, int]) -> Any:
    """Where the older keyframe's surfaces are at the newer one, (M, S, 2); NaN where that is not known.

    The newer keyframe's vectors are turned around where both show the same surface; what the newer one does
    not show goes on as before, or as its neighbours on the same surface do.
    """
    there, _, found = _found_again(before, now, canvas)
    pixels = there.shape[1]
    at = torch.arange(pixels, device=there.device)
    # The nearest of those that come from a pixel, and the first one of these.
    bits = now.nearness.view(torch.int32).long()
    word = torch.where(found, (bits << 24) | (_MOST_PIXELS - 1 - at), -1)
    best = torch.full_like(there, -1).scatter_reduce_(1, there, word, "amax")
    is_known = best >= 0
    source = torch.where(is_known, _MOST_PIXELS - 1 - (best & (_MOST_PIXELS - 1)), 0)
    turned = _refined(source, now, canvas)
    out = torch.where(is_known[..., None], turned, math.nan)
    flat, nearness = out.flatten(0, 1), before.nearness.flatten()
    unknown = torch.nonzero(~is_known.flatten())[:, 0]
    unknown = _spread(flat, unknown, nearness, canvas)
    longer = np.where(before.gap_us > 0, -(now.gap_us / np.maximum(before.gap_us, 1)), np.nan)
    longer = np.where(now.gap_us > 0, longer, np.nan).astype(np.float32)
    factor = torch.from_numpy(longer).to(out.device)[unknown // pixels]
    earlier = before.back.flatten(0, 1)[unknown]
    goes_on = (_is_motion(earlier) & ~torch.isnan(factor))[:, None]
    flat[unknown] = torch.where(goes_on, earlier * factor[:, None], math.nan)
    unknown = unknown[~goes_on[:, 0]]
    for _ in range(1, _ROUNDS):
        if not len(unknown):
            break
        unknown = _spread(flat, unknown, nearness, canvas)
    return out


def _refined(source: Any, now: _Keyframe, canvas: tuple[int, int]) -> Any:
    """Vectors (M, S, 2) from older pixels, read where they lead to, turned around.

    Between the newer picture's pixels of one surface; elsewhere the turned-around vector of `source` as it
    is.
    """
    height, width = canvas
    x, y = _places(canvas, source.device)
    first_x, first_y = (-now.back[..., axis].gather(1, source) for axis in (0, 1))
    nearness = now.nearness.gather(1, source)
    moves = _is_motion(now.back)
    motion_x, motion_y = first_x, first_y
    goes_on = torch.ones_like(source, dtype=torch.bool)
    for _ in range(3):
        px, py = x + motion_x, y + motion_y
        left, top = px.floor(), py.floor()
        inside = (left >= 0) & (top >= 0) & (left + 1.0 < width) & (top + 1.0 < height)
        # Where it leads out of the picture, the last vector stays.
        goes_on = goes_on & inside
        fx, fy = px - left, py - top
        corner = torch.where(inside, top, 0.0).long() * width + torch.where(inside, left, 0.0).long()
        sum_x, sum_y = torch.zeros_like(px), torch.zeros_like(py)
        is_one = goes_on
        for step, weight in (
            (0, (1.0 - fx) * (1.0 - fy)),
            (1, fx * (1.0 - fy)),
            (width, (1.0 - fx) * fy),
            (width + 1, fx * fy),
        ):
            other = (corner + step).clamp(max=source.shape[1] - 1)
            is_one = is_one & moves.gather(1, other)
            is_one = is_one & _may_be_one(now.nearness.gather(1, other), nearness, _SAME_SURFACE)
            sum_x = sum_x - weight * now.back[..., 0].gather(1, other)
            sum_y = sum_y - weight * now.back[..., 1].gather(1, other)
        mixed = goes_on & ~is_one
        motion_x = torch.where(is_one, sum_x, torch.where(mixed, first_x, motion_x))
        motion_y = torch.where(is_one, sum_y, torch.where(mixed, first_y, motion_y))
        goes_on = is_one
    # No motion turns around where the picture folds.
    folds = goes_on & ~(_hypot(motion_x - first_x, motion_y - first_y) < 1.0)
    return torch.stack([torch.where(folds, first_x, motion_x), torch.where(folds, first_y, motion_y)], dim=-1)


def _spread(flat: Any, unknown: Any, nearness: Any, canvas: tuple[int, int]) -> Any:
    """Give pixels `unknown` (U,) of `flat` (M S, 2) the mean motion of neighbours on their surface.

    Returns those that stay unknown.
    """
    height, width = canvas
    x, y = unknown % width, unknown // width % height
    own = nearness[unknown]
    total = torch.zeros((len(unknown), 2), dtype=torch.float32, device=flat.device)
    count = torch.zeros(len(unknown), dtype=torch.float32, device=flat.device)
    for down, right in _AROUND:
        inside = (x + right >= 0) & (x + right < width) & (y + down >= 0) & (y + down < height)
        other = torch.where(inside, unknown + down * width + right, unknown)
        motion = flat[other]
        counts = inside & ~torch.isnan(motion[:, 0]) & _may_be_one(nearness[other], own, _SAME_SURFACE)
        total = torch.where(counts[:, None], total + motion, total)
        count = count + counts
    # 0 / 0 where there is none.
    flat[unknown] = total / count[:, None]
    return unknown[count == 0]


class _Gap(ABC):
    """The gap between two keyframes of M environments: what all instants have in common."""

    def __init__(
        self,
        sides: Sequence[tuple[Any, Any, Any]],
        canvas: tuple[int, int],
        size: tuple[int, int],
        margin: int,
        log_floor: float,
    ) -> None:
        """Take older and newer side: light and nearness (M, S), and motion (M, S, 2)."""
        self._canvas, self._size, self._margin = canvas, size, margin
        self._floor = max(log_floor, float(np.float32(1e-30)))
        # Both sides at once: half the operations, which is what small batches wait for on a graphics card.
        light, nearness, motion = (torch.stack(pair) for pair in zip(*sides, strict=True))
        goes = (light >= 0) & _is_motion(motion)
        x, y = (torch.where(goes, motion[..., axis], 0.0) for axis in (0, 1))
        self._prepare(light, nearness, goes, (x, y))

    @abstractmethod
    def instant(self, elapsed: Any, count: int) -> Any:
        """Light (count, P) of the first environments at the parts `elapsed` (count,); NaN unknown."""

    @abstractmethod
    def _prepare(self, light: Any, nearness: Any, goes: Any, motion: tuple[Any, Any]) -> None:
        """Keep what instants need: all (2, M, S), older side first; what does not go somewhere moves by 0."""


class _Splat(_Gap):
    """The nearest surface wins, and its light is read from its keyframe; neither side: unknown."""

    def _prepare(self, light: Any, nearness: Any, goes: Any, motion: tuple[Any, Any]) -> None:
        self._light, self._nearness, self._goes, self._motion = light, nearness, goes, motion
        # Whether all pixels within two of a pixel show its surface, and are known.
        self._plain = _plain(light.flatten(0, 1), nearness.flatten(0, 1), self._canvas).view_as(light)
        # Whether the pixel to the left, to the right, above and below is of a pixel's surface.
        flat = nearness.flatten(0, 1)
        beside = [_shifted(flat, self._canvas, *way, -1.0) for way in ((0, -1), (0, 1), (-1, 0), (1, 0))]
        self._joined = [_may_be_one(flat, other, _SAME_SURFACE).view_as(light) for other in beside]

    def instant(self, elapsed: Any, count: int) -> Any:
        (old, new), (far, near) = self._seen(torch.stack([elapsed, 1.0 - elapsed])[..., None], count)
        # Where a side shows nothing, its nearness is -1, and the other one's is not behind it.
        is_old = torch.isnan(new) | (near < far * _SAME_SURFACE) & ~torch.isnan(old)
        is_new = torch.isnan(old) | (far < near * _SAME_SURFACE) & ~torch.isnan(new)
        pair = torch.stack([torch.where(is_new, new, old), torch.where(is_old, old, new)])
        a, b = pair
        log_a, log_b = _ln(pair + self._floor)
        light = _exp(log_a + (log_b - log_a) * elapsed[:, None]) - self._floor
        light = torch.where(light > 0, light, 0.0)
        return torch.where((a == b) | torch.isnan(a) | torch.isnan(b), b, light)

    def _seen(self, part: Any, count: int) -> tuple[Any, Any]:
        """Light (2, M, P) that each side shows when its pixels have gone `part` of their way, NaN where none.

        And how near it is there, -1 where nothing is.
        """
        (height, width), canvas_width = self._size, self._canvas[1]
        pixels = height * width
        nearness, goes = self._nearness[:, :count], self._goes[:, :count]
        at = torch.arange(nearness.shape[-1], device=nearness.device, dtype=torch.int32)
        column, row = at % canvas_width, at // canvas_width
        qx, qy = (
            ((place - self._margin) << _SUBPIXEL_BITS)
            + (motion[:, :count] * part * float(_SUBPIXELS) + 0.5).floor().int()
            for place, motion in zip((column, row), self._motion, strict=True)
        )
        left, right, above, below = (joined[:, :count] for joined in self._joined)
        columns, rows = _taps(qx, left, right, width), _taps(qy, above, below, height)
        places, weights = [], []
        for y, weight_y, is_in_rows in rows:
            for x, weight_x, is_in_columns in columns:
                is_inside = goes & is_in_rows & is_in_columns
                places.append(torch.where(is_inside, y * width + x, pixels).long())
                weights.append(weight_x * weight_y)
        shape, device = (2, count, pixels + 1), nearness.device
        depth = torch.full(shape, -1.0, dtype=torch.float32, device=device)
        for place in places:
            depth.scatter_reduce_(-1, place, nearness, "amax")
        bits = nearness.shape[-1].bit_length()
        most = (1 << (32 - bits)) - 1
        scale = float(np.float32(most) / np.float32(1 << (2 * _SUBPIXEL_BITS)))
        word = torch.zeros(shape, dtype=torch.int64, device=device)
        for place, weight in zip(places, weights, strict=True):
            is_near = nearness >= depth.gather(-1, place) * _SAME_SURFACE
            nearer = (weight.float() * scale).long().clamp(1, most)
            word.scatter_reduce_(-1, place, torch.where(is_near, (nearer << bits) | at, 0), "amax")
        depth, word = depth[..., :pixels], word[..., :pixels]
        is_seen = word > 0
        light = self._gathered(count, word & ((1 << bits) - 1), (qx, qy), is_seen)
        return torch.where(is_seen, light, math.nan), torch.where(is_seen, depth, -1.0)

    def _gathered(self, count: int, source: Any, places: tuple[Any, Any], is_seen: Any) -> Any:
        """Light (2, M, P) of sources, read between their keyframe's pixels as far away as the pixel is."""
        canvas_height, canvas_width = self._canvas
        light, nearness = self._light[:, :count], self._nearness[:, :count]
        pixel = torch.arange(source.shape[-1], device=source.device, dtype=torch.int32)
        column, row = pixel % self._size[1], pixel // self._size[1]
        dx = (column << _SUBPIXEL_BITS) - places[0].gather(-1, source)
        dy = (row << _SUBPIXEL_BITS) - places[1].gather(-1, source)
        fx, fy = ((d & (_SUBPIXELS - 1)).float() * (1.0 / _SUBPIXELS) for d in (dx, dy))
        left = source % canvas_width + (dx >> _SUBPIXEL_BITS)
        top = source // canvas_width + (dy >> _SUBPIXEL_BITS)
        # Of what is plain, all sixteen are in the picture; the rest is read otherwise.
        furthest = 3 * canvas_width + 3
        if light.shape[-1] > furthest:
            first = ((top - 1) * canvas_width + left - 1).clamp(0, light.shape[-1] - 1 - furthest)
            lines = [
                [light[..., down * canvas_width + right :].gather(-1, first) for right in range(4)]
                for down in range(4)
            ]
            found = _cubic(lines, fx, fy)
        else:
            found = torch.zeros_like(fx)
        rest = torch.nonzero(is_seen & ~self._plain[:, :count].gather(-1, source), as_tuple=True)
        side, env, _ = rest
        own, fx, fy, left, top = (values[rest] for values in (source, fx, fy, left, top))
        own_light, own_nearness = light[side, env, own], nearness[side, env, own]
        columns = [(left + right).clamp(0, canvas_width - 1) for right in (0, 1)]
        starts = [(top + down).clamp(0, canvas_height - 1) * canvas_width for down in (0, 1)]

        def beside(down: int, right: int) -> Any:
            there = (side, env, starts[down] + columns[right])
            value = light[there]
            is_one = _may_be_one(own_nearness, nearness[there], _SAME_SURFACE) & (value >= 0)
            return torch.where(is_one, value, own_light)

        found[rest] = (
            (1.0 - fx) * (1.0 - fy) * beside(0, 0)
            + fx * (1.0 - fy) * beside(0, 1)
            + (1.0 - fx) * fy * beside(1, 0)
            + fx * fy * beside(1, 1)
        )
        return found


def _plain(light: Any, nearness: Any, canvas: tuple[int, int]) -> Any:
    """Whether all pixels within two of each one of pictures (M, S) are known, and of one surface."""
    if min(canvas) <= 4:
        return torch.zeros_like(light, dtype=torch.bool)
    is_known = light >= 0
    least = torch.where(is_known, nearness, 0.0).unflatten(1, canvas)[:, None]
    most = torch.where(is_known, nearness, math.inf).unflatten(1, canvas)[:, None]
    least = -torch.nn.functional.max_pool2d(-least, 5, 1)
    most = torch.nn.functional.max_pool2d(most, 5, 1)
    inner = _may_be_one(least, most, _SAME_SURFACE)[:, 0]
    return torch.nn.functional.pad(inner, (2, 2, 2, 2)).flatten(1)


def _taps(q: Any, before: Any, after: Any, size: int) -> list[tuple[Any, Any, Any]]:
    """Along an axis of `size` pixels, the two that places `q` lie between.

    Each with its weight, and whether it is in the picture and has any. The one that a centre is not in has
    weight only where the keyframe shows the surface on that side too.
    """
    first = q >> _SUBPIXEL_BITS
    f = q & (_SUBPIXELS - 1)
    g = _SUBPIXELS - f
    is_past_half = f >= _SUBPIXELS // 2
    reaches = torch.where(is_past_half, before, after)
    g = torch.where(reaches | ~is_past_half, g, 0)
    f = torch.where(reaches | is_past_half, f, 0)
    second = first + 1
    return [
        (first, g, (g > 0) & (first >= 0) & (first < size)),
        (second, f, (f > 0) & (second >= 0) & (second < size)),
    ]


def _catmull_rom(f: Any) -> tuple[Any, Any, Any, Any]:
    f2 = f * f
    f3 = f2 * f
    return (
        0.5 * (2.0 * f2 - f - f3),
        0.5 * (2.0 - 5.0 * f2 + 3.0 * f3),
        0.5 * (f + 4.0 * f2 - 3.0 * f3),
        0.5 * (f3 - f2),
    )


def _cubic(rows: list[list[Any]], fx: Any, fy: Any) -> Any:
    """Light between the four pixels in the middle of sixteen, never beyond these four."""
    wx, wy = _catmull_rom(fx), _catmull_rom(fy)
    lines = [(wx[0] * r[0] + wx[1] * r[1]) + (wx[2] * r[2] + wx[3] * r[3]) for r in rows]
    total = (wy[0] * lines[0] + wy[1] * lines[1]) + (wy[2] * lines[2] + wy[3] * lines[3])
    a, b, c, d = rows[1][1], rows[1][2], rows[2][1], rows[2][2]
    least = torch.minimum(torch.minimum(a, b), torch.minimum(c, d))
    most = torch.maximum(torch.maximum(a, b), torch.maximum(c, d))
    return torch.minimum(torch.maximum(total, least), most)


class _Paper(_Gap):
    """Colours with softmax weights, newer keyframe first, older in its holes, black where neither."""

    def _prepare(self, light: Any, nearness: Any, goes: Any, motion: tuple[Any, Any]) -> None:
        (height, width), margin = self._size, self._margin
        seen = nearness.unflatten(2, self._canvas)
        seen = seen[:, :, margin : margin + height, margin : margin + width]
        largest = seen.amax((2, 3)).clamp(min=1e-30).double()[..., None]
        sharpness = _exact(_SHARPNESS, largest) / largest
        exponent = (nearness.double() * sharpness).clamp(max=_MOST_EXPONENT)
        # 0 where a pixel is not splatted.
        self._importance = torch.where(goes, exponent.exp(), 0.0)
        self._light, self._motion = torch.where(goes, light, 0.0).double(), motion

    def instant(self, elapsed: Any, count: int) -> Any:
        pixels = self._size[0] * self._size[1]
        # The last one is for what leaves the picture.
        sums = torch.zeros((2, count, pixels + 1), dtype=torch.float64, device=elapsed.device)
        place, weight, light = self._moved(1, (1.0 - elapsed)[:, None], count)
        sums[0].scatter_add_(1, place, weight)
        sums[1].scatter_add_(1, place, weight * light)
        is_hole = sums[0] < _HOLE_BELOW
        is_hole[:, pixels] = False
        if bool(is_hole.any()):
            place, weight, light = self._moved(0, elapsed[:, None], count)
            rest = torch.nonzero(is_hole.gather(1, place))
            env, at = rest[:, 0], rest[:, 1]
            into = env * (pixels + 1) + place[env, at]
            own_weight, own_light = weight[env, at], light[env, at]
            sums.masked_fill_(is_hole, 0.0)
            flat = sums.flatten(1)
            flat[0].index_add_(0, into, own_weight)
            flat[1].index_add_(0, into, own_weight * own_light)
        weight, light = sums[0, :, :pixels], sums[1, :, :pixels]
        return torch.where(weight >= _HOLE_BELOW, (light / weight).float(), 0.0)

    def _moved(self, side: int, part: Any, count: int) -> tuple[Any, Any, Any]:
        """Of each pixel's four taps, (M, 4 S): where they are, their weight, and the pixel's light."""
        motion_x, motion_y = (motion[side, :count] for motion in self._motion)
        importance, light = self._importance[side, :count], self._light[side, :count]
        height, width = self._size
        at = torch.arange(light.shape[1], device=part.device)
        column, row = at % self._canvas[1] - self._margin, at // self._canvas[1] - self._margin
        x, y = column + (motion_x * part).double(), row + (motion_y * part).double()
        left, top = x.floor(), y.floor()
        fx, fy = x - left, y - top
        places, weights = [], []
        for down, wy in ((0, 1.0 - fy), (1, fy)):
            for over, wx in ((0, 1.0 - fx), (1, fx)):
                tap_x, tap_y = left + over, top + down
                inside = (tap_x >= 0) & (tap_y >= 0) & (tap_x < width) & (tap_y < height)
                places.append(torch.where(inside, tap_y * width + tap_x, height * width).long())
                weights.append(wx * wy * importance)
        # Pixel by pixel, as the engine adds them up.
        place, weight = torch.stack(places, -1).flatten(1), torch.stack(weights, -1).flatten(1)
        return place, weight, light.repeat_interleave(4, 1)
