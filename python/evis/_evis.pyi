from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from typing import Any, final

import numpy as np
import numpy.typing as npt

from ._poses import Factors, LightValues, NodePoses
from ._request import Request
from .flow import Upsampler

__all__ = [
    "MOST_T_US",
    "ConfigError",
    "DeviceError",
    "EventEmulator",
    "EventFileReader",
    "EventFileWriter",
    "EvisError",
    "FormatError",
    "FrameReader",
    "Label",
    "Packet",
    "Recording",
    "Scene",
    "Simulator",
    "Stream",
    "Truth",
    "View",
    "Writer",
    "__version__",
    "_probe",
    "averaged_timestamps",
    "bina_rep",
    "binary_stack",
    "body_times",
    "builtin_scenes",
    "calibrate_flicker",
    "calibrate_still",
    "chart",
    "chart_cache",
    "chart_ladder",
    "check_chart",
    "check_motion",
    "compare_table",
    "convert_video",
    "counts",
    "draw_chart",
    "draw_compare",
    "draw_verify",
    "endpoint_error",
    "event_dtype",
    "event_frame",
    "event_spike_tensor",
    "file_formats",
    "format_of_ending",
    "label_kinds",
    "lens_project",
    "lens_unproject",
    "limits",
    "list_devices",
    "load_rig",
    "mse",
    "parse_rig",
    "psnr",
    "read_events",
    "recognise_format",
    "recommend_chart",
    "rig_text",
    "run_cli",
    "scene_bodies",
    "scene_sensors",
    "score",
    "score_table",
    "sensor_check",
    "sensor_from_toml",
    "sensor_of_settings",
    "sensor_photoreceptor_noise",
    "sensor_preset",
    "sensor_presets",
    "sensor_sample",
    "sensor_to_toml",
    "simulate_imu",
    "srgb_table",
    "ssim",
    "static_scene",
    "statistics",
    "time_surfaces",
    "verify",
    "verify_failures",
    "verify_light",
    "verify_scene",
    "verify_table",
    "voxel_grid",
    "voxel_l1",
]

__version__: str
MOST_T_US: int

class EvisError(Exception): ...
class ConfigError(EvisError, ValueError): ...
class FormatError(EvisError, ValueError): ...
class DeviceError(EvisError, RuntimeError): ...

def event_dtype() -> np.dtype[np.void]: ...
def read_events(path: str | PathLike[str]) -> tuple[npt.NDArray[np.void], int, int]: ...
def label_kinds() -> list[tuple[str, str, int]]: ...
def builtin_scenes() -> list[tuple[str, str]]: ...
def srgb_table() -> list[float]: ...
def list_devices() -> list[dict[str, Any]]: ...
def convert_video(
    source: dict[str, Any],
    output: str | PathLike[str],
    *,
    sensor: str,
    seed: int,
    reference_luminance: float,
    upsampler: Upsampler | None,
    overwrite: bool,
    progress: Callable[[int, int, int], object] | None,
) -> str: ...

@final
class FrameReader:
    def __new__(cls, source: dict[str, Any]) -> FrameReader: ...
    def next(self) -> tuple[int, npt.NDArray[Any], int, int, int] | None: ...
    def about(self) -> tuple[str, str, int, list[str]]: ...

def statistics(events: npt.NDArray[np.void], size: tuple[int, int], range_us: tuple[int, int]) -> str: ...
def calibrate_still(
    events: npt.NDArray[np.void],
    size: tuple[int, int],
    range_us: tuple[int, int],
    base: str,
    seed: int,
) -> tuple[str, str, str]: ...
def calibrate_flicker(
    recordings: list[tuple[npt.NDArray[np.void], tuple[int, int], tuple[float, float]]], base: str
) -> tuple[str, str, str]: ...
def compare_table(json: str) -> str: ...
def draw_compare(json: str, path: str | PathLike[str]) -> None: ...
def static_scene(
    sensor: str, size: tuple[int, int], duration_us: int, light: float | None, seed: int
) -> npt.NDArray[np.void]: ...

_Source = tuple[npt.NDArray[np.void], tuple[int, int], tuple[int | None, int | None], bool]

def event_frame(source: _Source) -> npt.NDArray[np.int32]: ...
def counts(source: _Source) -> npt.NDArray[np.int32]: ...
def voxel_grid(source: _Source, bins: int, polarity: str, normalize: bool) -> npt.NDArray[np.float32]: ...
def event_spike_tensor(source: _Source, bins: int, measure: str) -> npt.NDArray[np.float32]: ...
def time_surfaces(
    source: _Source, at_us: list[int], tau_us: float, decay: str
) -> npt.NDArray[np.float32]: ...
def averaged_timestamps(source: _Source, empty: float) -> npt.NDArray[np.float32]: ...
def binary_stack(source: _Source, bins: int) -> npt.NDArray[np.uint8]: ...
def bina_rep(source: _Source, frames: int, bits: int) -> npt.NDArray[np.float32]: ...
def limits(memory: int | None = None, allow_outside: bool | None = None) -> tuple[int, bool]: ...
def run_cli(args: list[str]) -> int: ...
def chart(
    scene: Scene,
    *,
    rates_hz: list[float],
    samples: list[int],
    edges: bool,
    latch_rates_hz: list[float],
    most_samples_hz: float | None,
    published: bool,
    splat: bool,
    adaptive: bool,
    quick: bool,
    repetitions: int,
    threshold_on: float,
    threshold_off: float,
    log_eps: float,
    camera: str | None,
    size: tuple[int, int] | None,
    start_us: int,
    duration_us: int,
    truth_pixels: int | None,
    reference_luminance: float | None,
    floor: bool,
    cache: str | PathLike[str] | None,
    device: str | None,
) -> str: ...
def chart_cache() -> Path | None: ...
def chart_ladder(
    quick: bool,
) -> tuple[list[float], list[int], bool, list[float], float | None]: ...
def check_chart(json: str) -> None: ...
def draw_chart(json: str, path: str | PathLike[str], tolerance_us: int, render_ms: float) -> None: ...
def recommend_chart(
    json: str,
    index: int,
    budget_ms: float | None,
    target_f1: float | None,
    tolerance_us: int,
    render_ms: float,
) -> str: ...
def verify() -> str: ...
def verify_scene(
    scene: Scene,
    *,
    rates_hz: list[float],
    samples: list[int],
    triggers: list[str],
    threshold_on: float,
    threshold_off: float,
    log_eps: float,
    camera: str | None,
    size: tuple[int, int] | None,
    start_us: int,
    duration_us: int,
    truth_pixels: int | None,
    cache: Path | None,
    device: str | None,
) -> str: ...
def verify_failures(
    *,
    methods: list[str] | None,
    failures: list[str] | None,
    cache: Path | None,
    device: str | None,
) -> str: ...
def verify_light(
    scene: Scene,
    *,
    at_us: int,
    samples: int,
    shadows: str,
    camera: str | None,
    size: tuple[int, int] | None,
    worst: int,
    device: str | None,
) -> str: ...
def verify_table(json: str) -> str: ...
def draw_verify(json: str, path: str | PathLike[str]) -> None: ...
def score(
    events: npt.NDArray[np.void],
    truth: Truth,
    tolerances_us: list[int],
    sensor: tuple[float, float, float] | None,
    size: tuple[int, int] | None,
) -> str: ...
def score_table(json: str) -> str: ...
def lens_project(
    intrinsics: tuple[float, float, float, float],
    distortion: tuple[str, list[float]] | None,
    points: npt.NDArray[np.float64],
) -> npt.NDArray[np.float64]: ...
def lens_unproject(
    intrinsics: tuple[float, float, float, float],
    distortion: tuple[str, list[float]] | None,
    pixels: npt.NDArray[np.float64],
) -> npt.NDArray[np.float64]: ...
def load_rig(path: str | PathLike[str]) -> str: ...
def parse_rig(text: str) -> str: ...
def rig_text(json: str, format: str) -> str: ...
def scene_bodies(
    scene: Scene, cameras: list[str], environment: int, start_us: int, t_us: list[int]
) -> tuple[Any, ...]: ...
def body_times(rate_hz: float, after_us: int, until_us: int) -> list[int]: ...
def simulate_imu(
    scene: Scene,
    node: str,
    environment: int,
    rate_hz: float,
    noise: tuple[float, float, float, float],
    gravity: tuple[float, float, float],
    seed: int,
    start_us: int,
    duration_us: int,
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]: ...
def sensor_of_settings(config_toml: str, camera: str) -> tuple[float, float, float]: ...
def voxel_l1(events: npt.NDArray[np.void], truth: Truth) -> float | None: ...
def ssim(
    picture: npt.NDArray[np.float32], reference: npt.NDArray[np.float32], data_range: float
) -> float: ...
def mse(picture: npt.NDArray[np.float32], reference: npt.NDArray[np.float32]) -> float: ...
def psnr(
    picture: npt.NDArray[np.float32], reference: npt.NDArray[np.float32], data_range: float
) -> float: ...
def endpoint_error(
    flow: npt.NDArray[np.float32], reference: npt.NDArray[np.float32], mask: npt.NDArray[np.bool_] | None
) -> dict[str, Any]: ...
def _probe(kind: str) -> Any: ...

@final
class Scene:
    @staticmethod
    def builtin(name: str, seed: int) -> Scene: ...
    @staticmethod
    def load(path: str | PathLike[str], animation: str | None = None) -> Scene: ...
    @staticmethod
    def from_toml(
        text: str, base: str | PathLike[str], pictures: list[tuple[str, npt.NDArray[np.float32]]]
    ) -> Scene: ...
    def with_cameras(self, text: str, parents: list[str | None]) -> Scene: ...
    def at_speed(self, speed: float) -> Scene: ...
    def with_camera_motion(
        self, motion: str | None, speed: float | None, camera: str | None, size: tuple[int, int] | None
    ) -> Scene: ...
    @property
    def camera_motion(self) -> tuple[str, float | None, bool, str] | None: ...
    def rests(self, cameras: list[str]) -> bool: ...
    @property
    def name(self) -> str: ...
    @property
    def cameras(self) -> list[str]: ...
    @property
    def nodes(self) -> list[str]: ...
    @property
    def environments(self) -> int: ...
    @property
    def duration_s(self) -> float | None: ...
    @property
    def warnings(self) -> list[str]: ...

@final
class Label:
    @property
    def kind(self) -> str: ...
    @property
    def t_us(self) -> int: ...
    @property
    def t_other_us(self) -> int: ...
    @property
    def data(self) -> npt.NDArray[Any]: ...

@final
class View:
    @property
    def environment(self) -> int: ...
    @property
    def camera(self) -> int: ...
    @property
    def events(self) -> npt.NDArray[np.void]: ...
    @property
    def causes(self) -> npt.NDArray[np.uint8]: ...
    @property
    def labels(self) -> list[Label]: ...
    @property
    def dense(self) -> list[tuple[int, int, npt.NDArray[Any]]] | None: ...
    @property
    def poses(
        self,
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]: ...

@final
class Packet:
    @property
    def start_us(self) -> int: ...
    @property
    def end_us(self) -> int: ...
    @property
    def views(self) -> list[View]: ...
    @property
    def report(self) -> dict[str, Any]: ...

@final
class Simulator:
    def __new__(cls, scene: Scene, request: Request, device: str | None) -> Simulator: ...
    @property
    def scene(self) -> Scene: ...
    @property
    def cameras(self) -> list[dict[str, Any]]: ...
    def cameras_of(self, environment: int) -> list[dict[str, Any]]: ...
    @property
    def environments(self) -> int: ...
    @property
    def device(self) -> dict[str, Any]: ...
    @property
    def sensors(self) -> list[str]: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def warnings(self) -> list[str]: ...
    @property
    def quality(self) -> str | None: ...
    @property
    def method(self) -> str: ...
    @property
    def seed(self) -> int: ...
    @property
    def start_us(self) -> int: ...
    @property
    def reference_luminance(self) -> float | None: ...
    @property
    def labels(self) -> list[str]: ...
    @property
    def config_toml(self) -> str: ...
    @property
    def now_us(self) -> int: ...
    def step(
        self,
        until_us: int,
        poses: list[NodePoses] | None,
        visible: list[tuple[int, int, list[tuple[int, bool]]]],
        materials: list[tuple[int, int, Factors]],
        lights: list[tuple[int, int, LightValues]],
    ) -> Packet: ...
    def reset(
        self,
        environments: list[int],
        seeds: list[int],
        sensors: list[tuple[int, int, str]],
        lenses: list[tuple[int, int, list[float]]],
        poses: list[tuple[int, int, list[float]]],
        visible: list[tuple[int, int, bool]],
        materials: list[tuple[int, int, Factors]],
        lights: list[tuple[int, int, LightValues]],
    ) -> None: ...
    def stream(self, duration_us: int, packet_us: int) -> Stream: ...

@final
class Stream:
    def __iter__(self) -> Iterator[Packet]: ...
    def __next__(self) -> Packet: ...
    def close(self) -> None: ...

@final
class Writer:
    def __new__(
        cls,
        path: str | PathLike[str],
        *,
        cameras: list[dict[str, Any]],
        seed: int,
        method: str,
        environment: int,
        config_toml: str,
        duration_us: int | None,
        t_offset_us: int,
        labels: list[str],
        overwrite: bool,
        imus: list[str] = ...,
        bodies: list[tuple[str, int, int, str, list[list[float]]]] = ...,
    ) -> Writer: ...
    def write_events(
        self, camera: int, events: npt.NDArray[np.void], causes: npt.NDArray[np.uint8] | None = None
    ) -> None: ...
    def write_label(
        self, camera: int, kind: str, t_us: int, t_other_us: int, data: npt.NDArray[Any]
    ) -> None: ...
    def write_poses(
        self,
        camera: int,
        t_us: npt.NDArray[np.int64],
        position: npt.NDArray[np.float64],
        rotation: npt.NDArray[np.float64],
    ) -> None: ...
    def write_imu(
        self,
        index: int,
        t_us: npt.NDArray[np.int64],
        accelerometer: npt.NDArray[np.float64],
        gyroscope: npt.NDArray[np.float64],
    ) -> None: ...
    def write_bodies(
        self,
        t_us: npt.NDArray[np.int64],
        position: npt.NDArray[np.float64],
        rotation: npt.NDArray[np.float64],
        linear_velocity: npt.NDArray[np.float64],
        angular_velocity: npt.NDArray[np.float64],
    ) -> None: ...
    def finish(self, report_json: str) -> None: ...
    def abandon(self) -> None: ...

@final
class Recording:
    def bodies(self) -> tuple[Any, ...]: ...
    def __new__(cls, path: str | PathLike[str]) -> Recording: ...
    @property
    def cameras(self) -> list[dict[str, Any]]: ...
    @property
    def labels(self) -> list[str]: ...
    @property
    def seed(self) -> int: ...
    @property
    def method(self) -> str: ...
    @property
    def environment(self) -> int: ...
    @property
    def config_toml(self) -> str: ...
    @property
    def t_offset_us(self) -> int: ...
    def is_complete(self) -> bool: ...
    def report_json(self) -> str | None: ...
    def event_count(self, camera: int) -> int: ...
    def events(self, camera: int, limits: tuple[int, int] | None) -> npt.NDArray[np.void]: ...
    def causes(self, camera: int, limits: tuple[int, int] | None) -> npt.NDArray[np.uint8] | None: ...
    def label_times(self, camera: int, kind: str) -> npt.NDArray[np.int64]: ...
    def label(self, camera: int, kind: str, index: int) -> Label: ...
    def imus(self) -> list[str]: ...
    def imu(
        self, name: str
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]: ...
    def poses(
        self, camera: int
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64], npt.NDArray[np.float64]]: ...

def recognise_format(path: str | PathLike[str]) -> str | None: ...
def format_of_ending(path: str | PathLike[str]) -> str | None: ...
def file_formats() -> list[tuple[str, str]]: ...

@final
class EventFileReader:
    def __new__(
        cls, path: str | PathLike[str], *, camera: str | None = None, size: tuple[int, int] | None = None
    ) -> EventFileReader: ...
    @property
    def format(self) -> str: ...
    @property
    def size(self) -> tuple[int, int] | None: ...
    @property
    def cameras(self) -> list[str]: ...
    @property
    def camera(self) -> str | None: ...
    @property
    def t_offset_us(self) -> int: ...
    @property
    def properties(self) -> list[tuple[str, str]]: ...
    def read(
        self,
    ) -> (
        tuple[
            npt.NDArray[np.void],
            bytes,
            list[tuple[int, int, int, int, int, bytes]],
            list[tuple[int, list[float]]],
        ]
        | None
    ): ...
    def read_events(self) -> npt.NDArray[np.void]: ...
    def seek(self, t_us: int) -> None: ...

@final
class EventFileWriter:
    def __new__(
        cls, path: str | PathLike[str], *, format: str, size: tuple[int, int], overwrite: bool
    ) -> EventFileWriter: ...
    def write(self, events: npt.NDArray[np.void], triggers: list[tuple[int, int, bool]] = ...) -> None: ...
    def finish(self) -> None: ...
    def abandon(self) -> None: ...

@final
class Truth:
    def __new__(
        cls,
        *,
        camera: dict[str, Any],
        sensor: tuple[float, float, float],
        reference_luminance: float,
        duration_us: int,
        events: npt.NDArray[np.void],
        pixels: npt.NDArray[np.uint16] | None,
        speed: npt.NDArray[np.float32] | None,
        event_region: npt.NDArray[np.uint8] | None,
        span_start: npt.NDArray[np.uint32] | None,
        span_t_us: npt.NDArray[np.int64] | None,
        span_region: npt.NDArray[np.uint8] | None,
        provenance: str,
    ) -> Truth: ...
    @staticmethod
    def load(path: str | PathLike[str], camera: str | None) -> Truth: ...
    def save(self, path: str | PathLike[str], overwrite: bool) -> None: ...
    @property
    def camera(self) -> dict[str, Any]: ...
    @property
    def sensor(self) -> tuple[float, float, float]: ...
    @property
    def reference_luminance(self) -> float: ...
    @property
    def duration_us(self) -> int: ...
    @property
    def sampled_hz(self) -> float | None: ...
    @property
    def provenance(self) -> str: ...
    def events(self) -> npt.NDArray[np.void]: ...
    def pixels(self) -> npt.NDArray[np.uint16]: ...
    def speed(self) -> npt.NDArray[np.float32]: ...
    def event_region(self) -> npt.NDArray[np.uint8]: ...
    def span_start(self) -> npt.NDArray[np.uint32]: ...
    def span_t_us(self) -> npt.NDArray[np.int64]: ...
    def span_region(self) -> npt.NDArray[np.uint8]: ...

def sensor_presets() -> list[tuple[str, str]]: ...
def sensor_preset(name: str) -> str: ...
def scene_sensors(scene: Scene, names: list[str]) -> dict[str, str]: ...
def sensor_check(json: str) -> tuple[list[str], bool]: ...
def sensor_photoreceptor_noise(json: str, rate_hz: float, v2e: bool) -> float: ...
def sensor_to_toml(json: str) -> str: ...
def sensor_from_toml(text: str) -> str: ...
def sensor_sample(json: str, ranges: str, seed: int) -> str: ...
def check_motion(
    older: npt.NDArray[Any],
    newer: npt.NDArray[Any],
    motion: npt.NDArray[np.float32],
    *,
    size: tuple[int, int],
    channels: tuple[int, int],
    transfer: tuple[str, str],
    gamma: float,
) -> dict[str, Any]: ...

@final
class EventEmulator:
    def __new__(
        cls,
        *,
        width: int,
        height: int,
        batch: int,
        seed: int,
        camera: int,
        sensor: str,
        reference_luminance: float,
        threads: int,
        causes: bool,
    ) -> EventEmulator: ...
    def push(
        self, frames: npt.NDArray[Any], t_us: int, *, channels: int, transfer: str, gamma: float
    ) -> list[npt.NDArray[np.void]]: ...
    def push_keyframe(
        self,
        light: npt.NDArray[Any],
        depth: npt.NDArray[np.float32],
        motion: npt.NDArray[np.float32] | None,
        t_us: int,
        *,
        motion_steps: npt.NDArray[np.float32] | None,
        motion_forward: npt.NDArray[np.float32] | None,
        cut: list[bool],
        channels: int,
        transfer: str,
        gamma: float,
        warp: str,
    ) -> list[npt.NDArray[np.void]]: ...
    def causes(self) -> list[npt.NDArray[np.uint8]]: ...
    def keyframe_reports(self) -> list[dict[str, Any]]: ...
    def reset(self, environments: list[int] | None) -> None: ...
    def reports(self) -> tuple[dict[str, int], dict[str, int]]: ...
    def now_us(self) -> int | None: ...
    def state(self) -> bytes: ...
    def restore(self, state: bytes) -> None: ...
