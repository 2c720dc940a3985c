r"""Regression of readings on what may be wrong with them, by bands of frequency.

A reading less its ideal is a sum of columns, each for something wrong, and noise,

.. math:: y - f = A \varphi + e + n .

Rows are tapered and transformed; in each band of frequency the products of all
columns are kept (`Bands`), and all that follows is algebra of these. The noise n
has a density of its own in each band and axis, from what the fit of all columns leaves:
white, coloured or walking noise needs no model. The error e of the ideal is no noise
but is bounded in each band: by the interpolation of the truth, its rounding, and what
the mean over a step differs by from its middle. By Cauchy and Schwarz it moves a
parameter by no more than

.. math:: \sum_b |\,(A^+)_b\,|\,|e_b| , \tag{W4}

and the root of a sum of squares by :math:`\sum_b \sqrt{\lambda_b}\,|e_b|`, where
:math:`\lambda_b` is the greatest share that the band has in a direction of the fit. So
a set of wrong things explains a recording if what all others, or any one of them, would
take off the squares is less than chance, an F quantile at half the stated rate for
each question, and this bound allow.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Final, Literal, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.imu.audit.ideal import TermRows
from simval.imu.audit.terms import Flaw
from simval.shapes import Bool, Float

FIRST: Final = 16  # bins of the lowest band: it has noise of its own to be measured by
LOW: Final = (0, 1, 2, 4, 8)
"""First bins of its parts, in which a walk's noise differs."""
MIDDLE: Final = np.array([0.28, 1.0, 2.4, 5.2, 11.0])
"""Their frequencies in bins, of a walk: what its mean has, then roots of products."""
RATIO: Final = 1.6  # of the ends of a band
HIGHEST: Final = 20  # bands more than the longest piece has
LAST: Final = 0.4  # cycles a row, at which the last band may begin
TAPER: Final = 0.25  # share of rows in the two cosine ramps
ROUNDING: Final = 1e-6  # of a reading: nobody needs its mean better
CLEAR: Final = 1e-2  # energy of the truth's rounding in a band that is used
SPREAD: Final = (
    1.149  # of a variance by the taper: mean of its fourth power over squares
)
ROUNDS: Final = 4  # settle the noise of each band
MOST: Final = 3  # wrong things together; of more, their names would be a guess
MAINLY: Final = 0.01  # of the squares: who leaves less names the main things
INSTANTS: Final = (0.0, 0.5, -0.5)
"""Steps that a row may be late by: of its instant, the mean over the step before, and
over the step after."""
Explained = Literal["all", "mainly", "no"]
RANK: Final = 1e-11
HIDDEN: Final = 1e-4  # share of a parameter in directions that are not determined
TINY: Final = 1e-150


def bands_of(pieces: Sequence[TermRows]) -> tuple[Array, Array]:
    """Products of all columns by frequency band, summed over the pieces.

    The columns of terms, the target, the ideal, the reading, and the errors.
    """
    least = min(len(each.ideal) for each in pieces)
    high = FIRST / least * RATIO ** np.arange(HIGHEST)
    begin = np.concatenate([np.array(LOW) / least, high[high <= LAST]])
    products, bins = np.zeros(1), np.zeros(1)
    for piece in pieces:
        more = [piece.target, piece.ideal, piece.reading, *piece.errors]
        signals = np.concatenate([piece.columns, np.stack(more, axis=2)], axis=2)
        taper = scipy.signal.windows.tukey(len(signals), TAPER)
        spectra = np.fft.rfft(signals * taper[:, None, None], axis=0)
        starts = np.searchsorted(np.fft.rfftfreq(len(signals)), begin)
        each = np.split(spectra.transpose(1, 2, 0), starts[1:], axis=2)
        products = products + np.array(
            [(own @ own.conj().swapaxes(1, 2)).real for own in each]
        )
        bins = bins + np.diff(starts, append=len(spectra))
    return products, bins


class TermFit(NamedTuple):
    """A fit of some terms; all others are taken to be right."""

    terms: tuple[Flaw, ...]
    instant: float  # steps that a right row is late by
    value: Float[Array, " p"]
    root: Float[Array, "p r"]  # of their covariance
    told: Bool[np.ndarray, " p"]
    squares: float  # what it leaves, prior included
    scale: float  # before the fit

    @property
    def rank(self) -> int:
        """Number of parameter combinations that are determined."""
        return self.root.shape[1]

    @property
    def sd(self) -> Float[Array, " p"]:
        """Standard deviations; infinite for what the recording does not determine."""
        return np.where(self.told, np.linalg.norm(self.root, axis=1), np.inf)


def _densities(left: Float[Array, " b"], dof: Float[Array, " b"]) -> Float[Array, " b"]:
    # noise of each band: of the lowest, which the fit takes most of, that of the next
    # and a walk, by what all of them have together
    each, low = left / dof, slice(0, len(LOW))
    white, walk = float(left[low].sum() / dof[low].sum()), 0.0
    if len(left) > len(LOW) and each[len(LOW)] < white:
        white = float(each[len(LOW)])
        walk = float(
            (left[low] - dof[low] * white).sum() / (dof[low] / MIDDLE**2).sum()
        )
    each[low] = white + walk / MIDDLE**2
    return each


class Regression:
    """All terms of one sensor, weighted by the noise that the fit of all leaves.

    Attributes
    ----------
    whole : TermFit
        Of all terms.
    error : float
        Bound of the error of a root of squares, in standard deviations.
    freedom : float
        Degrees of freedom of the noise's density where the columns are.
    """

    def __init__(self, pieces: Sequence[TermRows], terms: tuple[Flaw, ...]) -> None:
        self.terms, self.place = terms, pieces[0].place
        every, self._bins = bands_of(pieces)
        p = pieces[0].columns.shape[2]
        self._prior = np.zeros(p)
        for each in terms:
            self._prior[self.place[each.name]] = each.sd**-2.0
        products, bins = every[..., : p + 1, : p + 1], self._bins
        energies = np.einsum("baii->ib", every)[p + 1 :]
        signal, reading, *errors = energies
        bound, rounding = np.sqrt(errors).sum(axis=0), errors[-1]
        bin_energy = float((signal + reading).sum() / bins.sum()) * len(pieces) + TINY
        least = ROUNDING**2 * bin_energy * bins.sum()
        weights = np.full((3, len(bins)), 1.0 / bin_energy)
        for _ in range(ROUNDS):
            self._errors = bound * np.sqrt(weights.max(axis=0))
            self._products = np.einsum("ab,baij->bij", weights, products)
            self._sum = self._products.sum(axis=0)
            self.whole = self.fit(terms, 0.0)
            # noise of each band, times that of each axis
            shares = self._shares(self.whole)
            own = np.trace(shares, axis1=1, axis2=2)
            dof = np.maximum(6.0 * bins - own, 1.0)
            z = np.append(self.whole.value, -1.0)
            left = np.einsum("i,baij,j->ba", z, products, z) * SPREAD
            axis = np.ones(3)
            for _ in range(2):
                shape = np.maximum(_densities((left / axis).sum(axis=1), dof), least)
                axis = 3.0 * (left / shape[:, None]).sum(axis=0) / dof.sum()
                axis = np.maximum(axis, 1e-6)
            clear = rounding <= CLEAR * np.maximum(signal, left.sum(axis=1))
            clear[: len(LOW)] = True
            known = bound**2 / (6.0 * bins)  # of the ideal, too
            weights = clear / (np.maximum(axis[:, None] * shape, least) + known)
        most = np.linalg.eigvalsh(shares)[:, -1].clip(0.0, 1.0)
        self.error = float(np.sqrt(most) @ self._errors)
        few, share = len(LOW), own / max(float(own.sum()), TINY)
        spread = share[:few].sum() ** 2 / dof[:few].sum()
        spread += np.sum(share[few:] ** 2 / dof[few:])
        self.freedom = 1.0 / float(spread) / SPREAD

    def split(self, values: Float[Array, " p"]) -> dict[str, Array]:
        """Parameter values by the term that they belong to."""
        return {name: values[at] for name, at in self.place.items()}

    def _shares(self, fit: TermFit) -> Float[Array, "b r r"]:
        # of each band in the directions of a fit
        p = len(self._prior)
        return np.asarray(fit.root.T @ self._products[:, :p, :p] @ fit.root)

    def bound(self, fit: TermFit) -> Float[Array, " p"]:
        """Largest error of each parameter that errors of the ideal can make, (W4)."""
        squares = np.vecdot(fit.root @ self._shares(fit), fit.root)
        return np.asarray(self._errors @ np.sqrt(np.maximum(squares, 0.0)))

    def fit(self, terms: tuple[Flaw, ...], instant: float) -> TermFit:
        """Fit some terms to rows that belong so many steps before their stamp."""
        p = len(self._prior)
        free = np.concatenate([np.arange(p)[self.place[each.name]] for each in terms])
        value, told = np.zeros(p), np.zeros(p, bool)
        value[self.place["delay"].start] = instant
        value[free] = 0.0
        z = np.append(-value, 1.0)
        products = self._sum[np.ix_(free, free)] + np.diag(self._prior[free])
        size = np.sqrt(np.diagonal(products))
        size = np.where(size > 0.0, size, 1.0)
        level, turn = np.linalg.eigh(products / size / size[:, None])
        seen = level > RANK
        root = np.zeros((p, np.count_nonzero(seen)))
        root[free] = turn[:, seen] / np.sqrt(level[seen]) / size[:, None]
        told[free] = np.sum(turn[:, ~seen] ** 2, axis=1) <= HIDDEN
        scale = float(z @ self._sum @ z)
        value[free] = (root @ (root.T @ (self._sum @ z)[:p]))[free]
        z[:p] = -value
        squares = float(z @ self._sum @ z + value @ (self._prior * value))
        return TermFit(terms, instant, value, root, told, max(squares, 0.0), scale)

    def explains(self, fit: TermFit, rate: float) -> bool:
        """True if no other term, alone or with all, improves the fit beyond chance."""
        others = [each for each in self.terms if each not in fit.terms]
        return self._by_chance(fit, self.whole, rate / 2.0) and all(
            self._by_chance(
                fit, self.fit((*fit.terms, each), fit.instant), rate / 2.0 / len(others)
            )
            for each in others
        )

    def _by_chance(self, fit: TermFit, more: TermFit, rate: float) -> bool:
        rank = more.rank - fit.rank
        if rank <= 0:
            return True
        chance = scipy.special.fdtri(rank, self.freedom, 1.0 - rate)
        allowed = np.sqrt(rank * chance) + self.error
        return fit.squares - more.squares <= allowed**2 + 1e-12 * fit.scale

    def fewest(self, rate: float) -> tuple[Explained, TermFit]:
        """Find the fewest errors that explain the readings, how far, and their fit.

        Of as many, those of the least squares. Where no few explain all, the fewest
        that explain most of it; where none do that, the best of the most.
        """
        fitted = tuple(each for each in self.terms if not each.wrong)
        wrong = [each for each in self.terms if each.wrong]
        penalty = np.log(max(self._bins.sum(), 2.0))
        tried: list[TermFit] = []
        for size in range(MOST + 1):
            fits = [
                self.fit((*fitted, *some), instant)
                for some in combinations(wrong, size)
                for instant in INSTANTS
            ]
            good = [each for each in fits if self.explains(each, rate)]
            tried.append(
                min(good or fits, key=lambda each: each.squares + penalty * each.rank)
            )
            if good:
                return "all", tried[-1]
        main = self.whole.squares * (1.0 - MAINLY) + MAINLY * tried[0].squares
        mainly = [each for each in tried if each.squares <= main]
        return ("mainly", mainly[0]) if mainly else ("no", tried[-1])
