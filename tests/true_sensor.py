"""The sensor that most tests try to find again."""

import numpy as np

from simval.imu.sensor import AccelerometerModel

G = 9.81
PARAMETERS = np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
MODEL = AccelerometerModel.from_parameters(PARAMETERS)
