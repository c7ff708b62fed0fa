"""What a run is asked for, as the engine takes it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TypedDict

from ._dense import DenseRequest


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What `Simulator` asks of the engine: None and empty where nothing was said.

    The engine puts it over a settings file or the defaults, and refuses what does not fit. Sensors and a warp
    are JSON; everything else is as `Simulator` takes it, with times in microseconds.
    """

    settings: str | None = None
    sensor: str | None = None
    sensors: dict[str, str] = field(default_factory=dict)
    quality: str | None = None
    method: str | None = None
    warp: str | None = None
    rate_hz: float | None = None
    adaptive_px: float | None = None
    samples: int | None = None
    antialias: str | None = None
    texture_taps: int | None = None
    shadows: str | None = None
    compute: str | None = None
    shadow_map: int | None = None
    audit: float | None = None
    cameras: list[str] = field(default_factory=list)
    size: tuple[int, int] | None = None
    start_us: int | None = None
    seed: int | None = None
    labels: list[str] = field(default_factory=list)
    label_rate_hz: float | None = None
    frame_rate_hz: float | None = None
    exposure_us: int | None = None
    camera_motion: str | None = None
    camera_speed: float | None = None
    reference_luminance: float | None = None
    poses: list[str] = field(default_factory=list)
    materials: list[str] = field(default_factory=list)
    lights: list[str] = field(default_factory=list)
    pose_step_us: int | None = None
    dense: DenseRequest | None = None


class TruthRequest(TypedDict):
    """What settings are measured on beside truth; times in microseconds, thresholds and eps of the sensor."""

    sensor: tuple[float, float, float]
    camera: str | None
    size: tuple[int, int] | None
    start_us: int
    duration_us: int
    truth_pixels: int | None
    cache: Path | None
    device: str | None


class ChartRequest(TypedDict):
    """What a chart measures; None where nothing was said."""

    quick: bool
    rates_hz: list[float] | None
    samples: list[int] | None
    edges: bool | None
    latch_rates_hz: list[float] | None
    published: bool
    splat: bool
    adaptive: bool
    repetitions: int
    reference_luminance: float | None
    floor: bool


class LightRequest(TypedDict):
    """What light is compared at."""

    at_us: int
    samples: int
    shadows: str
    camera: str | None
    size: tuple[int, int] | None
    worst: int
    device: str | None
