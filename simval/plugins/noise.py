r"""Noise of each observed vector, in the form that an estimator asks for.

A shape gives the covariance of each vector for a `noise_std` of 1, body vectors first,
each in its own frame; the noise of a cell is the shape times :math:`\sigma^2`.

===========  ===================================================================
``body``     each body vector 1 per axis; references exact
``all``      body and reference vectors 1 per axis
``tangent``  each body vector 1 per axis across it, none along it; references
             exact
``unequal``  the first body vector 0.1 per axis, the others 1; references exact
``general``  each body vector a covariance of its own, axes at random and
             standard deviations of 0.1 to 1 along them; references exact
===========  ===================================================================

or standard deviations of b1, b2, ..., r1, r2, ... as words (``"1 3 0 0"``), or as many
3 x 3 covariances as JSON.
"""

import json
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from simval.arrays import Array, outer
from simval.errors import InputError
from simval.shapes import Float

NAMED: Final = ("body", "all", "tangent", "unequal", "general")

UNEQUAL: Final = 0.1
"""Noise of the first body vector over that of the others, of ``unequal``."""

GREATEST: Final = 1e4
"""Of a relative standard deviation; the least that is not 0 is its inverse."""

EXTREME: Final = 100.0
"""Ratio of two vectors' noise beyond which first order says little: the square of the
greater is then as large as the smaller, and weights lose eight digits at 1e4."""

READABLE: Final = ("noise_std", "weights", "covariances")
"""What an estimator may be handed."""


Vectors = list[Float[Array, "n 3"]]
"""Of n samples: body vectors, then as many reference vectors."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VectorNoise:
    """Independent Gaussian noise of k body and k reference vectors."""

    unit: Float[Array, "m 3 3"]  # covariances for a noise_std of 1
    tangent: bool = False  # nothing of it along each vector
    noise_std: float = 1.0

    def at(self, noise_std: float) -> "VectorNoise":
        """The same noise at another size."""
        return replace(self, noise_std=noise_std)

    def small(self, noise_std: float) -> "VectorNoise":
        """The same noise, scaled so that no vector has more than a stated size."""
        return self.at(noise_std / max(1.0, self.relative.max()))

    @property
    def relative(self) -> Float[Array, " m"]:
        """Standard deviation per axis for a size of 1, averaged over the axes."""
        return np.sqrt(np.linalg.trace(self.unit) / 3.0)

    @property
    def std(self) -> Float[Array, " m"]:
        """Standard deviation per axis of each vector."""
        return self.noise_std * self.relative

    @property
    def noisy(self) -> list[int]:
        """Mask of the vectors that have noise."""
        return [i for i, std in enumerate(self.relative) if std > 0.0]

    @property
    def weights(self) -> Float[Array, " k"]:
        """Weight of each pair: one over the sum of its variances."""
        return 1.0 / np.sum(self.std.reshape(2, -1) ** 2, axis=0)

    @property
    def isotropic(self) -> bool:
        """True if the noise of each vector is isotropic."""
        sizes = self.relative[:, None, None] ** 2 * np.eye(3)
        return not self.tangent and np.array_equal(self.unit, sizes)

    @property
    def extreme(self) -> bool:
        """True if one vector is a hundred times less noisy than another."""
        sizes = self.relative[self.noisy]
        return bool(sizes.max() > EXTREME * sizes.min())

    @property
    def exact_references(self) -> bool:
        """True if no reference vector has noise."""
        return not self.unit[len(self.unit) // 2 :].any()

    @property
    def one_number(self) -> bool:
        """True if one number says it all: every noisy vector has 1 per axis."""
        eye = np.eye(3)
        return all(np.array_equal(self.unit[i], eye) for i in self.noisy)

    def covariances(self, vectors: Vectors) -> Float[Array, "n m 3 3"]:
        """Covariance of each vector, given the vectors' values."""
        scaled = self.noise_std**2 * self.unit
        if not self.tangent:
            return np.broadcast_to(scaled, (len(vectors[0]), *scaled.shape))
        v = np.stack(vectors, axis=1)
        along = v / np.linalg.norm(v, axis=2, keepdims=True)
        return scaled @ (np.eye(3) - outer(along, along))

    def roots(self, vectors: Vectors) -> Float[Array, "n m 3 3"]:
        """Symmetric root of each covariance, which turns normal numbers into noise."""
        values, axes = np.linalg.eigh(self.covariances(vectors))
        scaled = axes * np.sqrt(np.maximum(values, 0.0))[..., None, :]
        return scaled @ axes.mT

    def read(self, reads: tuple[str, ...], vectors: Vectors) -> dict[str, Array]:
        """The noise in the forms that an estimator reads."""
        known = {"noise_std": self.std, "weights": self.weights}
        if "covariances" in reads:
            known["covariances"] = self.covariances(vectors).copy()
        return {word: known[word] for word in reads}


def vector_noise(text: str, vectors: int = 2, noise_std: float = 1.0) -> VectorNoise:
    """Noise by the name of its shape, by standard deviations, or by covariances."""
    words = text.split()
    if len(words) == 1 and words[0] in NAMED:
        return replace(_named(words[0], vectors), noise_std=noise_std)
    unit = _matrices(text) if text.lstrip().startswith("[") else _isotropic(words, text)
    if len(unit) != 2 * vectors:
        msg = (
            f"`noise` is {text:.60}: it is of {len(unit)} vectors; {vectors} body and "
            f"{vectors} reference vectors need {2 * vectors}"
        )
        raise InputError(msg)
    _require_sizes(unit, text)
    return VectorNoise(unit=unit, noise_std=noise_std)


def _named(name: str, k: int) -> VectorNoise:
    references = np.ones(k) if name == "all" else np.zeros(k)
    body = np.ones(k)
    if name == "unequal":
        body[0] = UNEQUAL
    unit = np.append(body, references)[:, None, None] ** 2 * np.eye(3)
    if name == "general":
        rng = np.random.default_rng(20_270)
        axes = np.linalg.qr(rng.standard_normal((k, 3, 3)))[0]
        variances = 10.0 ** rng.uniform(-2.0, 0.0, (k, 3))
        skew = axes @ (variances[:, :, None] * axes.mT)
        unit[:k] = (skew + skew.mT) / 2.0
    return VectorNoise(unit=unit, tangent=name == "tangent")


def _isotropic(words: list[str], text: str) -> Float[Array, "m 3 3"]:
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.zeros(0)
    if not len(numbers):
        msg = (
            f"`noise` is {text:.60}; it must be one of {', '.join(NAMED)}, or standard "
            'deviations relative to `noise_std`, such as "1 3 0 0" of b1, b2, r1, r2, '
            "or as many 3 x 3 covariances in JSON"
        )
        raise InputError(msg)
    if not np.all(numbers >= 0.0):
        msg = f"`noise` is {text:.60}; standard deviations must be 0 or more"
        raise InputError(msg)
    capped = np.minimum(numbers, 1e100)  # whose squares are numbers, and refused
    return capped[:, None, None] ** 2 * np.eye(3)


def _matrices(text: str) -> Float[Array, "m 3 3"]:
    try:
        value = np.array(json.loads(text), dtype=float)
    except (ValueError, TypeError, RecursionError):
        value = np.zeros(0)
    if value.ndim != 3 or value.shape[1:] != (3, 3):
        msg = (
            f"`noise` is {text:.60}; in JSON it must be a list of 3 x 3 covariances, "
            "one of each vector, body vectors first"
        )
        raise InputError(msg)
    if not np.array_equal(value, value.mT):
        msg = f"`noise` is {text:.60}; its covariances must be symmetric"
        raise InputError(msg)
    return value


def _require_sizes(unit: Float[Array, "m 3 3"], text: str) -> None:
    """Check that each vector has noise in every direction, or none if a reference."""
    finite = np.isfinite(unit).all()
    variances = np.linalg.eigvalsh(unit) if finite else np.full((len(unit), 3), np.nan)
    exact = (np.arange(len(unit)) >= len(unit) // 2) & ~unit.any(axis=(1, 2))
    least, most = variances[:, 0], variances[:, -1]
    if not np.all(exact | ((least >= GREATEST**-2) & (most <= GREATEST**2))):
        msg = (
            f"`noise` is {text:.60}; relative to `noise_std` the standard deviation of "
            f"each vector must be {1 / GREATEST:g} to {GREATEST:g} in every direction; "
            "only a reference may have none at all"
        )
        raise InputError(msg)
