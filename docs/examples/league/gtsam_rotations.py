"""GTSAM: the rotation closest to a matrix, and a graph of `WahbaFactor`s.

`ClosestTo` is given the attitude profile matrix, the weighted sum of b rᵀ. The graph is
solved by Levenberg and Marquardt from there; its covariance is the marginal one, of a
right-hand error, which is on the side of the references.
"""

import numpy as np
from adapting import needed

from simval.plugins import Estimator

with needed():
    import gtsam


def _profile(body, references, weights):
    return np.einsum("k,ki,kj->ij", weights, body, references)


def _closest(body, references, weights):
    return gtsam.Rot3.ClosestTo(_profile(body, references, weights)).matrix()


def _graph(body, references, noise_std):
    graph = gtsam.NonlinearFactorGraph()
    sizes = np.sqrt(np.sum(noise_std**2, axis=0))
    for b, r, size in zip(body, references, sizes, strict=True):
        model = gtsam.noiseModel.Isotropic.Sigma(3, size)
        graph.add(gtsam.WahbaFactor(0, gtsam.Unit3(r), gtsam.Unit3(b), model))
    values = gtsam.Values()
    start = _profile(body, references, sizes**-2.0)
    values.insert(0, gtsam.Rot3.ClosestTo(start))
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values)
    return graph, optimizer.optimize()


def _wahba(body, references, noise_std):
    return _graph(body, references, noise_std)[1].atRot3(0).matrix()


def _marginal(body, references, noise_std):
    return gtsam.Marginals(*_graph(body, references, noise_std)).marginalCovariance(0)


ROWS = {"components": "matrix", "matrix": "active", "takes": "vectors", "batch": False}

closest_to = Estimator(
    name="ClosestTo",
    estimate=_closest,
    kind="weighted wahba",
    reads=("weights",),
    **ROWS,
)
wahba_factor = Estimator(
    name="WahbaFactor",
    estimate=_wahba,
    covariance=_marginal,
    side="reference",
    kind="weighted wahba",
    reads=("noise_std",),
    **ROWS,
)
