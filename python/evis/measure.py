"""What measurements give: charts, checks against truth, statistics, calibrations."""

from ._chart import Chart, ChartPoint, ChartSetting, Recommendation, SceneChart
from ._stats import Calibration, Comparison, Estimate, FlickerEstimate, Statistics, static_scene
from ._truth import Truth, load_truth
from ._verify import (
    Convergence,
    ErrorFit,
    FailureCell,
    FailureVerification,
    FormCheck,
    LightError,
    LightPixel,
    LightVerification,
    SceneVerification,
    Verification,
    verify_failures,
    verify_light,
    verify_scene,
)

__all__ = [
    "Calibration",
    "Chart",
    "ChartPoint",
    "ChartSetting",
    "Comparison",
    "Convergence",
    "ErrorFit",
    "Estimate",
    "FailureCell",
    "FailureVerification",
    "FlickerEstimate",
    "FormCheck",
    "LightError",
    "LightPixel",
    "LightVerification",
    "Recommendation",
    "SceneChart",
    "SceneVerification",
    "Statistics",
    "Truth",
    "Verification",
    "load_truth",
    "static_scene",
    "verify_failures",
    "verify_light",
    "verify_scene",
]
