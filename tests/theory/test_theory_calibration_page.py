"""Every number of docs/theory_calibration.md, from the definitions."""

import re
from itertools import product

import numpy as np
import pytest
from places import ROOT

from simval.poses import fibonacci_sphere, observability

PAGE = (ROOT / "docs" / "theory_calibration.md").read_text(encoding="utf-8")
G = 9.81


def rows(heading):
    """Cells of the table whose first column is called so, by the first cell."""
    table = PAGE.partition(f"| {heading} |")[2].partition("\n\n")[0]
    cells = [[c.strip() for c in line.split("|")[1:-1]] for line in table.splitlines()]
    return {first: rest for first, *rest in cells[2:]}


def number(text):
    return float(text.replace("−", "-"))


def fisher_bound(directions):
    """Bound in units of the noise, by inverting the matrix with all directions.

    Readings y = (T K)^-1 g u + B of an ideal sensor, by nine parameters and two angles
    a pose: T lower triangular, its derivative at the identity is minus a unit matrix.
    """
    n = len(directions)
    J = np.zeros((3 * n, 9 + 2 * n))
    for i, u in enumerate(directions):
        block = J[3 * i : 3 * i + 3]
        for k, (row, column) in enumerate(((1, 0), (2, 0), (2, 1))):
            block[row, k] = -G * u[column]
        block[:, 3:6] = -G * np.diag(u)
        block[:, 6:9] = np.eye(3)
        along = np.linalg.svd(u[None])[2][1:]  # two directions across u
        block[:, 9 + 2 * i : 11 + 2 * i] = G * along.T
    return np.linalg.inv(J.T @ J)[:9, :9]


SETS = {
    "12 over the sphere": fibonacci_sphere(12),
    "40 over the sphere": fibonacci_sphere(40),
    "100 over the sphere": fibonacci_sphere(100),
    "40 over its upper half": fibonacci_sphere(80)[fibonacci_sphere(80)[:, 2] > 0],
}


@pytest.mark.parametrize("name", SETS)
def test_the_table_of_the_bound(name):
    sd = np.sqrt(np.diag(fisher_bound(SETS[name])))
    mean = [G * sd[:3].mean(), G * sd[3:6].mean(), sd[6:].mean()]
    mean.append(observability(SETS[name]).condition)
    # printed to two decimals
    assert [number(cell) for cell in rows("poses")[name]] == pytest.approx(
        mean, abs=0.005
    )


def quadrature(sigma):
    """Rule for noise in three dimensions, exact to degree eleven."""
    x, w = np.polynomial.hermite_e.hermegauss(6)
    points = sigma * np.array(list(product(x, repeat=3)))
    return points, np.array(list(product(w / w.sum(), repeat=3))).prod(axis=1)


def cost(residual, k, squares, k_of_weight=None):
    """Term of the sum that an estimate minimises, of readings with these squares."""
    c = (1 + k) ** 2 * squares - 1
    weight = k if residual == "sampson" else k_of_weight
    q = (1 + weight) ** 4 * squares
    if residual == "squared":
        return c**2 / 2
    if residual == "norm":
        return 2 * (np.sqrt(1 + c) - 1) ** 2
    return c**2 / (8 * q)


@pytest.mark.parametrize("residual", ["squared", "norm", "weighted", "sampson"])
def test_the_ladder(residual):
    """The minimum itself, by Newton from differences, of the mean over the noise.

    Shares no derivative with the page. The next order is some tens of sigma^2 = 1e-4,
    and what the differences leave is h^2 over sigma^2 = 1e-4.
    """
    sigma, h = 0.01, 1e-4
    noise, weights = quadrature(sigma)
    squares = np.sum((noise + np.array([0.0, 0.6, 0.8])) ** 2, axis=1)
    k = 0.0
    for _ in range(20):
        ahead, here, back = (
            weights @ cost(residual, k + step, squares, k) for step in (h, 0.0, -h)
        )
        k -= (ahead - back) / (2 * h) / ((ahead - 2 * here + back) / h**2)
    rung = number(rows("residual")[residual][3])
    assert k / sigma**2 == pytest.approx(rung, abs=5e-3)


def test_the_columns_of_the_ladder():
    """The last is minus the second over the third; the second is that of the first."""
    moments = {"c": 3.0, "c^2": 4.0}
    for psi, mean, slope, rung in rows("residual").values():
        assert number(rung) == pytest.approx(-number(mean) / number(slope))
        terms = re.findall(r"(-?\s*)(\d|\\frac12)(c(?:\^2)?)", psi.partition(",")[0])
        value = sum(
            (-1 if "-" in sign else 1) * (0.5 if "frac" in size else float(size))
            * moments[power]
            for sign, size, power in terms
        )  # fmt: skip
        assert value == pytest.approx(number(mean))


def test_faces_of_a_cube_have_rank_six():
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    assert observability(faces).rank == 6


def test_half_a_sphere_costs_the_bias_a_factor_of_four():
    whole = number(rows("poses")["40 over the sphere"][2])
    half = number(rows("poses")["40 over its upper half"][2])
    assert half / whole == pytest.approx(4.0, abs=0.05)
