"""Noise of a simulated sensor: as claimed, and of a seed of its own on each axis."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.imu.audit.fewest import SensorAudit
from simval.imu.noise import (
    allan_covariance,
    allan_law,
    allan_variance,
    averaging_counts,
    covariance_forms,
)
from simval.shapes import Float

LEAST: Final = 500  # rows
DIFFERENCES: Final = 100  # in the longest average that is compared
CLEAR: Final = 3.0  # times the error of the ideal, from which what is left is noise
FAINT: Final = 1e-5  # of a reading: less is rounding
SHARED: Final = 0.05  # correlation that chance and a fit do not leave
DIFFERENCED: Final = 1.5  # variance of a correlation of differences, of one of rows


class Claim(NamedTuple):
    """Noise of one sensor.

    Attributes
    ----------
    name : str
        Of the sensor.
    density : Array
        White noise of each axis by the shortest averages, SI unit per root hertz, (3,).
    chances : Array or None
        Of an Allan variance as far from the claimed one, (3,); None without a claim.
    claimed : tuple of float or None
        N, B, K.
    """

    name: str
    density: Float[Array, "3"]
    chances: Float[Array, "3"] | None
    claimed: tuple[float, float, float] | None


class Shared(NamedTuple):
    """Two axes whose noise is one."""

    one: str
    other: str
    correlation: float


def noise_rows(found: SensorAudit) -> Float[Array, "n 3"] | None:
    """What is left of the longest piece in sensor axes; None where it is no noise."""
    left = max((rows for _, rows in found.left), key=len)
    size = float(np.sqrt(np.mean(left**2)))
    if (
        len(left) < LEAST
        or not size > CLEAR * found.bound + FAINT * found.size
        or found.wrong
        or found.unexplained
    ):
        return None
    return np.asarray(left @ found.mount.T)


def claims(
    found: Sequence[SensorAudit],
    rate_hz: float,
    claimed: Mapping[str, tuple[float, float, float]],
) -> tuple[list[Claim], list[Shared], float]:
    """Compare noise with what is claimed, and each axis with each."""
    made: list[Claim] = []
    signals: dict[str, Array] = {}
    for each in found:
        rows = noise_rows(each)
        if rows is None:
            continue
        counts = averaging_counts(len(rows), 1)
        counts = counts[counts <= max(len(rows) // DIFFERENCES, 1)]
        variances = allan_variance(rows, counts)
        own = claimed.get(each.name)
        chances = (
            None
            if own is None
            else _chances(variances, counts, len(rows), rate_hz, own)
        )
        density = np.sqrt(variances[0] / rate_hz)
        made.append(Claim(each.name, density, chances, own))
        signals |= {
            f"{each.name} {a}": np.diff(x) for a, x in zip("xyz", rows.T, strict=True)
        }
    return made, *_shared(signals)


def _chances(
    variances: Float[Array, "m 3"], counts: NDArray[np.int64], n: int, rate_hz: float,
    claimed: tuple[float, float, float],
) -> Float[Array, "3"]:  # fmt: skip
    # of an Allan variance by Wilson and Hilferty's cube root, with (V4)'s correlations
    N, B, K = claimed
    squares = np.array([N**2 * rate_hz, B**2, K**2 / rate_hz, 0.0])
    law = allan_law(counts) @ squares
    if not law.min() > 0.0:
        return np.where(variances.max(axis=0) > 0.0, 0.0, 1.0)
    covariance = allan_covariance(covariance_forms(counts, n), squares)
    sd = np.sqrt(np.diagonal(covariance))
    spread = sd**2 / law**2 / 9.0  # 2 over nine times the degrees of freedom
    z = (np.cbrt(variances / law[:, None]) - 1.0 + spread[:, None]) / np.sqrt(spread)[
        :, None
    ]
    root = np.linalg.cholesky(covariance / sd / sd[:, None])
    squared = np.sum(np.linalg.solve(root, z) ** 2, axis=0)
    return np.asarray(scipy.special.chdtrc(len(counts), squared))


def _shared(signals: Mapping[str, Array]) -> tuple[list[Shared], float]:
    # pairs in order of their correlation, and the chance of the greatest
    names = [*signals]
    lengths = {len(x) for x in signals.values()}
    if len(names) < 2 or len(lengths) != 1:
        return [], 1.0
    deviations = np.array([np.std(x) for x in signals.values()])
    names = [name for name, sd in zip(names, deviations, strict=True) if sd > 0.0]
    if len(names) < 2:
        return [], 1.0
    r = np.corrcoef([signals[name] for name in names])
    i, j = np.triu_indices(len(names), 1)
    order = np.argsort(-np.abs(r[i, j]))
    pairs = [Shared(names[i[k]], names[j[k]], float(r[i[k], j[k]])) for k in order]
    z = abs(pairs[0].correlation) * np.sqrt(lengths.pop() / DIFFERENCED)
    chance = min(1.0, 2.0 * float(scipy.special.ndtr(-z)) * len(pairs))
    return [each for each in pairs if abs(each.correlation) > SHARED], chance
