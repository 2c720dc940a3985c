"""A calibrator as a program: a file of poses in, JSON out. Any language will do."""

import json
import sys

import numpy as np

poses, g = np.loadtxt(sys.argv[1], delimiter=","), float(sys.argv[2])
x, y, z = poses.T
D = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, x, y, z], axis=1)
a, b, c, d, e, f, *v = np.linalg.lstsq(D, np.ones(len(D)), rcond=None)[0]
A = np.array([[a, d, e], [d, b, f], [e, f, c]])
bias = -np.linalg.solve(A, v) / 2
matrix = np.linalg.cholesky(A / (1 + bias @ A @ bias)).T * g
json.dump({"matrix": matrix.tolist(), "B": bias.tolist()}, sys.stdout)
