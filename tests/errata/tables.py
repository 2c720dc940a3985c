"""Peng and Choukroun, section 5: the element tables of Terms 1 to 6, exactly.

Each element is held against the moment of its definition, `E{u^3 x_2 q_1}` for 21 of
Term 2, by Isserlis' theorem. A claim of a misprinted item is: with every other item put
right and this one as printed, some element is not what it should be. Below the diagonal
Term 2's moments repeat the elements above it: their items are held against what they
repeat, and that they repeat it is a misprint of its own.
"""

import re
from collections import Counter
from functools import cache

from errata.claim import MISPRINTED, RIGHT, add, unevaluated
from errata.polynomials import INDICES, Q, R, U, X, elements, isserlis, printed, times

SOURCE = "quaternion"
TABLES = printed()
unevaluated(SOURCE, "section 5, Term 5: no elements are printed")


def term_2(i, j):
    """Element of Term 2 before the mean is taken."""
    return times(U, U, U, X[i], Q[j])


def repeated(i, j):
    """The moment that Term 2's table has there: the one above the diagonal."""
    return isserlis(term_2(min(i, j), max(i, j)))


def legible(polynomial):
    """Its items that are printed in Term 6's products, put right; then it repeats."""
    seen = elements(put_right("term 6, products"))[0, 0]
    return Counter({names: polynomial[names] for names in seen})


# table: element by its definition (00 for a term with one); for items, what they repeat
FORMS = {
    "term 1, products": lambda i, j: times(U, U, X[i], X[j]),
    "term 2, products": term_2,
    "term 3, products": lambda i, j: times(R, X[i], X[j]),
    "term 4, products": lambda i, j: times(R, R),
    "term 6, products": lambda i, j: legible(times(U, U, U, U)),
    "term 3, moments": lambda i, j: isserlis(times(R, X[i], X[j])),
    "term 1, moments": lambda i, j: isserlis(times(U, U, X[i], X[j])),
    "term 2, moments": repeated,
    "term 4, moments": lambda i, j: isserlis(times(R, R)),
    "term 6, moments": lambda i, j: isserlis(times(U, U, U, U)),
}


BELOW = [(i, j) for i, j in INDICES if i > j]

# table: misprinted elements, † where the extraction may be to blame
ELEMENTS = {
    "term 1, products": {(2, 4): " †"},
    "term 2, products": dict.fromkeys([(2, 1), (4, 1), (4, 2), (4, 3)], ""),
    "term 3, products": {},
    "term 3, moments": {(1, 4): "", (4, 1): "", (3, 2): " †"},
    "term 4, products": {},
}

_PAIRS = "(s12s34+s13s24+{})".format
_FACTORS = {
    "q2^2q3q4": "12 21",
    "q1q2q3q4": "11 22 33",
    "q2q3^2q4": "13 31",
    "q1q3^2q4": "23 32",
    "q2q3q4^2": "14 41",
    "q1q3q4^2": "24 42",
    "q1q2q4^2": "34 43",
}
# table: {printed item: (right one, the elements where it is printed)}
ITEMS = {
    "term 1, moments": {
        "2q3q4(s3^2s14+2s13s14)": ("2q3q4(s3^2s14+2s13s34)", "13"),
        "3q2^2s2^2s23+3q4^2s4^2s24": ("3q2^2s2^2s24+3q4^2s4^2s24", "24 42"),
        "2q3q4(s2^2s14+2s13s14)": ("2q3q4(s3^2s14+2s13s34)", "31"),
        "2q3q4(s2^2s24+2s23s34)": ("2q3q4(s3^2s24+2s23s34)", "32"),
        "2q3q4(s4^2s23+2s24s34)": ("2q3q4(s4^2s13+2s14s34)", "14 41"),
    },
    "term 2, moments": {
        f"6{factor}{_PAIRS('s12s34')}": (f"6{factor}{_PAIRS('s14s23')}", where)
        for factor, where in _FACTORS.items()
    }
    | {
        "9q2^2q3q4(s2^2s34+2s23s24)": ("6q2^2q3q4(s2^2s34+2s23s24)", "22"),
        "3q1q3^3(s13s3^2+2s13s23)": ("3q1q3^3(s12s3^2+2s13s23)", "23 32"),
        "3q2q3q4^2(s2^2s4^2+2s12^2)": ("3q2q3q4^2(s2^2s4^2+2s24^2)", "23 32"),
        # the coefficients of these two neighbours are exchanged
        "6q2^2q3q4(s2^2s3^2+2s23^2)": ("3q2^2q3q4(s2^2s3^2+2s23^2)", "34 43"),
        "3q2q3q4^2(s24s3^2+2s23s34)": ("6q2q3q4^2(s24s3^2+2s23s34)", "34 43"),
    },
    "term 4, moments": {"3s1^2+3s2^2+3s3^2+3s4^2": ("3s1^4+3s2^4+3s3^4+3s4^4", "00")},
    # the extraction may be to blame: the moments have them right
    "term 6, products": {
        "6q1^2q3^2x1^2x2^2": ("6q1^2q3^2x1^2x3^2", "00"),
        "12q1q2q3x1x2x3^2": ("12q1q2q3^2x1x2x3^2", "00"),
        "4q2^2q3x2^3x3^2": ("4q2^3q3x2^3x3", "00"),
        "12q1q2^2q3x1x2^2x3^2": ("12q1q2^2q3x1x2^2x3", "00"),
    },
    "term 6, moments": {
        "12q1q3^3s2^2s12": ("12q1q2^3s2^2s12", "00"),
        "12q1q3^2s3^2s13": ("12q1q3^3s3^2s13", "00"),
        "24(s12s34+s13s24+s14s23)": ("24q1q2q3q4(s12s34+s13s24+s14s23)", "00"),
    },
}
# table: (the item that is not there, its element, its claim, place)
MISSING = {
    "term 2, moments": (
        "6q1q2q3q4(s12s34+s13s24+s14s23)",
        "44",
        "term_2_moments_44",
        "element 44, its last item, which is not there †",
    ),
    # an item is in its place that breaks off, 12q2q3^2q4(s3^2s24
    "term 6, moments": (
        "12q2^3q4s2^2s24",
        "00",
        "term_6_open_bracket",
        "an item with an open bracket †",
    ),
}


def put_right(table, *without):
    """The items of a table, the misprinted and missing ones put right but some."""
    items = list(TABLES[table])
    for wrong, (right, where) in ITEMS.get(table, {}).items():
        for ij in () if wrong in without else where.split():
            items[items.index(f"{ij}: {wrong}")] = f"{ij}: {right}"
    item, ij, *_ = MISSING.get(table, ("", ""))
    return items + ([f"{ij}: {item}"] if item and item not in without else [])


def sums(table, places, *without):
    """Those elements of a table, each the sum of its items."""
    found = elements(put_right(table, *without))
    return [found[ij] for ij in places]


@cache
def truths(table, places):
    """These elements of a table as they should be."""
    return [FORMS[table](*ij) for ij in places]


def without_claim(table, wrong):
    """The claim that a table is wrong with this item as printed, or not printed."""
    places = tuple(sorted(elements(TABLES[table])))

    def evaluate(rng):
        truth = truths(table, places)
        printed = sums(table, places, wrong)
        right = sums(table, places)
        return truth, printed, right

    return evaluate


def right_claim(table, places):
    """The claim that these elements are right, but for the misprinted items."""

    def evaluate(rng):
        printed = sums(table, places)
        return truths(table, places), printed

    return evaluate


def element_claim(table, form, ij):
    """The claim that an element is not of its form, all of its items put right."""

    def evaluate(rng):
        truth = form(*ij)
        printed = sums(table, [ij])[0]
        right = form(*ij)
        return truth, printed, right

    return evaluate


def enter(table, place, verdict, evaluate, name=""):
    """Enter a claim of a table; nothing in it is random."""
    place = f"section 5, T{table[1:]}{place}"
    name = name or table.replace(", ", "_").replace(" ", "_")
    add(SOURCE, place, verdict, evaluate, name, seeds=1)


def enter_items(table):
    """Each misprinted item, what is missing or repeated, and all other items."""
    name, wrong = table.replace(", ", "_").replace(" ", "_"), 0
    for k, (item, (_, where)) in enumerate(ITEMS[table].items(), 1):
        wrong += len(where.split())
        place = f": `{item}`" + f" in {where.replace(' ', ' and ')}" * (where != "00")
        place += " †" * (table == "term 6, products")
        enter(table, place, MISPRINTED, without_claim(table, item), f"{name}_i{k}")
    if table in MISSING:
        item, _, own, place = MISSING[table]
        enter(table, f": {place}", MISPRINTED, without_claim(table, item), own)
    for i, j in BELOW if table == "term 2, moments" else ():
        evaluate = element_claim(table, lambda *ij: isserlis(term_2(*ij)), (i, j))
        place = f": element {i}{j}, a copy of {j}{i}"
        enter(table, place, MISPRINTED, evaluate, f"{name}_{i}{j}")
    places = tuple(sorted(elements(TABLES[table])))
    rest = f": {len(TABLES[table]) - wrong} other items"
    enter(table, rest, RIGHT, right_claim(table, places))


def enter_elements(table):
    """Each misprinted element of a table, and all others."""
    name = table.replace(", ", "_").replace(" ", "_")
    for (i, j), mark in ELEMENTS[table].items():
        evaluate = element_claim(table, FORMS[table], (i, j))
        enter(table, f": element {i}{j}{mark}", MISPRINTED, evaluate, f"{name}_{i}{j}")
    others = tuple(sorted(set(elements(TABLES[table])) - set(ELEMENTS[table])))
    rest = f": {len(others)} other elements" if len(others) > 1 else ""
    enter(table, rest, RIGHT, right_claim(table, others))


# letters of the items of Term 2's products 31 and 32, whose powers are lost: they are
# those of 13 and 23, and of 31 and 32 each has q1 or q2, and x3
LETTERS = {
    (3, 1): "q1q3x1 q2q3x1x2 q1q2q3x1x2 q3x1x3 q1q3x1x3 q2q3x1x2x3 q3q4x1x4",
    (3, 2): "q2q3x2 q1q2q3x1x2 q1q3x1x2 q3x2x3 q2q3x2x3 q1q2q3x1x2x3 q3q4x2x4",
}


def letters_claim(i, j):
    """The claim that the items of an element have the letters that are read of it."""

    def every(items):
        return [all(one in names for names in items) for one in (f"q{j}", f"x{i}")]

    def evaluate(rng):
        truth = [True, True]
        printed = every([re.findall(r"..", item) for item in LETTERS[i, j].split()])
        right = every(times(U, U, U, X[i], Q[j]))
        return truth, printed, right

    return evaluate


for _i, _j in LETTERS:
    _place = f": letters of element {_i}{_j}, a copy of {_j}{_i}"
    _name = f"term_2_products_{_i}{_j}"
    enter("term 2, products", _place, MISPRINTED, letters_claim(_i, _j), _name)
for _table in ITEMS:
    enter_items(_table)
for _table in ELEMENTS:
    enter_elements(_table)
