r"""Second- and fourth-order theory of a plug-in that works with power series.

The plug-in itself is evaluated on truncated power series in the noise
(`simval.theory.series`). With :math:`R = R(\delta q)` of the error and :math:`w` the
vector of :math:`(R - R^T)/2`, whose length is the sine of the angle, the rotation
vector is to fourth order

.. math:: \theta = w\,(1 + |w|^2 / 6).

Order 2 leaves out what order 4 adds and what order 4 leaves out; that is at most twice
what cubature differs from it by.
"""

import traceback
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import PluginError
from simval.geometry import attitude_matrix
from simval.moments import Moments
from simval.plugins import Estimator, calling
from simval.plugins.noise import VectorNoise
from simval.plugins.remote import RemoteEstimator
from simval.plugins.rotations import tail
from simval.results import Row, plain
from simval.statistics import BIAS, COVARIANCE, ORDER_2, ORDER_4
from simval.studies.estimator_setting import Moments as MeanAndCovariance
from simval.studies.estimator_setting import Setting
from simval.text import message_of
from simval.theory.series import Series, algebra, series_moments

AXES = ("x", "y", "z")


def series_of(setting: Setting, noise_std: float, order: int) -> Moments:
    """Mean and covariance of the rotation error, on the plug-in's side.

    Raises
    ------
    PluginError
        If the plug-in cannot work with power series, with what it did.
    """
    plugin, told = setting.plugin, setting.noise.at(noise_std)
    truth = [v[None] for v in setting.truth]
    raised: list[Exception] = []

    def error(*vectors: NDArray[np.object_]) -> NDArray[np.object_]:
        try:
            return _rotation(setting, _answer(plugin, list(vectors), truth, told))
        except Exception as fault:  # whatever a user's function may raise
            raised.append(fault)
            raise

    try:
        moments = series_moments(
            error, setting.truth, setting.covariances(noise_std), order
        )
    except Exception as fault:  # of the plug-in, or of what it answered
        own = raised[0] if raised else fault
        if isinstance(plugin, RemoteEstimator) and isinstance(own, PluginError):
            raise own from None  # what its process says of it
        raise _unable(plugin.name, own) from None
    return Moments(bias=-moments.bias, covariance=moments.covariance)


def _answer(
    plugin: Estimator,
    vectors: list[NDArray[np.object_]],
    truth: list[Array],
    noise: VectorNoise,
) -> NDArray[np.object_]:
    """Answer to vectors of power series, (3,) each."""
    if isinstance(plugin, RemoteEstimator):
        return _answered_elsewhere(plugin, vectors, truth, noise)
    found = calling.one_answer(plugin, [v[None] for v in vectors], truth, noise)
    return np.asarray(found, dtype=object)


def _answered_elsewhere(
    plugin: RemoteEstimator,
    vectors: list[NDArray[np.object_]],
    truth: list[Array],
    noise: VectorNoise,
) -> NDArray[np.object_]:
    tables = vectors[0][0].algebra
    words = {
        "dimension": tables.dimension,
        "degree": tables.degree,
        "noise": {"tangent": noise.tangent, "noise_std": noise.noise_std},
    }
    arrays = {
        "vectors": np.array([[each.coefficients for each in v] for v in vectors]),
        "truth": np.array(truth),
        "unit": noise.unit,
    }
    session = plugin.session
    found = session.ask("series", words, arrays).arrays
    terms, plain = (found.get(name, np.empty(0)) for name in ("terms", "plain"))
    if terms.ndim == 0 or terms.shape != (*plain.shape, len(tables.means)):
        msg = f"terms of the shape {terms.shape}"
        raise session.unreadable(msg)
    answer = np.empty(plain.shape, dtype=object)
    for place in np.ndindex(plain.shape):
        own = terms[place]
        answer[place] = float(own[0]) if plain[place] else Series(own, tables)
    return answer


def series(
    plugin: Estimator, words: Mapping[str, Any], arrays: Mapping[str, Array]
) -> dict[str, Array]:
    """In the plug-in's process: its answer to power series, by their terms.

    Raises
    ------
    PluginError
        If it cannot work with them.
    """
    tables = algebra(words["dimension"], words["degree"])
    vectors = [
        np.array([Series(own, tables) for own in v], dtype=object)
        for v in arrays["vectors"]
    ]
    noise = VectorNoise(unit=arrays["unit"], **words["noise"])
    try:
        answer = _answer(plugin, vectors, list(arrays["truth"]), noise)
        one = vectors[0][0] * 0.0
        plain = np.array([not isinstance(each, Series) for each in answer.flat])
        terms = [(one + each).coefficients for each in answer.flat]
    except Exception as fault:  # whatever a user's function may raise
        raise _unable(plugin.name, fault) from None
    return {
        "terms": np.reshape(terms, (*answer.shape, len(tables.means))),
        "plain": plain.reshape(answer.shape),
    }


def _unable(name: str, fault: Exception) -> PluginError:
    return PluginError(
        f"{name} declares series=True, and `estimate` cannot work with "
        f"power series{_place(fault)}: {message_of(fault)}; use + - * / **, abs, "
        "comparisons and numpy.sqrt, or do not declare it"
    )


def _place(error: BaseException) -> str:
    """The line of the user's file at which it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [i for i, frame in enumerate(frames) if frame.filename == calling.__file__]
    theirs = frames[own[-1] + 1 :] if own else []
    lines = [f.line for f in theirs if f.filename == theirs[0].filename and f.line]
    return f" at `{lines[-1]}`" if lines else ""


def _rotation(setting: Setting, answer: NDArray[np.object_]) -> Any:
    """Rotation vector of an answer's error, to fourth order."""
    plugin = setting.plugin
    shape = tail(plugin.components)
    if answer.shape not in (shape, (1, *shape)):
        msg = f"it returned the shape {answer.shape} for one sample"
        raise ValueError(msg)
    found = answer.reshape(shape)
    M = found if plugin.components == "matrix" else _matrix(found, plugin.components)
    body_from_reference = M if plugin.matrix == "active" else M.T
    A = attitude_matrix(setting.q)
    if plugin.side == "body":
        R = A @ body_from_reference.T
    else:
        R = body_from_reference.T @ A
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) * 0.5
    return w * (1.0 + np.sum(w * w) * (1.0 / 6.0))


def _matrix(q: NDArray[np.object_], components: str) -> NDArray[np.object_]:
    """R(q) of Hamilton's product."""
    *vector, s = q if components == "xyzs" else np.roll(q, -1)
    x, y, z = vector
    xx, yy, zz, ss = x * x, y * y, z * z, s * s
    rows = [
        [ss + xx - yy - zz, 2.0 * (x * y - s * z), 2.0 * (x * z + s * y)],
        [2.0 * (x * y + s * z), ss - xx + yy - zz, 2.0 * (y * z - s * x)],
        [2.0 * (x * z - s * y), 2.0 * (y * z + s * x), ss - xx - yy + zz],
    ]
    return np.array(rows, dtype=object)


def series_rows(
    setting: Setting,
    noise_std: float,
    measured: Moments,
    cubature: MeanAndCovariance,
) -> tuple[Row, ...]:
    """Rows of simulated moments beside theory of both orders."""
    found = {order: series_of(setting, noise_std, order) for order in (2, 4)}
    fourth, upper = found[4], np.triu_indices(3)
    mean, covariance = cubature[0][:3], cubature[1][:3, :3]
    left = (
        2.0 * float(np.abs(mean - fourth.bias).max()),
        2.0 * float(np.abs(covariance - fourth.covariance).max()),
    )
    pairs = [
        COVARIANCE(AXES[i], AXES[j], unit="rad²") for i, j in zip(*upper, strict=True)
    ]
    rows: tuple[Row, ...] = ()
    for order, name in ((2, ORDER_2), (4, ORDER_4)):
        theory, n = found[order], measured.samples
        apart = (
            float(np.abs(theory.bias - fourth.bias).max()),
            float(np.abs(theory.covariance - fourth.covariance).max()),
        )
        rows += plain(
            BIAS.each(AXES, ["rad"] * 3), measured.bias[:3], measured.bias_error[:3],
            n, theory.bias, name, apart[0] + left[0],
        ) + plain(
            pairs, measured.covariance[upper], measured.covariance_error[upper],
            n, theory.covariance[upper], name, apart[1] + left[1],
        )  # fmt: skip
    return rows
