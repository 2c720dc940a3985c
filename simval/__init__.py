"""A validation harness for inertial calibration and attitude estimation."""
