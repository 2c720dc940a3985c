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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import PluginError
from simval.geometry import attitude_matrix
from simval.moments import Moments
from simval.plugins import Estimator, calling
from simval.plugins.child import where_it_lives
from simval.plugins.noise import VectorNoise
from simval.plugins.rotations import tail
from simval.results import Row, plain
from simval.shapes import Float
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
        unable = own if isinstance(own, PluginError) else _unable(plugin.name, own)
        raise unable from None
    return Moments(bias=-moments.bias, covariance=moments.covariance)


def _answer(
    plugin: Estimator,
    vectors: list[NDArray[np.object_]],
    truth: list[Array],
    noise: VectorNoise,
) -> NDArray[np.object_]:
    """Answer to vectors of power series, (3,) each; their coefficients cross."""
    tables = vectors[0][0].algebra
    given = np.array([[each.coefficients for each in v] for v in vectors])
    size = (tables.dimension, tables.degree)
    terms, plain = _terms(plugin, size, given, truth, noise)
    answer = np.empty(plain.shape, dtype=object)
    for place in np.ndindex(plain.shape):
        own = terms[place]
        answer[place] = float(own[0]) if plain[place] else Series(own, tables)
    return answer


@where_it_lives
def _terms(
    plugin: Estimator,
    size: tuple[int, int],
    given: Float[Array, "m 3 t"],
    truth: list[Array],
    noise: VectorNoise,
) -> tuple[Float[Array, "... t"], NDArray[np.bool_]]:
    """Terms of its answer to power series, and which entries are plain numbers.

    Raises
    ------
    PluginError
        If it cannot work with them.
    """
    tables = algebra(*size)
    rows = [[Series(own, tables) for own in v] for v in given]
    vectors = [np.array([v], dtype=object) for v in rows]
    try:
        found = calling.one_answer(plugin, vectors, truth, noise)
        answer = np.asarray(found, dtype=object)
        one = rows[0][0] * 0.0
        plain = np.array([not isinstance(each, Series) for each in answer.flat])
        terms = [(one + each).coefficients for each in answer.flat]
    except Exception as fault:  # whatever a user's function may raise
        raise _unable(plugin.name, fault) from None
    return np.reshape(terms, (*answer.shape, -1)), plain.reshape(answer.shape)


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
