r"""Named geometries: test cases from the literature on Wahba's problem.

``markley 1`` to ``markley 12`` are the twelve cases of Markley (1993), "Attitude
determination using vector observations: a fast optimal matrix algorithm": one
attitude, two or three references, noise of 1e-6 or 0.01 for each axis: of one size,
unequal, and of vectors 0.01 rad apart. ``unequal 2`` and ``unequal 3`` are two and
three vectors, one of 1 arcsecond and the others of 1 degree and almost opposite to it:
the kind of extreme case in which Cheng and Shuster (2007), "Robustness and accuracy of
the QUEST algorithm", find the expanded characteristic polynomial to lose all digits.
Their numbers are ours, not those of a published table.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Final, NamedTuple

import numpy as np
from pydantic import AfterValidator

from simval.arrays import Array, frozen
from simval.errors import InputError
from simval.geometry import normalize
from simval.shapes import Float

TRUTH: Final = frozen([0.96, 0.0, 1.728, 2.304])
"""Of all, times 4 s with s the scalar part: the quaternion of the attitude matrix

[[0.352, 0.864, 0.36], [-0.864, 0.152, 0.48], [0.36, -0.48, 0.8]].
"""
SECOND: Final = float(np.deg2rad(1.0 / 3600.0))  # one arcsecond, rad
DEGREE: Final = float(np.deg2rad(1.0))  # rad
ORTHOGONAL: Final = (1, 0, 0), (0, 1, 0), (0, 0, 1)
CLOSE: Final = (1, 0, 0), (1, 0.01, 0), (1, 0, 0.01)
NEAR: Final = (1, 0, 0), (0.96, 0.28, 0), (0.96, 0, 0.28)
TURNED: Final = (0.6, 0.8, 0), (0.8, -0.6, 0)
OPPOSITE: Final = (1, 0, 0), (-0.99712, 0.07584, 0), (-0.99712, -0.07584, 0)


class NamedGeometry(NamedTuple):
    """References of a test case, with the noise of each body vector."""

    references: tuple[tuple[float, float, float], ...]
    std: tuple[float, ...]

    @property
    def settings(self) -> dict[str, float | int | str]:
        """Parameters of a cell that the test case sets."""
        most = max(self.std)
        relative = [f"{std / most:.6g}" for std in self.std]
        noise = "body" if min(self.std) == most else " ".join(
            [*relative, *["0"] * len(self.std)]
        )  # fmt: skip
        return {"vectors": len(self.std), "noise_std": most, "noise": noise}


GEOMETRIES: Final[Mapping[str, NamedGeometry]] = MappingProxyType(
    {
        f"markley {k}": NamedGeometry(references[: len(std)], std)
        for k, (references, std) in enumerate(
            (
                (ORTHOGONAL, (1e-6, 1e-6, 1e-6)),
                (ORTHOGONAL, (1e-6, 1e-6)),
                (ORTHOGONAL, (0.01, 0.01, 0.01)),
                (ORTHOGONAL, (0.01, 0.01)),
                (TURNED, (1e-6, 0.01)),
                (CLOSE, (1e-6, 1e-6, 1e-6)),
                (CLOSE, (1e-6, 1e-6)),
                (CLOSE, (0.01, 0.01, 0.01)),
                (CLOSE, (0.01, 0.01)),
                (NEAR, (1e-6, 0.01, 0.01)),
                (NEAR, (1e-6, 0.01)),
                (NEAR, (0.01, 1e-6)),
            ),
            start=1,
        )
    }
    | {
        "unequal 2": NamedGeometry(OPPOSITE[:2], (SECOND, DEGREE)),
        "unequal 3": NamedGeometry(OPPOSITE, (SECOND, DEGREE, DEGREE)),
    }
)


def named_geometry(name: str) -> tuple[Float[Array, "4"], Float[Array, "k 3"]]:
    """True quaternion (reference to body) and unit references of a test case."""
    return normalize(TRUTH), normalize(
        np.array(GEOMETRIES[name].references, dtype=float)
    )


def _known(name: str) -> str:
    if name not in GEOMETRIES:
        msg = f"`geometry` is {name:.60}; give a number, or {', '.join(GEOMETRIES)}"
        raise InputError(msg)
    return name


GeometryName = Annotated[str, AfterValidator(_known)]
"""A named test case."""
