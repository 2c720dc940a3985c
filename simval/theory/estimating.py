r"""Second-order error of an estimate that solves equations, with its bound.

Rows :math:`r(\theta, z)` are zero at the truth without noise; z are independent noises
of unit variance. The estimate solves :math:`J^T W r = 0`, :math:`J = \partial
r/\partial\theta`. W = 1 makes the squares of the rows least; else W is :math:`V^{-1}`,
:math:`V = Z Z^T`, :math:`Z = \partial r/\partial z`, at the truth or at the estimate.
In powers of the noise its error is, with :math:`H = J^T W J`,

.. math:: \delta_1 = -H^{-1} J^T W Z z, \qquad
   \lambda = W (J\,\delta_1 + Z z) \tag{E1}

.. math:: \delta_2 = -H^{-1} \big[\dot J^T \lambda
   + J^T W (\tfrac12 \ddot r - \dot V \lambda)\big], \tag{E2}

the dots derivatives along :math:`(\delta_1, z)`; :math:`\dot V` only of weights at the
estimate. The covariance of (E1) and the mean of (E2), its bias, leave out
:math:`O(\sigma^4)`. If the rows are all that the readings say of the parameters,
whatever else is unknown, the Cramer-Rao bound is

.. math:: (J^T V^{-1} J)^{-1}. \tag{E3}

About its mean, the second order adds to the square of the error, normalised by the
covariance of the first,

.. math:: E[\delta_2^T C^{-1} \delta_2]; \tag{E4}

the first order times the third adds as much again, of either sign.

A sensor that is not here, alone or with others, needs its rows without the attitudes, a
`Block`; then `Estimating(blocks=(...), theta=truth)` has `bound` and `bias`, and
`simval.theory.plans.next_best` the next pose. Blocks have all parameters in common.

A row sees few noises: a `Block` is many rows of one kind, each a function of the
parameters and of readings of its own, whose noises others may share. The functions need
only be analytic: first derivatives are complex steps, exact to rounding, second ones
differences of them, of fourth order.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.shapes import Float

DRAWS: Final = 256  # of noise, for (E4)
_TINY: Final = 1e-30  # of the complex step
_STEP: Final = 3e-4  # of a change that moves the rows by one
Weights = Literal["none", "truth", "estimate"]
_FIRST: Final = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}


class Block(NamedTuple):
    """Rows of one kind, m for each of n items.

    Attributes
    ----------
    rows : callable
        Of parameters, (t, p), and readings, (t, n, d): (t, n, m), analytic; t may be 1
        of either, for all.
    y : Array
        The true readings, (n, d).
    sigma : Array
        Noise of each, (n, d).
    noise : Array or None
        Which of all noises each reading has, (n, d); None where nobody shares them.
    """

    rows: Callable[[Any, Any], Any]
    y: Float[Array, "n d"]
    sigma: Float[Array, "n d"]
    noise: NDArray[np.int64] | None = None


class _Slopes(NamedTuple):
    # of a block, parameters in units of `unit` and noises of the least
    J: Float[Array, "n m p"]
    Z: Float[Array, "n m d"]
    noise: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimating:
    """Equations that an estimate solves, at the truth.

    Attributes
    ----------
    blocks : tuple of Block
        The rows.
    theta : Array
        True parameters, (p,).
    weights : {"none", "truth", "estimate"}
        What W is; weights at the estimate are of blocks that share no noise.
    centred : bool
        Whether the mean that noise alone gives the equations is taken out of them.
    """

    blocks: tuple[Block, ...]
    theta: Float[Array, " p"]
    weights: Weights = "estimate"
    centred: bool = False

    def __post_init__(self) -> None:
        assert self.weights != "estimate" or not self._shared

    @cached_property
    def covariance(self) -> Float[Array, "p p"]:
        """Covariance of first order, of eq. (E1)."""
        return self.slope @ self.slope.T

    @cached_property
    def bound(self) -> Float[Array, "p p"]:
        """The Cramer-Rao bound, eq. (E3)."""
        bound = inverse_of(self._squared(self._VJ))
        return bound * self._least**2 * np.outer(self._unit, self._unit)

    @cached_property
    def rank(self) -> int:
        """Number of parameter combinations that the rows determine."""
        return rank_of(self._squared(self._VJ))

    @cached_property
    def information(self) -> Float[Array, "b p p"]:
        """Information of each item; eq. (E3) inverts the sum."""
        parts = zip(self._slopes, self._VJ, strict=True)
        each = np.concatenate([at.J.mT @ w for at, w in parts])
        return each / (self._least**2 * np.outer(self._unit, self._unit))

    @cached_property
    def jacobians(self) -> list[Float[Array, "n m p"]]:
        """Derivatives of the rows of each block by the parameters."""
        each = np.eye(len(self.theta))
        return [self._along(block, each, 0.0) for block in self.blocks]

    @cached_property
    def noises(self) -> list[Float[Array, "n m m"]]:
        """Covariance V of the rows of each item."""
        return [self._least**2 * V for V in self._V]

    @cached_property
    def by_noises(self) -> list[Float[Array, "n m d"]]:
        """Change of the rows of each block by its noises of unit variance."""
        return [self._least * at.Z for at in self._slopes]

    @cached_property
    def slope(self) -> Float[Array, "p z"]:
        """Change of the estimate by each noise of unit variance, eq. (E1)."""
        return (self._moved * (self._least * self._unit)).T

    @cached_property
    def bias(self) -> Float[Array, " p"]:
        """Second-order bias, the mean of eq. (E2)."""
        total = np.zeros(len(self.theta))
        spread = self._moved.T @ self._moved
        own: list[Array] = [at.Z @ self._moved[at.noise] for at in self._slopes]
        for at, S, WJ, WZ, pulled in zip(
            self._slopes, self._bends, self._WJ, self._WZ, self._weigh(own), strict=True
        ):
            by_noise = self._moved[at.noise]  # n d p
            n, d, p = by_noise.shape
            one = np.broadcast_to(np.eye(d), (n, d, d))
            first = np.broadcast_to(spread, (n, p, p))
            # means of the products of the way and of itself, and of lambda and it
            way = np.block([[first, by_noise.mT], [by_noise, one]])
            pull = np.concatenate([WJ @ spread + pulled, WZ + WJ @ by_noise.mT], axis=2)
            total += self._mean(at.Z, S, WJ, way, pull)
            if self.centred:
                way[:, :p], way[:, :, :p] = 0.0, 0.0
                total -= self._mean(
                    at.Z, S, WJ, way, np.concatenate([0.0 * WJ, WZ], axis=2)
                )
        return -(self._least**2) * self._unit * (self._inverse @ total)

    @cached_property
    def bent(self) -> float:
        r"""Increase of the normalised squared error by the second order, eq. (E4).

        By `DRAWS` draws, always the same: their standard error is a tenth of it.
        """
        noise = np.random.default_rng(0).standard_normal((DRAWS, self._count))
        sd = np.sqrt(np.diagonal(self.covariance))
        spread = np.cov(self.second(noise) / sd, rowvar=False)
        unit = self.covariance / np.outer(sd, sd)
        return float(np.trace(np.linalg.solve(unit, spread)))

    def first(self, z: Float[Array, "t ..."]) -> Float[Array, "t p"]:
        """First-order error for draws of unit noise, eq. (E1)."""
        return z.reshape(len(z), -1) @ self.slope.T

    def second(self, z: Float[Array, "t ..."]) -> Float[Array, "t p"]:
        """Second-order error for draws of unit noise, eq. (E2)."""
        z, p = z.reshape(len(z), -1), len(self.theta)
        first = z @ self._moved
        total = np.zeros_like(first)
        ways = [
            np.concatenate(
                [
                    np.broadcast_to(first, (len(at.noise), *first.shape)),
                    np.moveaxis(z[:, at.noise], 0, 1),
                ],
                axis=2,
            )
            for at in self._slopes
        ]  # n t s
        rows = [
            np.concatenate([at.J, at.Z], axis=2) @ way.mT
            for at, way in zip(self._slopes, ways, strict=True)
        ]
        for at, S, WJ, way, pull in zip(
            self._slopes, self._bends, self._WJ, ways, self._weigh(rows), strict=True
        ):
            bent = way[:, None] @ S  # n m t s
            curved = 0.5 * np.vecdot(bent, way[:, None])
            if self.weights == "estimate":
                Z, by_noise = at.Z, bent[..., p:]
                curved -= np.vecdot(by_noise, (pull.mT @ Z)[:, None])
                curved -= Z @ np.einsum("nmtd,nmt->ndt", by_noise, pull)
            total += np.einsum("nmtp,nmt->tp", bent[..., :p], pull)
            total += np.einsum("nmp,nmt->tp", WJ, curved)
        return -(self._least**2) * self._unit * (total @ self._inverse)

    def _mean(self, Z: Array, S: Array, WJ: Array, way: Array, pull: Array) -> Array:
        # mean of the bracket of eq. (E2), by those of way way' and lambda way'
        p = len(self.theta)
        curved = 0.5 * np.einsum("nmst,nst->nm", S, way)
        if self.weights == "estimate":
            by_noise = S[:, :, p:]
            curved -= np.einsum("nmds,nkd,nks->nm", by_noise, Z, pull, optimize=True)
            curved -= np.einsum("nmd,nkds,nks->nm", Z, by_noise, pull, optimize=True)
        turned = np.einsum("nmps,nms->p", S[:, :, :p], pull)
        return turned + np.einsum("nmp,nm->p", WJ, curved)

    @cached_property
    def _least(self) -> float:
        levels = np.concatenate([block.sigma.ravel() for block in self.blocks])
        return float(np.min(levels[levels > 0.0], initial=levels.max()))

    @cached_property
    def _unit(self) -> Float[Array, " p"]:
        # of each parameter: its column of J has unit length
        squares = sum(np.sum(J**2, axis=(0, 1)) for J in self.jacobians)
        return 1.0 / np.sqrt(np.where(squares > 0.0, squares, 1.0))

    @cached_property
    def _slopes(self) -> list[_Slopes]:
        made: list[_Slopes] = []
        for block, jacobian in zip(self.blocks, self.jacobians, strict=True):
            J = jacobian * self._unit
            Z = self._along(block, 0.0, np.eye(block.y.shape[1]))
            own = sum(at.noise.size for at in made) + np.arange(block.y.size)
            noise = own.reshape(block.y.shape) if block.noise is None else block.noise
            made.append(_Slopes(J, Z * self._levels(block)[:, None], noise))
        return made

    @cached_property
    def _bends(self) -> list[Float[Array, "n m s s"]]:
        # second derivatives, by parameters and noises, s = p + d
        made = []
        for block, at in zip(self.blocks, self._slopes, strict=True):
            (n, d), p = block.y.shape, len(self.theta)
            # ways that move the rows by about one, and the way back from them
            size = 1.0 / np.sqrt(
                np.mean(self._along(block, 0.0, np.eye(d)) ** 2, (0, 1))
            )
            ways = np.diag(np.concatenate([self._unit * np.sqrt(n), size]))
            back = np.concatenate(
                [np.full((n, p), n**-0.5), self._levels(block) / size], axis=1
            )
            bend = np.zeros((p + d, n, at.J.shape[1], p + d))
            for way, each in zip(_STEP * ways, bend, strict=True):
                for k, weight in _FIRST.items():
                    there = k * way[:p], k * way[p:]
                    each += self._along(block, ways[:, :p], ways[:, p:], there) * (
                        weight / _STEP
                    )
            bend = np.moveaxis(bend, 0, -1)
            bend = (bend + bend.mT) / 2.0
            made.append(bend * back[:, None, :, None] * back[:, None, None, :])
        return made

    def _along(
        self, block: Block, by_theta: Any, by_y: Any, at: tuple[Any, Any] = (0.0, 0.0)
    ) -> Float[Array, "n m w"]:
        """Derivatives of a block's rows along directions of parameters and readings."""
        step = by_y[:, None] if np.ndim(by_y) else by_y
        theta = np.atleast_2d(self.theta + at[0] + 1j * _TINY * by_theta)
        y = block.y + at[1] + 1j * _TINY * step
        rows = block.rows(theta, y if y.ndim == 3 else y[None])
        return np.moveaxis(rows.imag / _TINY, 0, -1)

    def _levels(self, block: Block) -> Float[Array, "n d"]:
        # noise of each reading over the least of all, where there is any
        return block.sigma / self._least if self._least else np.ones(block.sigma.shape)

    @cached_property
    def _count(self) -> int:
        return 1 + max(int(at.noise.max()) for at in self._slopes)

    @cached_property
    def _shared(self) -> bool:
        return any(block.noise is not None for block in self.blocks)

    @cached_property
    def _wide(self) -> list[Float[Array, "n m z"]]:
        # Z of each block by all the noises
        count, made = self._count, []
        for at in self._slopes:
            wide = np.zeros((*at.Z.shape[:2], count))
            places = np.broadcast_to(at.noise[:, None], at.Z.shape)
            np.put_along_axis(wide, places, at.Z, axis=2)
            made.append(wide)
        return made

    @cached_property
    def _V(self) -> list[Array]:
        # of each block alone, or of all rows where they share noises
        if not self._shared:
            return [at.Z @ at.Z.mT for at in self._slopes]
        Z = np.concatenate([wide.reshape(-1, wide.shape[-1]) for wide in self._wide])
        return [Z @ Z.T]

    def _solve(self, rows: list[Array]) -> list[Array]:
        # V^-1 times rows of each block, (n, m, q)
        if not self._shared:
            return [np.linalg.solve(*pair) for pair in zip(self._V, rows, strict=True)]
        flat = [r.reshape(-1, r.shape[-1]) for r in rows]
        ends = np.cumsum([len(r) for r in flat])[:-1]
        parts = np.split(np.linalg.solve(self._V[0], np.concatenate(flat)), ends)
        return [part.reshape(r.shape) for part, r in zip(parts, rows, strict=True)]

    @cached_property
    def _VJ(self) -> list[Float[Array, "n m p"]]:
        return self._solve([at.J for at in self._slopes])

    def _weigh(self, rows: list[Array]) -> list[Array]:
        return rows if self.weights == "none" else self._solve(rows)

    @cached_property
    def _WJ(self) -> list[Float[Array, "n m p"]]:
        return self._weigh([at.J for at in self._slopes])

    @cached_property
    def _WZ(self) -> list[Float[Array, "n m d"]]:
        # by the noises that each block sees
        if not self._shared:
            return self._weigh([at.Z for at in self._slopes])
        places = [np.broadcast_to(at.noise[:, None], at.Z.shape) for at in self._slopes]
        both = zip(self._weigh(self._wide), places, strict=True)
        return [np.take_along_axis(wide, place, axis=2) for wide, place in both]

    @cached_property
    def _inverse(self) -> Float[Array, "p p"]:
        # of H
        return inverse_of(self._squared(self._WJ))

    def _squared(self, weighed: list[Array]) -> Float[Array, "p p"]:
        parts = zip(self._slopes, weighed, strict=True)
        return np.asarray(sum(np.einsum("nmp,nmq->pq", at.J, w) for at, w in parts))

    @cached_property
    def _moved(self) -> Float[Array, "z p"]:
        pushed = np.zeros((self._count, len(self.theta)))
        for at, WJ in zip(self._slopes, self._WJ, strict=True):
            np.add.at(pushed, at.noise, np.einsum("nmd,nmp->ndp", at.Z, WJ))
        return -pushed @ self._inverse


_RANK: Final = 1e-10  # of the greatest eigenvalue, columns of equal length


def rank_of(information: Float[Array, "p p"]) -> int:
    """Number of parameter combinations that an information determines."""
    scale = np.sqrt(np.diagonal(information))
    scale = np.where(scale > 0.0, scale, 1.0)
    values = np.linalg.eigvalsh(information / np.outer(scale, scale))
    return int(np.count_nonzero(values > _RANK * values[-1]))


def inverse_of(information: Float[Array, "p p"]) -> Float[Array, "p p"]:
    """Inverse of an information, with columns scaled to equal length."""
    scale = np.sqrt(np.diagonal(information))
    whole = np.linalg.inv(information / np.outer(scale, scale))
    return (whole + whole.T) / 2.0 / np.outer(scale, scale)
