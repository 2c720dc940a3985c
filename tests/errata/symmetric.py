"""The symmetric Gauss-Newton derivation, entry by entry, against sympy."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import sympy as sp

from errata.claim import (
    FALSE,
    ILLEGIBLE,
    MISPRINTED,
    RIGHT,
    add,
    claim,
    claims,
    unevaluated,
)

SOURCE = "symmetric"
of = claim(SOURCE)
DATA = Path(__file__).parents[1] / "data" / "symmetric_derivation.txt"
PARAMETERS = ["k11", "k12", "k13", "k22", "k23", "k33", "bx", "by", "bz"]
RAW = ["ax", "ay", "az"]

unevaluated(
    SOURCE,
    "A, B and E stand for two things each, k for a sample and a step",
    "A to F are used a line before what they stand for",
    "gradient, in matrices: the transposed one is 9 x N, printed N x 1 †",
)
unevaluated(
    SOURCE,
    "gradient, as a sum: 9 x 1, printed 9 x N †",
    "Hessian in matrices",
    verdict=ILLEGIBLE,
)
unevaluated(
    SOURCE, "second derivatives: of most the label in x, of some both, garbled †"
)


@cache
def lines():
    """The printed lines: place, (formula, what it is said to equal)."""
    text = DATA.read_text(encoding="utf-8").splitlines()
    split = [line.partition(": ") for line in text if not line.startswith("#")]
    return {place: tuple(rest.split(" = ")) for place, _, rest in split}


@cache
def derivatives():
    """e and its derivatives of first and second order by sympy, as functions."""
    k11, k12, k13, k22, k23, k33, *b = x = sp.symbols(PARAMETERS)
    a, g = sp.symbols(RAW), sp.Symbol("g")
    K = sp.Matrix([[k11, k12, k13], [k12, k22, k23], [k13, k23, k33]])
    h = K * (sp.Matrix(a) - sp.Matrix(b))
    e = (h.T * h)[0] - g**2
    first = [sp.diff(e, one) for one in x]
    second = [[sp.diff(d, one) for one in x] for d in first]
    return sp.lambdify([*x, *a, g], [e, first, second], "numpy")


def problem(rng):
    """Random values of every symbol, and e with its derivatives there."""
    names = [*PARAMETERS, *RAW, "g"]
    values = dict(zip(names, rng.uniform(0.5, 2.0, len(names)), strict=True))
    e, first, second = derivatives()(*values.values())
    for bar in "xyz":
        values[bar] = values[f"a{bar}"] - values[f"b{bar}"]
    k11, k12, k13, k22, k23, k33 = (values[name] for name in PARAMETERS[:6])
    K = np.array([[k11, k12, k13], [k12, k22, k23], [k13, k23, k33]])
    A, D, F, _, B, E, *_, C = (K @ K).ravel()
    values |= {"A": A, "B": B, "C": C, "D": 2 * D, "E": 2 * E, "F": 2 * F}
    values["P"] = np.nan  # stands nowhere else in the text
    return values, e, np.array(first), np.array(second)


def value(text, values):
    """A printed formula at these values; factors stand side by side."""
    tokens = re.findall(r"k\d\d|\d|[A-Za-z]|\^\d|[-+()/]", text)
    out = ""
    for token in tokens:
        if out and not re.search(r"[-+(/]$", out) and not re.match(r"[-+)/^]", token):
            out += "*"
        out += token.replace("^", "**")
    return eval(out, {"__builtins__": {}}, values)  # the text is our own data file


def entry(place, e, first, second):
    """The true value of a place: e, d7, 35."""
    number = place.rstrip("+")
    if number == "e":
        return e
    if number[0] == "d":
        return first[int(number[1]) - 1]
    return second[int(number[0]) - 1, int(number[1]) - 1]


def said(place, values, e, first, second):
    """What the text says that a place equals: an entry or a form."""
    text = lines()[place][1]
    if text.isdigit():
        return entry(text, e, first, second)
    return value(text, values)


# place: what it should be, † where the extraction may be to blame
WRONG = {
    "e+": "e",
    "d7+": "-2((k11^2+k12^2+k13^2)x+1/2Dy+1/2Fz)",
    "d9": "-2(1/2Fx+1/2Ey+Cz)",
    "d9+": "-2(1/2Fx+1/2Ey+(k13^2+k23^2+k33^2)z)",
    "13+": "2(zx)",
    "35+": "2(xy)",
    "39": "-2((k11+k33)x+k12y+2k13z)",
    "55+": "2(y^2+z^2)",
    "76": "-2(k13z)",
    "77": "2(k11^2+k12^2+k13^2)",
    "99": "2C",
}
WRONG["e+"] = lines()["e+"][0].replace("k33)zy", "k33)zx")
MARKED = {"d9", "99", "13+", "35+", "55+"}
SAID_WRONG = {
    "25": "13",
    "35+": "12",
}  # the latter is of the wrong value, and equals 35


def wrong_claim(place):
    """The claim of one misprinted formula."""

    def evaluate(rng):
        values, *true = problem(rng)
        truth = entry(place, *true)
        printed = np.nan_to_num(value(lines()[place][0], values))
        right = value(WRONG[place], values)
        return truth, printed, right

    return evaluate


def right_claim(places):
    """The claim that all these formulas, and what they are said to equal, are right."""

    def evaluate(rng):
        values, *true = problem(rng)
        truth, printed = [], []
        for place in places:
            truth.append(entry(place, *true))
            printed.append(value(lines()[place][0], values))
            if len(lines()[place]) == 2 and place not in SAID_WRONG:
                truth.append(entry(place, *true))
                printed.append(said(place, values, *true))
        return truth, printed

    return evaluate


def title(place):
    """How the page names a place."""
    again = ", second print" if place.endswith("+") else ""
    if place == "e+":
        return "e, written out"
    number = place.rstrip("+")
    kind = "first derivative" if number[0] == "d" else "second derivative"
    return f"{kind} {' '.join(number.lstrip('d'))}{again}"


def enter():
    """One claim for each wrong formula, one for the right ones of each row."""
    for place in WRONG:
        mark = " †" if place in MARKED else ""
        name = "symmetric_" + place.replace("+", "_again")
        add(SOURCE, title(place) + mark, MISPRINTED, wrong_claim(place), name)
    fine = [place for place in lines() if place not in WRONG]
    heads = {"e": "e, by its forms", "d": "first derivatives"}
    heads |= {str(i): f"second derivatives, row {i}" for i in range(1, 10)}
    for head, words in heads.items():
        places = [p for p in fine if p[0] == head]
        marks = " ".join(p.lstrip("d").replace("+", "'") for p in places if p != "e")
        place = f"{words}: {marks}" if marks else words
        add(SOURCE, place, RIGHT, right_claim(places), f"symmetric_row_{head}")


enter()

# label as printed, what it is of
LABELS = {
    "d6": "k23",
    "d9": "by",
    "36": "k13 k23",
    "38": "k13 k13",
    "39": "k13 by",
    "46": "k22 k23",
    "65": "k33 k22",
    "69": "k33 by",
    "86": "by k23",
    "96": "bz k23",
    "98": "bz bz",
}


def label_claim(place, label):
    """The claim that the derivative is by what its label says."""
    index = [PARAMETERS.index(name) + 1 for name in label.split()]
    named = "d" * (len(index) == 1) + "".join(map(str, index))

    def evaluate(rng):
        values, *true = problem(rng)
        truth = value(WRONG.get(place, lines()[place][0]), values)
        printed = entry(named, *true)
        right = entry(place, *true)
        return truth, printed, right

    return evaluate


for _place, _label in LABELS.items():
    add(
        SOURCE,
        f"{title(_place)}: labelled {_label} †",
        MISPRINTED,
        label_claim(_place, _label),
        f"symmetric_label_{_place}",
    )


@of("second derivative 2 5: said to equal 1 2", MISPRINTED)
def symmetric_25_said(rng):
    values, *true = problem(rng)
    truth = entry("25", *true)
    printed = said("25", values, *true)
    right = said("25+", values, *true)
    return truth, printed, right


# The symmetric Gauss-Newton derivation: model, update and stop rule.


@claims(
    SOURCE,
    symmetric_model="A_real = K (A_measure - B), K the inverse of S, both symmetric",
)
def model(rng):
    S = rng.uniform(0.1, 0.3, (3, 3))
    S, true, bias = S + S.T + np.eye(3), rng.standard_normal(3), rng.standard_normal(3)
    x, y, z = S @ true + bias - bias
    (k11, k12, k13), (_, k22, k23), (_, _, k33) = np.linalg.inv(S)
    symmetric_model = (
        true,
        [
            k11 * x + k12 * y + k13 * z,
            k12 * x + k22 * y + k23 * z,
            k13 * x + k23 * y + k33 * z,
        ],
    )
    return locals()


def residuals(rng):
    """e and its gradients and Hessians over twelve samples."""
    names = [*PARAMETERS, *RAW, "g"]
    values = rng.uniform(0.5, 2.0, len(names))
    found = []
    for _ in range(12):
        values[9:12] = rng.uniform(-2.0, 2.0, 3)
        found.append(derivatives()(*values))
    return [np.array(part) for part in zip(*found, strict=True)]


@claims(
    SOURCE,
    symmetric_gradient="gradient of the cost: 2 (grad e)' e",
    symmetric_hessian="Hessian of the cost, before terms are left out",
    symmetric_update="update by the sums of grad e' grad e and e grad e'",
    symmetric_newton=(
        "update of Newton, its Hessian without the second derivatives of e"
    ),
    symmetric_update_division=(
        "update, last line: a vector divided by a matrix",
        MISPRINTED,
    ),
    symmetric_stop_rule=("stop rule, where a parameter is near zero", FALSE),
    symmetric_stop_rule_elsewhere="stop rule, where no parameter is near zero",
)
def step(rng):
    e, J, H = residuals(rng)
    symmetric_gradient = (
        sum(2 * one * row for one, row in zip(e, J, strict=True)),
        2 * J.T @ e,
    )
    # the cost is the sum of e^2: by the product rule on each sample of a quadratic in t
    v = rng.standard_normal(9)
    squared = sum(
        np.polynomial.Polynomial([one, row @ v, v @ h @ v / 2]) ** 2
        for one, row, h in zip(e, J, H, strict=True)
    )
    symmetric_hessian = (
        squared.coef[2],
        v @ (J.T @ J + np.einsum("k,kij->ij", e, H)) @ v,
    )
    least = -np.linalg.lstsq(J, e, rcond=None)[0]
    gradient, hessian = 2 * J.T @ e, 2 * J.T @ J
    symmetric_update = least, -np.linalg.solve(J.T @ J, J.T @ e)
    symmetric_newton = least, -np.linalg.solve(hessian, gradient)
    symmetric_update_division = (
        least,
        -(J.T @ e) / (J.T @ J),
        -np.linalg.solve(J.T @ J, J.T @ e),
    )
    # steps that halve towards 0, the typical size of the parameter being 1
    x, last = 0.5**60, 0.5**59
    symmetric_stop_rule = (
        True,  # it has converged
        abs(2 * (x - last) / (x + last)) < 1e-6,
        abs(2 * (x - last)) / max(abs(x + last), 1.0) < 1e-6,
    )
    x, last = 1 + x, 1 + last
    symmetric_stop_rule_elsewhere = True, abs(2 * (x - last) / (x + last)) < 1e-6
    return locals()
