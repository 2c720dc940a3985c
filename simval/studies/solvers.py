r"""Solvers: all methods of the calibration must agree.

One noisy pose set, far enough from the closed-form start that there is a way to go.
Each method is stopped after every number of steps, and its distance from where it ends
is kept for the report. All must end at the same parameters. `iteration`, `step` and
`model` are those of `calibrate`: with "source" the methods are the sources' own from
the closed-form start, J'J + mu I of the triangular form, Gauss-Newton with a fixed
alpha and Newton with all second derivatives of the symmetric one.

`SOURCES` are the sources' own methods on the same set: nine unknowns, no closed-form
start but :math:`M = I, b = 0`, the residual :math:`e_k = |M(a_k - b)|^2 - g^2`. The
first is Levenberg-Marquardt in T, K, B; the others are in a symmetric K: Gauss-Newton
with full steps and with half of each, the derivation's fixed :math:`\alpha`, with the
stop rule as it is printed, and Newton with all 45 second derivatives. Near the end a
step multiplies the error by :math:`I - \alpha (J^TJ)^{-1} H`, H the Hessian of half the
cost. With :math:`\rho` the greatest eigenvalue of this for :math:`\alpha = 1`, a damped
step leaves of the distance

.. math:: 1 - \alpha + \alpha r, \quad |r| \le \rho.  \tag{S1}

That is so near the end, of every form of the nine unknowns, which have one
:math:`\rho`. Where the noise leaves a parameter uncertain by more than `WIDEST` of its
size, their start need not be near it, and nothing is said of them.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Listing, Strip, Trace, entries, family_words
from simval.imu.calibrate import calibrate
from simval.imu.calibrate.minimization import pose_objective
from simval.imu.calibrate.residuals import monomial_rows
from simval.imu.calibrate.solver import Local, Objective, Rules, minimize
from simval.imu.sensor import forms
from simval.poses import fibonacci_sphere
from simval.results import Outcome, Row, beyond, limit, unjudged
from simval.shapes import Float
from simval.streams import Streams
from simval.studies.calibration import G, true_sensor
from simval.studies.study import (
    LEAST_NOISE,
    Cost,
    StudyParameters,
    described,
    ranged,
    refusing,
)
from simval.theory.calibration import calibration_moments
from simval.vocabulary import METHODS, Iteration, Method, Model

TITLE = "Solvers: do all methods of the calibration reach the same answer?"
SECTION = "convergence"

SHOWN = 30  # steps that the report draws
STOP: Final = 1e-11
"""Of the sources' methods, by (L1); half steps then end 1e-11 from the answer."""
MOST_STEPS: Final = 200
ROUNDING: Final = 64.0 * np.finfo(float).eps  # of a squared residual of size 1
FAR: Final = 1e-7
"""Of a distance that still falls by one factor, undisturbed by rounding."""
LEAST_STEP: Final = 0.2
"""A step then leaves 0.8, and `MOST_STEPS` of them 4e-20."""
AGREEMENT = 1e-9
"""Relative; each method stops at 1e-12 of its own step, some digits are the data's."""
HALF: Final = 0.5  # alpha
WIDEST: Final = 0.15
"""Of the size of a parameter: up to 0.12 all ended at the answer in 176 settings."""


class Source(NamedTuple):
    """Method of a source."""

    model: Model
    method: Method
    step: float = 1.0
    stop: str = "bounded"


FULL_STEPS, HALF_STEPS = "symmetric full steps", "symmetric half steps"
SOURCES: Final = {
    "triangular lm": Source("triangular", "lm"),
    FULL_STEPS: Source("symmetric", "gauss-newton"),
    HALF_STEPS: Source("symmetric", "gauss-newton", HALF),
    "symmetric printed stop": Source("symmetric", "gauss-newton", stop="printed"),
    "symmetric newton": Source("symmetric", "newton", stop="printed"),
}


class Parameters(StudyParameters):
    """One cell: a pose set and its noise."""

    noise_std: float = ranged(
        0.3, "Noise of each axis of a pose mean, m/s^2.", LEAST_NOISE, 3.0
    )
    poses: int = ranged(40, "Poses, spread evenly over the sphere.", 10, 400)
    iteration: Iteration = described(
        "centre", "Unknowns: the centre, or the sources' nine."
    )
    step: float = ranged(1.0, "Fraction of each step that is taken.", LEAST_STEP, 1.0)
    model: Model = described("triangular", "Form of the parameters.")

    no_noise = ("iteration", "step", "model")

    def cost(self) -> Cost:
        """Cost of a cell."""
        return Cost(0.1 + 0.5 * (self.step < 1.0), 16)


@refusing("lower `noise_std` or give more `poses`")
def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Follow each method step by step."""
    sensor = true_sensor(parameters.noise_std)
    force = G * fibonacci_sphere(parameters.poses)
    raw = sensor.distort(force, streams.block(0))
    first, plain = (
        calibrate(raw, g=G, model=model).parameters
        for model in ("triangular", parameters.model)
    )
    way = partial(
        calibrate, raw, g=G, model=parameters.model, step=parameters.step,
        iteration=parameters.iteration,
    )  # fmt: skip
    ends = {method: way(method=method) for method in METHODS}
    sd = calibration_moments(sensor, force, G, parameters.noise_std).sd
    widest = (sd / np.repeat([1.0, G], [6, 3])).max()
    why = (
        f"the noise leaves a parameter uncertain by {widest:.2g} of its size; that the "
        f"sources' methods end at the answer is known up to {WIDEST:g}"
        if widest > WIDEST
        else ""
    )
    ways: dict[str, Array] = {}
    left: dict[str, float] = {}
    rows: list[Row] = []
    for method, fit in ends.items():
        size = np.abs(plain).max()
        apart = np.abs(fit.parameters - plain).max() / size
        rows += unjudged(stat.STEPS(method), int(fit.iterations))
        rows += limit(stat.APART(method), apart, AGREEMENT, stat.FIRST_SOLVER)
        counts = range(1, min(SHOWN, int(fit.iterations)) + 1)
        path = np.array(
            [way(method=method, max_iterations=k).parameters for k in counts]
        )
        distance = np.abs(path - fit.parameters).max(axis=1) / size
        ways[method] = distance[(distance > 0.0) | (np.arange(len(path)) == 0)]
        if np.sum(distance > FAR) > 2:  # else its start is as near as its end
            left[method] = share_left(distance)
    for name, source in SOURCES.items():
        path, steps = source_way(source, raw)
        apart = np.abs(path - first).max(axis=1) / np.abs(first).max()
        rows += unjudged(stat.STEPS(name), steps)
        far = limit(stat.APART(name), apart[-1], AGREEMENT, stat.FIRST_SOLVER)
        rows += beyond(far, why)
        distance = np.abs(path[:-1] - path[-1]).max(axis=1) / np.abs(first).max()
        ways[name] = distance[distance > 0.0][:SHOWN]
        left[name] = share_left(distance)
    rows += unjudged(stat.STEP_LEAVES(FULL_STEPS), left[FULL_STEPS])
    damped = {HALF_STEPS: HALF}
    if parameters.iteration == "source" and "gauss-newton" in left:
        damped["gauss-newton"] = parameters.step
    for name, alpha in damped.items():
        off = abs(left[name] - (1.0 - alpha))
        # (S1), a hundredth for what is left of the other directions and second order
        most = alpha * left[FULL_STEPS] + 0.01
        rows += beyond(limit(stat.STEP_OFF(name), off, most, "1 - α"), why)
    return Outcome(
        rows=tuple(rows), artifacts={artifact_of(parameters.model_dump()): ways}
    )


def share_left(distance: Float[Array, " k"]) -> float:
    """Share of the distance to the end that the last step above `FAR` leaves."""
    last = max(1, int(np.flatnonzero(distance > FAR)[-1]))
    return distance[last] / distance[last - 1]


def source_way(
    source: Source, raw: Float[Array, "n 3"]
) -> tuple[Float[Array, "k 9"], int]:
    """Parameters (triangular) at each step of a source's method, and the steps."""
    objective, start = nine_unknowns(source.model, raw / G), np.zeros((1, 9))
    if source.method == "newton":
        m = monomial_rows((raw / G)[None])
        objective = pose_objective(source.model, "squared", m, newton=True)
    start[0] = forms.from_gram(source.model, np.eye(3), np.zeros(3))

    def stopped(most: int) -> tuple[Float[Array, "9"], int]:
        rules = Rules(
            method=source.method, step=source.step, tolerance=STOP, max_iterations=most,
            stop=source.stop,
        )  # fmt: skip
        # the source does not look at the cost: a step that rounding raises is taken
        found = minimize(objective, start, rules, slack=len(raw) * ROUNDING)
        M = forms.matrix(source.model, found.theta)
        same = forms.from_gram("triangular", M.mT @ M, found.theta[:, 6:])
        return same[0] * np.repeat([1.0, G], [6, 3]), int(found.iterations[0])

    _, steps = stopped(MOST_STEPS)
    return np.array([stopped(k)[0] for k in range(1, steps + 1)]), steps


def nine_unknowns(model: str, readings: Float[Array, "n 3"]) -> Objective:
    """Half the sum of the squared residuals e_k = |M(a_k - b)|^2 - 1, a in g."""

    def objective(theta: Float[Array, "1 9"], rows: Any) -> Local:
        M, x = forms.matrix(model, theta)[0], readings - theta[0, 6:]
        h, slopes = x @ M.T, forms.matrix_derivatives(model, theta)[0]
        J = np.empty((len(readings), 9))
        J[:, :6] = 2.0 * np.einsum("ni,kij,nj->nk", h, slopes, x)
        J[:, 6:] = -2.0 * h @ M
        e, normal = np.sum(h * h, axis=1) - 1.0, (J.T @ J)[None]
        return Local(
            cost=np.array([0.5 * e @ e]), gradient=(J.T @ e)[None],
            normal=normal, hessian=normal,
        )  # fmt: skip

    return objective


def artifact_of(named: Mapping[str, Any]) -> str:
    """File of the solvers' steps in a cell."""
    iteration, step, model = (named[key] for key in ("iteration", "step", "model"))
    own = f"{named['poses']}-{named['noise_std']:g}-{iteration}-{step:g}-{model}"
    return f"convergence-{own}.npz"


FIGURES = (
    Trace(
        name="convergence",
        asked="How fast does each solver converge?",
        file=artifact_of,
        axis="iteration",
        strips=[Strip(value="distance to the solution")],
        says="Steps to convergence: {each}.",
        about=[stat.STEPS],
        caption=(
            "Each point is one iteration. A straight line means linear convergence, a "
            "line that bends down faster convergence; solvers that take the same steps "
            "are on one line. The last points are rounding."
        ),
    ),
    Listing(
        name="study-solvers",
        caption="Steps of each solver, and how far apart the answers are",
        rows=[stat.STEPS, stat.APART, stat.STEP_LEAVES, stat.STEP_OFF],
        keys={"solver": entries},
        column=family_words,
    ),
)
