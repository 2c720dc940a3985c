"""The symmetric Gauss-Newton derivation, entry by entry, against sympy."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import sympy as sp

from errata.claim import ILLEGIBLE, MISPRINTED, RIGHT, WORDING, add, claim

SOURCE = "symmetric"
of = claim(SOURCE)
DATA = Path(__file__).parents[1] / "data" / "symmetric_derivation.txt"
PARAMETERS = ["k11", "k12", "k13", "k22", "k23", "k33", "bx", "by", "bz"]
RAW = ["ax", "ay", "az"]

add(SOURCE, "A, B and E stand for two things each, k for a sample and a step", WORDING)
add(SOURCE, "A to F are used a line before what they stand for", WORDING)
add(
    SOURCE,
    "gradient, in matrices: the transposed one is 9 x N, printed N x 1 †",
    WORDING,
)
add(SOURCE, "gradient, as a sum: 9 x 1, printed 9 x N †", ILLEGIBLE)
add(SOURCE, "Hessian in matrices", ILLEGIBLE)
add(
    SOURCE,
    "second derivatives: of most the label in x, of some both, garbled †",
    WORDING,
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
