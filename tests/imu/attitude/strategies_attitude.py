"""Problems drawn from the whole singular set of the two-vector estimator."""

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from simval.geometry import attitude_matrix, normalize

KINDS = ("identity", "about r1", "about r2", "in the plane", "about the normal", "any")
OFFSETS = (0.0, 1e-300, 1e-15, 1e-12, 1e-9, 1e-6, 1e-3)


@dataclass(frozen=True)
class Problem:
    q: np.ndarray
    vectors: np.ndarray  # b1, b2, r1, r2, (4, 3)

    @property
    def sine(self):
        return float(np.linalg.norm(np.cross(self.vectors[2], self.vectors[3])))


unit_numbers = st.floats(-1.0, 1.0, allow_nan=False, width=32)
directions = (
    st.tuples(unit_numbers, unit_numbers, unit_numbers)
    .filter(lambda v: np.linalg.norm(v) > 0.1)
    .map(lambda v: normalize(np.array(v)))
)


@st.composite
def problems(draw):
    """An attitude on, near or off the singular set, in a drawn reference frame."""
    r1 = draw(directions)
    other = draw(directions.filter(lambda v: np.linalg.norm(np.cross(v, r1)) > 0.1))
    across = normalize(other - (other @ r1) * r1)
    # from a right angle to nearly collinear, both ways
    angle = draw(st.sampled_from([1.0, 1.5707963, 2.5, 1e-2, 1e-4, 3.1414]))
    r2 = np.cos(angle) * r1 + np.sin(angle) * across
    normal = np.cross(r1, across)
    kind = draw(st.sampled_from(KINDS))
    turn = draw(st.floats(0.0, 6.25, width=32))
    axis = {
        "identity": normal,
        "about r1": r1,
        "about r2": r2,
        "in the plane": np.cos(turn) * r1 + np.sin(turn) * across,
        "about the normal": normal,
        "any": draw(directions),
    }[kind]
    half = draw(st.sampled_from([0.0, np.pi / 2, 0.5, 1.2, -0.7, np.pi / 4]))
    half = 0.0 if kind == "identity" else half
    offset = draw(st.sampled_from(OFFSETS))
    axis = normalize(axis + offset * draw(directions))
    half = half + draw(st.sampled_from([-1.0, 0.0, 1.0])) * offset
    q = np.append(np.sin(half) * axis, np.cos(half))
    A = attitude_matrix(q)
    return Problem(q, np.stack([A @ r1, A @ r2, r1, r2]))
