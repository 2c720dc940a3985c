"""Operations of one attitude from two pairs, counted by numbers that count.

A count is a fact about the code and its branches, not about a machine: the same
everywhere, so a test holds it (`test_races.py`), and no study draws for it. Time is
what the race `one attitude` measures, side by side.
"""

import sys
from collections import Counter
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from places import EXAMPLES

from simval.arrays import Array
from simval.geometry import attitude_matrix, normalize, random_quaternions
from simval.imu.attitude import kernel
from simval.shapes import Float

sys.path.insert(0, str(EXAMPLES))
import optimal

COUNT, NOISE = 200, 0.01
COLUMNS = ("+ -", "x", "/", "sqrt")


class Counted:
    """A real number whose arithmetic is counted; comparisons and signs are free."""

    __slots__ = ("value",)
    done: ClassVar[Counter[str]] = Counter()

    def __init__(self, value: Any) -> None:
        self.value = value.value if isinstance(value, Counted) else float(value)

    def sqrt(self) -> "Counted":
        """Root, as NumPy asks for it."""
        return self**0.5

    def __pow__(self, power: float) -> "Counted":
        assert power == 0.5
        Counted.done["sqrt"] += 1
        return Counted(self.value**0.5)

    def __neg__(self) -> "Counted":
        return Counted(-self.value)

    def __abs__(self) -> "Counted":
        return Counted(abs(self.value))

    def __gt__(self, other: Any) -> bool:
        return self.value > Counted(other).value

    def __lt__(self, other: Any) -> bool:
        return self.value < Counted(other).value

    def __ge__(self, other: Any) -> bool:
        return self.value >= Counted(other).value


def _operation(kind: str, swapped: bool, work: Callable[[float, float], float]) -> Any:
    def counted(self: Counted, other: Any) -> Counted:
        x, y = self.value, Counted(other).value
        if not (kind == "+ -" and 0.0 in (x, y) and type(other) is not Counted):
            Counted.done[kind] += 1  # a sum's first 0 is none
        return Counted(work(y, x) if swapped else work(x, y))

    return counted


for name, kind, work in (
    ("add", "+ -", lambda x, y: x + y),
    ("sub", "+ -", lambda x, y: x - y),
    ("mul", "x", lambda x, y: x * y),
    ("truediv", "/", lambda x, y: x / y),
):
    setattr(Counted, f"__{name}__", _operation(kind, False, work))
    setattr(Counted, f"__r{name}__", _operation(kind, True, work))


def problems(
    count: int = COUNT, noise: float = NOISE
) -> list[tuple[Float[Array, "4"], Float[Array, "4 3"]]]:
    """True quaternions, and b1, b2, r1, r2 of length 1 with noise."""
    rng = np.random.default_rng(35)
    q, r = random_quaternions(count, rng), normalize(rng.standard_normal((count, 2, 3)))
    b = np.einsum("nij,nkj->nki", attitude_matrix(q), r)
    b = normalize(b + noise * rng.standard_normal(b.shape))
    return list(zip(q, np.concatenate([b, r], axis=1), strict=True))


def _kernel(frame: str) -> Callable[..., Any]:
    """The package's own code of a block, on one column of numbers that count."""

    def estimate(*vectors: Any) -> Any:
        block = np.array(vectors, dtype=object).reshape(12, 1)
        if frame == "plain":
            raw = kernel.raw_quaternion(block, frame)
        else:
            columns = kernel.column_matrix(block, symmetric=frame == "combined")
            chosen = {
                "best": kernel.best_quaternion, "combined": kernel.combined_quaternion
            }  # fmt: skip
            raw = chosen[frame](columns)
        return (raw * (1.0 / np.sqrt(kernel.squared_norm(raw))))[:, 0]

    return estimate


def _weighted(method: Callable[..., Any]) -> Callable[..., Any]:
    half = Counted(0.5)
    return lambda *vectors: method(*vectors, half, half)


TURNING = ("closed form", "EULER-2", "QUEST", "ESOQ2")
FRAMES = ("plain", "best", "combined")
METHODS = {f"closed form, {frame}": _kernel(frame) for frame in FRAMES} | {
    f"{name}, turned if near" if name in TURNING else name: _weighted(method)
    for name, method in optimal.METHODS.items()
}


def counts(name: str, count: int = COUNT) -> list[Counter[str]]:
    """Operations of each problem, normalised vectors given."""
    found = []
    for _, vectors in problems(count):
        Counted.done = Counter()
        METHODS[name](*([Counted(x) for x in v] for v in vectors.tolist()))
        found.append(Counted.done)
    return found


def table() -> str:
    """Operations of each method: median problem, the least and the most."""
    lines = [f"{'':28}{'all':>6}{'least':>7}{'most':>6}  " + "".join(
        f"{column:>6}" for column in COLUMNS
    )]  # fmt: skip
    for name in METHODS:
        found = sorted(counts(name), key=Counter.total)
        middle = found[len(found) // 2]
        lines.append(
            f"{name:28}{middle.total():6}{found[0].total():7}{found[-1].total():6}  "
            + "".join(f"{middle[column]:6}" for column in COLUMNS)
        )
    return "\n".join(lines)
