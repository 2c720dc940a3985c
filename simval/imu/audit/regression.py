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

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Final, Literal, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.shapes import Float

FIRST: Final = 16  # bins of the lowest band: it has noise of its own to be measured by
LOW: Final = (0, 1, 2, 4, 8)
"""First bins of its parts, in which a walk's noise differs."""
MIDDLE: Final = np.array([0.28, 1.0, 2.4, 5.2, 11.0])
"""Their frequencies in bins, of a walk: what its mean has, then roots of products."""
RATIO: Final = 1.6  # of the ends of a band
TAPER: Final = 0.25  # share of rows in the two cosine ramps
ROUNDING: Final = 1e-6  # of a reading: nobody needs its mean better
CLEAR: Final = 1e-2  # energy of the truth's rounding in a band that is used
SPREAD: Final = (
    1.149  # of a variance by the taper: mean of its fourth power over squares
)
MOST: Final = 3  # wrong things together; of more, their names would be a guess
MAINLY: Final = 0.01  # of the squares: who leaves less names the main things
Explained = Literal["all", "mainly", "no"]
RANK: Final = 1e-11
HIDDEN: Final = 1e-4  # of a parameter, in directions that are not told
TINY: Final = 1e-150


class AuditTerm(NamedTuple):
    """What may be wrong, or is not declared and fitted."""

    name: str
    basis: Float[Array, "k m"]  # its parameters in the columns
    wrong: bool = True  # or it is not declared, and no finding
    sd: float = np.inf  # prior of each parameter


class Bands(NamedTuple):
    """Products of columns, the target last, in each band and axis."""

    products: Float[Array, "b 3 k k"]
    signal: Float[Array, " b"]  # energy of the ideal reading
    bound: Float[Array, " b"]  # root of the energy of its error
    rounding: Float[Array, " b"]  # energy of that by the truth's rounding
    bins: Float[Array, " b"]
    energy: float  # of the readings, of one bin


class TermRows(NamedTuple):
    """Rows of one piece of a recording."""

    columns: Float[Array, "n 3 k"]  # the target last
    ideal: Float[Array, "n 3"]
    errors: tuple[Float[Array, "n 3"], ...]  # bounded
    rounding: tuple[Float[Array, "n j"], ...]  # draws of it
    reading: Float[Array, "n 3"]


def bands_of(pieces: Sequence[TermRows]) -> Bands:
    """Bands of pieces, whose energies add up."""
    shortest = min(len(each.ideal) for each in pieces)
    edges = [low / shortest for low in (*LOW[1:], FIRST)]
    while edges[-1] < 0.5:
        edges.append(edges[-1] * RATIO)
    if edges[-2] > 0.4:  # a last one that is too narrow
        del edges[-2]
    count = len(edges)
    size = pieces[0].columns.shape[2]
    products = np.zeros((count, 3, size, size))
    signal, rounding, bins = (np.zeros(count) for _ in range(3))
    bounds = np.zeros((len(pieces[0].errors), count))
    energy = 0.0
    for piece in pieces:
        n = len(piece.ideal)
        band = np.minimum(np.searchsorted(edges, np.fft.rfftfreq(n), "right"),
                          count - 1)  # fmt: skip
        starts = np.searchsorted(band, np.arange(count + 1))
        ramp = np.minimum(np.arange(n), np.arange(n)[::-1]) / (TAPER * (n - 1) / 2.0)
        taper = np.sin(np.pi / 2.0 * np.minimum(ramp, 1.0))[:, None] ** 2

        def energies(rows: Array, taper: Array = taper, band: Array = band) -> Array:
            each = np.abs(np.fft.rfft(rows * taper, axis=0)) ** 2
            return np.asarray(np.bincount(band, each.sum(axis=1), count), float)

        flat = piece.columns.reshape(n, -1) * taper
        spectra = np.fft.rfft(flat, axis=0).reshape(-1, 3, size)
        for b in range(count):
            own = spectra[starts[b] : starts[b + 1]].transpose(1, 2, 0)
            products[b] += (own @ own.conj().swapaxes(1, 2)).real
        signal_ = energies(piece.ideal)
        signal += signal_
        bounds += [energies(each) for each in piece.errors]
        rounding += sum(energies(each) / each.shape[1] for each in piece.rounding)
        bins += np.diff(starts)
        energy += float((energies(piece.reading) + signal_).sum()) / len(band)
    # rounding of a smooth path is coherent with it where rows are many
    rounding *= 3.0
    bound = np.sqrt(bounds).sum(axis=0) + np.sqrt(rounding)
    return Bands(products, signal, bound, rounding, bins, energy)


class TermFit(NamedTuple):
    """Parameters of some terms."""

    terms: tuple[AuditTerm, ...]
    value: Float[Array, " p"]
    sd: Float[Array, " p"]  # infinite where the recording does not tell it
    bound: Float[Array, " p"]  # of the error of the value by that of the ideal, (W4)
    squares: float  # what it leaves, prior included
    rank: int
    scale: float  # of the squares, before the fit

    def of(self, name: str) -> tuple[Array, Array, Array]:
        """Value, standard deviation and bound of a term's parameters."""
        begin = 0
        for term in self.terms:
            end = begin + term.basis.shape[1]
            if term.name == name:
                own = slice(begin, end)
                return self.value[own], self.sd[own], self.bound[own]
            begin = end
        raise KeyError(name)


def _densities(left: Float[Array, " b"], dof: Float[Array, " b"]) -> Float[Array, " b"]:
    # noise of each band: of the lowest, which the fit takes most of, that of the next
    # and a walk, by what all of them have together
    each = left / dof
    low = slice(0, len(LOW))
    white = float(left[low].sum() / dof[low].sum())
    walk = 0.0
    if len(left) > len(LOW) and each[len(LOW)] < white:
        white = float(each[len(LOW)])
        walk = float(
            (left[low] - dof[low] * white).sum() / (dof[low] / MIDDLE**2).sum()
        )
    each[low] = white + walk / MIDDLE**2
    return each


class Regression:
    """All terms of one sensor, weighed by the noise that the fit of all leaves.

    Attributes
    ----------
    whole : TermFit
        Of all terms.
    error : float
        Bound of the error of a root of squares, in standard deviations.
    freedom : float
        Degrees of freedom of the noise's density where the columns are.
    """

    def __init__(
        self, bands: Bands, terms: Sequence[AuditTerm], null: Float[Array, " p"]
    ) -> None:
        self.terms, self._bands = tuple(terms), bands
        ends = np.cumsum([each.basis.shape[1] for each in terms])
        self.place = {
            each.name: np.arange(end - each.basis.shape[1], end)
            for each, end in zip(terms, ends, strict=True)
        }
        k, p = bands.products.shape[2] - 1, int(ends[-1])
        wide = np.zeros((k + 1, p + 1))
        wide[:k, :p], wide[k, p] = np.hstack([each.basis for each in terms]), 1.0
        products = wide.T @ bands.products @ wide
        self._prior = np.concatenate(
            [np.full(each.basis.shape[1], each.sd**-2.0) for each in terms]
        )
        self.weights = (bands.rounding <= CLEAR * bands.signal) * np.ones((3, 1))
        self.weights[:, : len(LOW)] = 1.0
        self.weights /= bands.energy + TINY
        self._add_up(products, null)
        for _ in range(3):
            self._weigh(products, null)
            self._add_up(products, null)
        self.error = sum(
            np.sqrt(self._share(each)) * noise
            for each, noise in zip(self._each, self._noise, strict=True)
        )

    def _add_up(self, products: Float[Array, "b 3 p p"], null: Array) -> None:
        # products of all bands by their weights, and the fit of all terms
        p = len(self._prior)
        each = np.einsum("ab,baij->bij", self.weights, products)
        self._each, self._sum = each[:, :p, :p], each.sum(axis=0)
        self._root, self.whole = self._fit(self.terms, null)

    def _weigh(self, products: Float[Array, "b 3 p p"], null: Array) -> None:
        # noise of each band, times that of each axis
        bands, root = self._bands, self._root
        own = np.einsum("ik,bij,jk->b", root, self._each, root, optimize=True)
        dof = np.maximum(6.0 * bands.bins - own, 1.0)
        z = np.append(self.whole.value, -1.0)
        left = np.einsum("i,baij,j->ba", z, products, z) * SPREAD
        least = ROUNDING**2 * bands.energy * bands.bins.sum() + TINY
        axis = np.ones(3)
        for _ in range(2):
            shape = np.maximum(_densities((left / axis).sum(axis=1), dof), least)
            axis = 3.0 * (left / shape[:, None]).sum(axis=0) / dof.sum()
            axis = np.maximum(axis, 1e-6)
        clear = bands.rounding <= CLEAR * np.maximum(bands.signal, left.sum(axis=1))
        clear[: len(LOW)] = True
        known = bands.bound**2 / (6.0 * bands.bins)  # of the ideal, too
        self.weights = clear / (np.maximum(axis[:, None] * shape, least) + known)
        self._noise = bands.bound * np.sqrt(self.weights.max(axis=0))
        share, few = own / max(float(own.sum()), TINY), len(LOW)
        spread = share[:few].sum() ** 2 / dof[:few].sum()
        spread += np.sum(share[few:] ** 2 / dof[few:])
        self.freedom = 1.0 / float(spread) / SPREAD

    def _share(self, own: Float[Array, "p p"]) -> float:
        # greatest share of a band in a direction of the whole fit
        return min(float(np.linalg.eigvalsh(self._root.T @ own @ self._root)[-1]), 1.0)

    def fit(self, terms: Iterable[AuditTerm], null: Float[Array, " p"]) -> TermFit:
        """Fit some terms; the parameters of all others have their values in `null`."""
        return self._fit(tuple(terms), null)[1]

    def _fit(self, terms: tuple[AuditTerm, ...], null: Array) -> tuple[Array, TermFit]:
        free = np.concatenate([self.place[each.name] for each in terms])
        p = len(self._prior)
        offset = null.copy()
        offset[free] = 0.0
        target = np.append(-offset, 1.0)
        b = (self._sum[:p] @ target)[free]
        scale = float(target @ self._sum @ target)
        G = self._sum[np.ix_(free, free)] + np.diag(self._prior[free])
        size = np.sqrt(np.diagonal(G))
        size = np.where(size > 0.0, size, 1.0)
        values, vectors = np.linalg.eigh(G / size / size[:, None])
        seen = values > RANK
        root = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]
        inverse = root @ root.T
        value = inverse @ b
        hidden = np.sum(vectors[:, ~seen] ** 2, axis=1) > HIDDEN
        sd = np.where(hidden, np.inf, np.sqrt(np.diagonal(inverse)))
        bound = sum(
            np.sqrt(
                np.maximum(np.vecdot(inverse, inverse @ own[np.ix_(free, free)]), 0)
            )
            * noise
            for own, noise in zip(self._each, getattr(self, "_noise", ()), strict=False)
        )
        after = offset.copy()
        after[free] = value
        z = np.append(-after, 1.0)
        own = float(value @ (self._prior[free] * value))
        squares = max(float(z @ self._sum @ z) + own, 0.0)
        fit = TermFit(terms, value, sd, np.zeros_like(sd) + bound, squares,
                  int(seen.sum()), scale)  # fmt: skip
        return root, fit

    def explains(self, fit: TermFit, null: Float[Array, " p"], rate: float) -> bool:
        """Whether all other terms, or one, take no more off than is allowed."""
        others = [each for each in self.terms if each.wrong and each not in fit.terms]
        if not self._by_chance(fit, self.whole, rate / 2.0):
            return False
        return all(
            self._by_chance(
                fit, self.fit((*fit.terms, term), null), rate / 2.0 / len(others)
            )
            for term in others
        )

    def _by_chance(self, fit: TermFit, more: TermFit, rate: float) -> bool:
        rank = more.rank - fit.rank
        if rank <= 0:
            return True
        chance = scipy.special.fdtri(rank, self.freedom, 1.0 - rate)
        allowed = np.sqrt(rank * chance) + self.error
        return fit.squares - more.squares <= allowed**2 + 1e-12 * fit.scale

    def fewest(
        self, nulls: Sequence[Float[Array, " p"]], rate: float
    ) -> tuple[Explained, int, TermFit]:
        """Return the fewest wrong things that explain, and with which values of right.

        Of as many, those of the least squares. Where no few explain all, the fewest
        that explain most of it; where none do that, the best of the most.
        """
        always = tuple(each for each in self.terms if not each.wrong)
        wrong = [each for each in self.terms if each.wrong]

        def best(sets: Iterable[tuple[AuditTerm, ...]]) -> tuple[bool, int, TermFit]:
            fits = [
                (k, self.fit((*always, *some), null))
                for some in sets
                for k, null in enumerate(nulls)
            ]
            good = [x for x in fits if self.explains(x[1], nulls[x[0]], rate)]
            penalty = np.log(max(self._bands.bins.sum(), 2.0))
            return bool(good), *min(
                good or fits, key=lambda each: each[1].squares + penalty * each[1].rank
            )

        tried = []
        for size in range(MOST + 1):
            tried.append(best(combinations(wrong, size)))
            if tried[-1][0]:
                return ("all", *tried[-1][1:])
        most = self.whole.squares + MAINLY * (tried[0][2].squares - self.whole.squares)
        for _, which, fit in tried:
            if fit.squares <= most:
                return "mainly", which, fit
        return ("no", *tried[-1][1:])
