"""Names and defaults for help texts and shell completion.

They stand here because a help must be quick: this module imports nothing but the
standard library. The code below takes its own names from here, or a test compares them
(`tests/cli/test_help.py`).
"""

from pathlib import Path
from typing import Final, Literal, get_args

ALPHA: Final = 1e-3
"""False-alarm rate of all checks together: see `simval.verdict`."""
BASELINE: Final = Path("reports") / "baseline.json"
"""Where the gate finds the stored statistics."""
RUNS: Final = Path("reports") / "runs"
"""Where a sweep puts the folder of a run."""
FILTER_SECONDS: Final = 600.0
"""Time limit of a filter: a millisecond a row of ten minutes at 500 Hz, twice."""

Model = Literal["triangular", "upper", "symmetric"]
Method = Literal["lm", "gauss-newton", "newton"]
Iteration = Literal["centre", "source"]
Residual = Literal["squared", "norm", "weighted", "sampson", "adjusted"]
Loss = Literal["linear", "huber", "soft_l1", "cauchy"]
MODELS: Final = get_args(Model)
METHODS: Final = get_args(Method)
ITERATIONS: Final = get_args(Iteration)
RESIDUALS: Final = get_args(Residual)
LOSSES: Final = get_args(Loss)
"""Forms of the nine parameters, solvers, their unknowns, residuals, robust losses."""
Target = Literal["px4", "ardupilot", "kalibr", "openvins", "ros"]
TARGETS: Final = get_args(Target)
"""Projects for which a calibration is written as parameters."""
TruthWorld = Literal["NED", "ENU", "NWU", "estimated"]
"""Worlds that a recorded truth may have."""
PoseTurns = Literal["body-to-world", "world-to-body"]
"""What a recorded quaternion turns, in SciPy's sense of a rotation."""
RowKind = Literal["before", "instant", "after"]
ROW_KINDS: Final[tuple[RowKind, ...]] = get_args(RowKind)
GyroRows = Literal["found", "before", "instant", "after"]
"""What a row of a gyroscope is of, and whether the log is asked."""

STUDIES: Final = (
    "sampling",
    "scene",
    "calibration",
    "ladder",
    "coverage",
    "thermal",
    "gyroscope",
    "solvers",
    "magnetometer",
    "attitude",
    "attitude_order",
    "attitude_efficiency",
    "attitude_limits",
    "attitude_singular",
    "attitude_vectors",
    "attitude_geometries",
    "attitude_map",
    "noise_model",
    "detector",
    "end_to_end",
    "whole_log",
    "diagnosis",
    "audit",
    "estimator",
    "calibrator",
    "filter",
    "told",
    "custom_scene",
)
"""Studies, in the order of the page."""
SCENES: Final = ("gimbal", "die", "shaker", "pivot", "handheld", "cube", "freefall")
"""Scenes that come with the package, the default first."""


def builtin_suites() -> tuple[str, ...]:
    """Names of the suites that come with the package."""
    folder = Path(__file__).parent / "sweep" / "suites"
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))
