r"""Random walk given to a filter in place of slow noise of another kind.

Filters and calibrations of cameras know two numbers of a sensor: white noise N and a
random walk K of its bias. Where the slow noise is no walk, or its kind cannot be told,
K is still asked for. What such a filter does with it is this: it knows the bias by the
readings of a time t and integrates readings for as long; the error is t times the
difference of two neighbouring means. Its variance, true and as the filter states it, is

.. math:: 2 t^2\,\bigl(w(t) + s(t)\bigr),\qquad 2 t^2\,\bigl(w(t) + K^2 t/3\bigr)

with the Allan variances w of white noise and s of slow noise. The equivalent walk over
a horizon T is the least whose stated variance is nowhere below the true one where slow
noise is more than white, nor at T, and nowhere below by more than a share :math:`e`:

.. math:: K^2 = 3 \max\Bigl\{\ \max_{s(t) \ge w(t)} \frac{s(t)}t,\ \frac{s(T)}T,\
   \max_{t \le T} \frac{s(t) - e\,w(t)}{(1 + e)\,t}\ \Bigr\},\qquad
   e = \frac{\sqrt2 - 1}2 \tag{V14}

So it is K of a walk itself, :math:`R\sqrt{3T/2}` of a ramp, :math:`(6 \ln2/\pi)^{1/2}
B\,t_1^{-1/2}` of flicker that exceeds white noise from :math:`t_1` on, and the driving
noise of Markov noise, or less. With this :math:`e` the last term is the first for
flicker; it counts for noise that stays below the white one. A filter that weighs its
readings otherwise is honest within the same bound, as
`test_a_filter_is_honest_over_the_horizon` shows.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.imu.noise.components import Component
from simval.imu.noise.least_squares import AllanProblem, Squares, ends, fitted, greatest
from simval.shapes import Float

EXCESS: Final = 0.5 * (np.sqrt(2.0) - 1.0)
"""Share by which a stated variance may be below the true one, eq. (V14)."""
SLOW: Final = "BKMR"  # kinds of components
_TIMES: Final = 256  # over the horizon, evenly on a log scale


def equivalent_walk(
    slow: Float[Array, "... t"], white: Float[Array, "... t"], times: Float[Array, " t"]
) -> Float[Array, "..."]:
    """Squared coefficient of the equivalent walk (V14), up to the horizon."""
    cover = np.where(slow >= white, slow, 0.0)
    cover[..., -1] = slow[..., -1]
    least = (slow - EXCESS * white) / (1.0 + EXCESS)
    return np.asarray(3.0 * np.max(np.maximum(cover, least) / times, axis=-1))


def walks_of(
    problem: AllanProblem,
    found: Squares,
    sets: Sequence[tuple[Component, ...]],
    span: tuple[float, float],
) -> dict[tuple[Component, ...], tuple[float, float, float]]:
    """Equivalent walk of each fitted set of components, with its interval.

    Squares in units of rows; of sets with slow noise. The ends are those of the size of
    the slow noise, its shape the fitted one: where the shape is not known, the signal
    has several sets. `span` has the first and the last of the lengths, rows.
    """
    kinds = np.array([[c.kind for c in each] for each in sets])
    slow = found.values * np.isin(kinds, [*SLOW])
    some = np.flatnonzero(slow.any(axis=1))
    if not len(some):
        return {}
    slow, rest, kinds = slow[some], (found.values - slow)[some], kinds[some]
    rest[:, 0] += ~rest.any(axis=1)  # white noise may be there if none was found
    # two squares: one factor of all that is fast, and one of all that is slow
    shape = np.stack([rest, slow], axis=2)
    law, forms = problem.law, problem.forms
    if len(sets) > 1:
        law, forms = law[some], forms[some]
    both = shape[:, None, None]
    forms = np.swapaxes(both, 3, 4) @ forms @ both
    sized = AllanProblem(problem.variances[some], law @ shape, forms)
    low, high = (each[:, 1] for each in ends(sized, fitted(sized)))
    high = np.minimum(high, greatest(sized)[:, 1])
    size = np.stack([np.ones(len(some)), np.minimum(low, 1.0), np.maximum(high, 1.0)])
    times = np.geomspace(*span, _TIMES)
    laws = np.array([[c.law(times) for c in sets[k]] for k in some.tolist()])
    white = np.einsum("sk,skt->st", rest * np.isin(kinds, [*"NQ"]), laws)
    s = np.einsum("sk,skt->st", slow, laws)
    squares = equivalent_walk(size[..., None] * s, white, times).T.tolist()
    return {
        sets[k]: (a, b, c) for k, (a, b, c) in zip(some.tolist(), squares, strict=True)
    }
