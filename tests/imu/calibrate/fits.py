"""Every fit of the package with readings that it can be made from, for what all share.

One body rests in thirteen attitudes and turns about one axis at a time between them, so
that means of the rate give the turns exactly and a fit of clean readings has no error.
The noise is a hundred-thousandth of the readings: all is linear in it.
"""

from dataclasses import dataclass

import numpy as np
from magnetometer_sets import FIELD, IRON
from tumbles import ACCELEROMETER, FIRST_UP, GENERIC, GYROSCOPE, M, rolled

from simval.imu.calibrate import (
    Recording,
    calibrate,
    fit,
    inter_rest_rotations,
)
from simval.imu.sensor import MODELS, convert, forms

QUIET, G, H, MARGIN = np.random.default_rng(0), 9.81, 0.01, 1
TIME, RATE, RESTS, ATTITUDES = rolled(GENERIC, hold=100, move=150, h=H, first=400)
LEVEL = np.cross(FIRST_UP, [1.0, 0.0, 0.0]) / np.linalg.norm(
    np.cross(FIRST_UP, [1.0, 0.0, 0.0])
)
DIP = np.radians(60.0)
ALONG = np.cos(DIP) * LEVEL - np.sin(DIP) * FIRST_UP
CLEAN = {
    "poses": ACCELEROMETER.distort(G * ATTITUDES.inv().apply(FIRST_UP), QUIET),
    "fields": IRON.distort(FIELD * ATTITUDES.inv().apply(ALONG), QUIET),
    "rates": GYROSCOPE.distort(RATE, QUIET),
}
POSE_STD, FIELD_STD, WALK = 1e-4, 5e-3, 1e-5
STD = {"poses": POSE_STD, "fields": FIELD_STD, "rates": WALK / np.sqrt(H)}


@dataclass(frozen=True)
class Case:
    """One fit: which sensors, and how."""

    sources: tuple[str, ...]  # of the readings, in the order of the parameters
    form: str = "triangular"
    residual: str = "weighted"
    known: bool = True  # whether the noise is stated
    estimator: str = "joint"
    bias: str = "constant"
    drift: float = 0.0
    margin: int = MARGIN
    means: bool = False  # whether rotations go between the means of rests

    @property
    def truth(self):
        """True parameters, in the axes of the form."""
        own, _ = convert(
            ACCELEROMETER.parameters, None, source="triangular", target=self.form
        )
        turn = forms.matrix(self.form, own) @ np.linalg.inv(ACCELEROMETER.matrix)
        parts = {
            "poses": [own],
            "rates": [(turn @ M).ravel(), GYROSCOPE.B],
            "fields": [(turn @ IRON.M).ravel(), IRON.b, [DIP]],
        }
        return np.concatenate([x for name in self.sources for x in parts[name]])

    @property
    def told(self):
        """Parameters whose error the covariance states: a bias by lines has none."""
        return slice(0, 18 if self.bias != "constant" else None)

    def units(self, scale):
        """Sizes of the parameters where the readings are so many times as large."""
        k = scale["poses"]
        own = np.r_[np.ones(3) if self.form != "symmetric" else np.full(3, 1 / k)]
        parts = {
            "poses": np.r_[own, np.full(3, 1 / k), np.full(3, k)],
            "rates": np.r_[np.full(9, 1 / scale["rates"]), np.full(3, scale["rates"])],
            "fields": np.r_[
                np.full(9, 1 / scale["fields"]), np.full(3, scale["fields"]), 1.0
            ],
        }
        return np.concatenate([parts[name] for name in self.sources])

    def fit(self, readings, *, times=1.0, scale=None, start=None, g=G, g_std=0.0):
        """Fit of readings by source, told so many times their noise."""
        scale = dict.fromkeys(CLEAN, 1.0) | (scale or {})
        poses, std = readings["poses"], times * scale["poses"] * POSE_STD
        own = calibrate(
            poses, g, self.form, residual=self.residual,
            noise_std=std if self.known else None, g_std=g_std,
        )  # fmt: skip
        if self.sources == ("poses",):
            return own
        given = {"poses": poses, "pose_std": std, "g": g, "g_std": g_std}
        given["model"] = self.form
        if "fields" in self.sources:
            field_std = times * scale["fields"] * FIELD_STD
            given |= {"fields": readings["fields"], "field_std": field_std}
        if "rates" in self.sources:
            given |= {
                "rotations": self.inter_rest(readings["rates"]), "accelerometer": own,
                "angle_random_walk": times * scale["rates"] * WALK,
                "bias_random_walk": times * scale["rates"] * self.drift,
                "bias": self.bias,
            }  # fmt: skip
        start = (np.eye(3) if start is None else start) / scale["rates"]
        found = fit(
            Recording(field=FIELD, **given), estimator=self.estimator, start=start
        )
        assert (found.parameters.ndim == 1) == (np.ndim(poses) == 2)
        if len(self.sources) == 3:
            return found
        return found.gyroscope or found.magnetometer

    def inter_rest(self, rates):
        """Moves of the gyroscope's rows; of a line between rests it is taken out."""
        how = {
            "margin": self.margin, "means": self.means,
            "chunk": 8 if self.means or self.bias == "line" else 1,
        }  # fmt: skip
        inter_rest = inter_rest_rotations(TIME, rates, RESTS, **how)
        if self.bias != "line":
            return inter_rest
        line = [
            [np.interp(TIME, inter_rest.rest_times, axis) for axis in each.T]
            for each in inter_rest.rest_rates - inter_rest.centre[:, None]
        ]
        line = np.swapaxes(line, 1, 2)
        rows = rates[None] if rates.ndim == 2 else rates
        return inter_rest_rotations(TIME, rows, RESTS, offset=line, **how)


CASES = {
    **{f"accelerometer, {form}": Case(("poses",), form) for form in MODELS},
    **{
        f"accelerometer, {residual}": Case(("poses",), residual=residual)
        for residual in ("squared", "norm", "sampson", "adjusted")
    },
    "accelerometer, noise unknown": Case(("poses",), residual="squared", known=False),
    **{f"magnetometer, {form}": Case(("poses", "fields"), form) for form in MODELS},
    **{
        f"gyroscope, {estimator}": Case(("poses", "rates"), estimator=estimator)
        for estimator in ("joint", "generalised")
    },
    "gyroscope, unweighted": Case(
        ("poses", "rates"), estimator="unweighted", bias="first rest"
    ),
    "gyroscope, symmetric": Case(("poses", "rates"), "symmetric"),
    "nine axes": Case(("poses", "rates", "fields")),
    "nine axes, upper": Case(("poses", "rates", "fields"), "upper"),
}
MEANS = {
    f"gyroscope between means, {bias}": Case(
        ("poses", "rates"), estimator="generalised", bias=bias, means=True
    )
    for bias in ("constant", "line")
}
WALKING = {
    "gyroscope that walks": Case(
        ("poses", "rates"), estimator="generalised", drift=1e-4
    ),
    "gyroscope, line": Case(("poses", "rates"), estimator="generalised", bias="line"),
    "gyroscope that walks, line": Case(
        ("poses", "rates"), estimator="generalised", bias="line", drift=1e-4
    ),
}


def drawn(case, trials, rng, *, times=1.0):
    """Readings of some trials."""
    return {
        name: CLEAN[name]
        + times * STD[name] * rng.standard_normal((trials, *CLEAN[name].shape))
        for name in case.sources
    }


def taken(readings, which):
    """Some of the trials, or one of them as a single set."""
    return {name: values[which] for name, values in readings.items()}


def parameters(fit):
    """All parameters of a fit, the accelerometer's first."""
    first = getattr(fit, "accelerometer", None)
    if isinstance(first, np.ndarray):
        return np.concatenate([first, fit.parameters], axis=-1)
    return fit.parameters


def sd(fit):
    """Error bars of all of them."""
    return np.sqrt(np.diagonal(fit.covariance, axis1=-2, axis2=-1))
