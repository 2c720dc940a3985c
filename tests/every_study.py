"""A small suite of the studies that have a section of their own in the report."""

SUITE = """
title = "Each study once"
[ladder]
residual = ["squared", "norm"]
noise_std = [0.2, 0.4]
poses = 20
trials = 1024
[coverage]
sigma = ["known", "type A"]
poses = [12, 20]
trials = 1024
[magnetometer]
trials = 1024
[gyroscope]
poses = 14
trials = 256
[attitude_order]
geometry = 3
[attitude_efficiency]
geometries = 100
trials = 10
[attitude_limits]
norm = [0.3, 0.6]
samples = 4096
[attitude_geometries]
noise = ["isotropic", "full"]
geometries = 20
[attitude_map]
geometries = 5
[attitude_vectors]
vectors = [2, 3]
ratio = [1.0, 100.0]
samples = 4096
[detector]
trials = 2
[filter]
rate = 25.0
seconds = 4.0
trials = 8
[end_to_end]
poses = 12
attitudes = 4
trials = 4
"""
