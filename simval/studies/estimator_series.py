r"""An estimator evaluated on power series in the noise.

One that is made of plain arithmetic answers series as it answers numbers
(`simval.theory.series`), and so gives its own bias and covariance. With
:math:`R = R(\delta q)` of the error and :math:`w` the vector of :math:`(R - R^T)/2`,
whose length is the sine of the angle, the rotation vector is to fourth order

.. math:: \theta = w\,(1 + |w|^2 / 6).

Its coefficients cross between processes, not the series.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array, Mask
from simval.errors import PluginError
from simval.geometry import attitude_matrix, axial
from simval.moments import Moments
from simval.plugins import Estimator, answers
from simval.plugins.attitudes import tail
from simval.plugins.child import where_it_lives
from simval.plugins.noise import VectorNoise
from simval.shapes import Float
from simval.text import raised
from simval.theory.series import Series, algebra, series_moments


def series_of(
    plugin: Estimator,
    q: Float[Array, "4"],
    vectors: Float[Array, "m 3"],
    covariances: Float[Array, "m 3 3"],
    noise: VectorNoise,
    order: Literal[2, 4],
) -> Moments:
    """Mean and covariance of the rotation error at q, on the plug-in's side."""
    truth = [v[None] for v in vectors]
    faults: list[Exception] = []

    def error(*given: NDArray[np.object_]) -> NDArray[np.object_]:
        try:
            return _rotation(plugin, q, _answer(plugin, list(given), truth, noise))
        except Exception as fault:  # whatever a user's function may raise
            faults.append(fault)
            raise

    try:
        moments = series_moments(error, vectors, covariances, order)
    except Exception as fault:  # of the plug-in, or of what it answered
        own = faults[0] if faults else fault
        unable = own if isinstance(own, PluginError) else _unable(plugin.name, own)
        raise unable from None
    return Moments(bias=-moments.bias, covariance=moments.covariance)


def _answer(
    plugin: Estimator,
    vectors: list[NDArray[np.object_]],
    truth: list[Array],
    noise: VectorNoise,
) -> NDArray[np.object_]:
    """Answer of the estimator to vectors of power series."""
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
) -> tuple[Float[Array, "... t"], Mask]:
    """Terms of the answer as power series, and which entries are plain numbers."""
    tables = algebra(*size)
    rows = [[Series(own, tables) for own in v] for v in given]
    vectors = [np.array([v], dtype=object) for v in rows]
    try:
        found = answers.one_answer(plugin, vectors, truth, noise)
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
        f"power series: {raised(fault)}; use + - * / **, abs, "
        "comparisons and numpy.sqrt, or do not declare it"
    )


def _rotation(
    plugin: Estimator, q: Float[Array, "4"], answer: NDArray[np.object_]
) -> Any:
    """Rotation vector of an answer's error, to fourth order."""
    shape = tail(plugin.components)
    if answer.shape not in (shape, (1, *shape)):
        msg = f"it returned the shape {answer.shape} for one sample"
        raise ValueError(msg)
    found = answer.reshape(shape)
    M = found if plugin.components == "matrix" else _matrix(found, plugin.components)
    body_from_reference = M if plugin.matrix == "active" else M.T
    A = attitude_matrix(q)
    on_body = plugin.side == "body"
    R = A @ body_from_reference.T if on_body else body_from_reference.T @ A
    w = axial(R) * 0.5
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
