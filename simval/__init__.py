"""A validation harness for inertial calibration and attitude estimation.

How wrong are my calibration and my attitude estimate, does theory say that they
must be that wrong, and did today's change make them worse?

Conventions:

- SI units and radians everywhere; raw readings in whatever unit the sensor has.
- A quaternion has unit length, the vector part first and the scalar last, and takes
  the reference frame to the body frame; ``q`` and ``-q`` are the same attitude.
- ``f_s`` is a vector in sensor coordinates, and ``R_ws`` takes sensor to world, so that
  in a product the inner letters match. Frames: ``w`` world, ``b`` body, ``s`` sensor.
- An accelerometer measures specific force: at rest it reads g upwards.
- Attitude errors are truth minus estimate, calibration errors estimate minus truth.
- Arrays are batches on their leading axes: ``(..., 3)``.

Where to look: `imu` is the library under test (sensors, calibration, attitude, filters
and logs) and imports nothing of what tests it. `studies` has the experiments; read it
first. `scene` moves the body, `theory` predicts the results, `verdict` judges them,
`sweep` runs grids of studies, `judge` compares runs and `report` shows them.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simval.imu.attitude import two_vector_quaternion
    from simval.imu.calibrate import calibrate
    from simval.imu.sensor import AccelerometerModel
    from simval.sweep import load_run, run_suite

__version__: str
"""Version of the installed distribution."""

__all__ = [
    "AccelerometerModel",
    "__version__",
    "calibrate",
    "load_run",
    "run_suite",
    "two_vector_quaternion",
]

_HOMES = {
    "AccelerometerModel": "simval.imu.sensor",
    "calibrate": "simval.imu.calibrate",
    "load_run": "simval.sweep",
    "run_suite": "simval.sweep",
    "two_vector_quaternion": "simval.imu.attitude",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that `simval --help` is quick."""
    import importlib

    if name == "__version__":
        from importlib import metadata

        return metadata.version("simval")
    if name not in _HOMES:
        msg = f"module 'simval' has no attribute {name!r}"
        raise AttributeError(msg)
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return [*__all__]
