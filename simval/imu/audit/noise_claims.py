"""Noise of a simulated sensor: as large as claimed, and independent on each axis."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.imu.audit.fewest import SensorAudit
from simval.imu.audit.regression import TINY
from simval.imu.noise import (
    allan_covariance,
    allan_law,
    allan_variance,
    averaging_counts,
    covariance_forms,
)
from simval.shapes import Float, Int

LEAST: Final = 500  # rows
DIFFERENCES: Final = 100  # in the longest average that is compared
CLEAR: Final = 3.0  # times the error of the ideal, from which what is left is noise
FAINT: Final = 1e-5  # of a reading: less is rounding
SHARED: Final = 0.05  # correlation that chance and a fit do not leave
BLOCKS: Final = 32  # whose sums of products tell their spread, whatever their colour


class Claim(NamedTuple):
    """Measured noise of one sensor, and the claim that it was compared with.

    Attributes
    ----------
    name : str
        Of the sensor.
    density : Array
        White noise of each axis by the shortest averages, SI unit per root hertz, (3,).
    chance : float
        Of an Allan variance as far from the claimed one, on the farthest axis; 1
        without a claim.
    claimed : tuple of float
        N, B, K; none without a claim.
    """

    name: str
    density: Float[Array, "3"]
    chance: float = 1.0
    claimed: tuple[float, ...] = ()


class Shared(NamedTuple):
    """Two axes that have the same noise."""

    one: str
    other: str
    correlation: float


def noise_rows(found: SensorAudit) -> Float[Array, "n 3"] | None:
    """Residuals of the longest piece in sensor axes; None if they are no pure noise."""
    left = max(found.left, key=len)
    noisy = np.sqrt(np.mean(left**2)) > CLEAR * found.bound + FAINT * found.size
    explained = noisy and not found.wrong and not found.unexplained
    return left @ found.mount.T if explained and len(left) >= LEAST else None


def claims(
    found: Sequence[SensorAudit],
    rate_hz: float,
    claimed: Mapping[str, tuple[float, float, float]],
) -> tuple[list[Claim], list[Shared], float]:
    """Compare the noise with the claims, and each pair of axes with each other.

    Pairs of axes that share a noise are stated with the chance of the greatest
    correlation among all.
    """
    made: list[Claim] = []
    noises: dict[str, Array] = {}
    for each in found:
        rows = noise_rows(each)
        if rows is None:
            continue
        counts = averaging_counts(len(rows), 1)
        counts = counts[counts <= max(len(rows) // DIFFERENCES, 1)]
        variances = allan_variance(rows, counts)
        own, p = claimed.get(each.name, ()), 1.0
        if own:
            squares = np.array(own) ** 2 * [rate_hz, 1.0, 1.0 / rate_hz]
            p = _chance(variances, counts, len(rows), np.append(squares, 0.0))
        made.append(Claim(each.name, np.sqrt(variances[0] / rate_hz), p, own))
        differences = np.diff(rows, axis=0).T
        noises |= {
            f"{each.name} {axis}": x
            for axis, x in zip("xyz", differences, strict=True) if np.ptp(x) > 0.0
        }  # fmt: skip
    if len(noises) < 2 or len({len(each) for each in noises.values()}) != 1:
        return made, [], 1.0
    r = np.corrcoef([*noises.values()])
    least, shared, pairs = 1.0, [], [*combinations(enumerate(noises), 2)]
    for (i, one), (k, other) in pairs:
        if abs(r[i, k]) > SHARED:
            shared.append(Shared(one, other, float(r[i, k])))
            least = min(least, _by_blocks(noises[one] * noises[other]))
    chance = min(1.0, least * len(pairs))
    return made, sorted(shared, key=lambda each: -abs(each.correlation)), chance


def _by_blocks(products: Float[Array, " n"]) -> float:
    # chance of a mean of products as far from zero, by Student's t of their blocks
    sums = [each.sum() for each in np.array_split(products, BLOCKS)]
    spread = max(float(np.std(sums, ddof=1)), TINY)
    t = abs(float(np.mean(sums))) / spread * np.sqrt(BLOCKS)
    return 2.0 * float(scipy.special.stdtr(BLOCKS - 1, -t))


def _chance(
    variances: Float[Array, "m 3"],
    counts: Int[np.ndarray, " m"],
    n: int,
    squares: Float[Array, "4"],
) -> float:
    # of an Allan variance by Wilson and Hilferty's cube root, with (V4)'s correlations
    law = allan_law(counts) @ squares
    if not law.min() > 0.0:
        return 0.0 if variances.any() else 1.0
    covariance = allan_covariance(covariance_forms(counts, n), squares)
    sd = np.sqrt(np.diagonal(covariance))
    spread = sd**2 / law**2 / 9.0  # 2 over nine times the degrees of freedom
    z = (np.cbrt(variances.T / law) - 1.0 + spread) / np.sqrt(spread)
    root = np.linalg.cholesky(covariance / sd / sd[:, None])
    squared = np.sum(np.linalg.solve(root, z.T) ** 2, axis=0)
    return float(scipy.special.chdtrc(len(counts), squared.max()))
