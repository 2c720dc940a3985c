"""Logs as text: the one writer of all tests."""

import numpy as np


def written(path, header, *columns, mark=",", form="{!r}"):
    """Write columns, (n,) or (n, k), below a header that may be empty; all digits."""
    rows = np.column_stack(columns).tolist()
    lines = [mark.join(form.format(x) for x in row) for row in rows]
    path.write_text("\n".join([*([header] if header else []), *lines, ""]))
    return path


FILE = """
T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
K = [1.02, 0.97, 1.01]
B = [0.3, 0, -1]
noise_std_raw = 0.01

[gyroscope]
T = [[1, 0.01, 0], [0, 1, 0.02], [-0.01, 0, 1]]
K = [2e-3, 2.1e-3, 1.9e-3]
B = [12, -30, 5]
G = [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]
white_raw_per_sqrt_hz = 0.8
flicker_raw = 0.2
bias_walk_raw_per_sqrt_s = 0.05
range_rad_s = 35
delay_s = 0.001

[magnetometer]
T = [[1, 0, 0], [0.02, 1, 0], [0.01, -0.03, 1]]
K = [1.5e-7, 1.5e-7, 1.6e-7]
B = [120, -40, 60]
noise_std_raw = 3.0
quantum_raw = 1

[clock]
jitter_s = 1e-5
"""
"""A file of all sensors of an IMU."""
