"""Peng and Choukroun, section 5: the element tables of Terms 1 to 6, exactly.

Each element is held against the moment of its definition, `E{u^3 x_2 q_1}` for 21 of
Term 2, by Isserlis' theorem. A claim of a misprinted item is: with every other item put
right and this one as printed, some element is not what it should be. Below the diagonal
Term 2's moments repeat the elements above it: their items are held against what they
repeat, and that they repeat it is a misprint of its own.
"""

from functools import cache

from errata.claim import MISPRINTED, RIGHT, WORDING, add
from errata.polynomials import (
    INDICES,
    Q,
    R,
    U,
    X,
    elements,
    isserlis,
    printed,
    times,
)

SOURCE = "quaternion"
TABLES = printed()
add(SOURCE, "section 5, Term 5: no elements are printed", WORDING)


def term_2(i, j):
    """Element of Term 2 before the mean is taken."""
    return times(U, U, U, X[i], Q[j])


def repeated(i, j):
    """The moment that Term 2's table has there: the one above the diagonal."""
    return isserlis(term_2(min(i, j), max(i, j)))


# table: element by its definition (00 for a term with one); for items, what they repeat
FORMS = {
    "term 1, products": lambda i, j: times(U, U, X[i], X[j]),
    "term 2, products": term_2,
    "term 4, products": lambda i, j: times(R, R),
    "term 3, moments": lambda i, j: isserlis(times(R, X[i], X[j])),
    "term 1, moments": lambda i, j: isserlis(times(U, U, X[i], X[j])),
    "term 2, moments": repeated,
    "term 4, moments": lambda i, j: isserlis(times(R, R)),
    "term 6, moments": lambda i, j: isserlis(times(U, U, U, U)),
}


@cache
def truths(table):
    """Every element of a table as it should be, in order."""
    return [FORMS[table](*ij) for ij in sorted(elements(TABLES[table]))]


BELOW = [(i, j) for i, j in INDICES if i > j]

# table: misprinted elements, † where the extraction may be to blame
ELEMENTS = {
    "term 1, products": {(2, 4): " †"},
    "term 2, products": dict.fromkeys([(2, 1), (4, 1), (4, 2), (4, 3)], ""),
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
    "term 4, moments": {
        "3s1^2+3s2^2+3s3^2+3s4^2": ("3s1^4+3s2^4+3s3^4+3s4^4", "00"),
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
    for wrong, (right, where) in ITEMS[table].items():
        for ij in () if wrong in without else where.split():
            items[items.index(f"{ij}: {wrong}")] = f"{ij}: {right}"
    item, ij, *_ = MISSING.get(table, ("", ""))
    return items + ([f"{ij}: {item}"] if item and item not in without else [])


def sums(table, places, *without):
    """Those elements of a table, each the sum of its items."""
    found = elements(put_right(table, *without))
    return [found[ij] for ij in places]


def without_claim(table, wrong):
    """The claim that a table is wrong with this item as printed, or not printed."""

    def evaluate(rng):
        places = sorted(elements(TABLES[table]))
        truth = truths(table)
        printed = sums(table, places, wrong)
        right = sums(table, places)
        return truth, printed, right

    return evaluate


def items_claim(table):
    """The claim that all items but the misprinted ones are right."""

    def evaluate(rng):
        places = sorted(elements(TABLES[table]))
        printed = sums(table, places)
        return truths(table), printed

    return evaluate


def repeated_claim(ij):
    """The claim that an element of Term 2 is another's, as in its products."""

    def evaluate(rng):
        truth = isserlis(term_2(*ij))
        printed = sums("term 2, moments", [ij])[0]
        right = isserlis(times(U, U, U, X[ij[0]], Q[ij[1]]))
        return truth, printed, right

    return evaluate


def element_claim(table, ij):
    """The claim of a misprinted element of a table with one item an element."""

    def evaluate(rng):
        truth = FORMS[table](*ij)
        printed = elements(TABLES[table])[ij]
        right = FORMS[table](*ij)
        return truth, printed, right

    return evaluate


def elements_claim(table, places):
    """The claim that these elements are right."""

    def evaluate(rng):
        found = elements(TABLES[table])
        printed = [found[ij] for ij in places]
        return [FORMS[table](*ij) for ij in places], printed

    return evaluate


def enter(table, place, verdict, evaluate, name):
    """Enter a claim of a table; nothing in it is random."""
    place = f"section 5, T{table[1:]}{place}"
    add(SOURCE, place, verdict, evaluate, name, seeds=1)


for _table, _items in ITEMS.items():
    _name = _table.replace(", ", "_").replace(" ", "_")
    _wrong = sum(len(where.split()) for _, where in _items.values())
    for _k, (_item, (_, _where)) in enumerate(_items.items(), 1):
        _in = "" if _where == "00" else f" in {_where.replace(' ', ' and ')}"
        _place = f": `{_item}`{_in}"
        enter(
            _table, _place, MISPRINTED, without_claim(_table, _item), f"{_name}_i{_k}"
        )
    if _table in MISSING:
        _item, _, _own, _place = MISSING[_table]
        enter(_table, f": {_place}", MISPRINTED, without_claim(_table, _item), _own)
    if _table == "term 2, moments":
        for _i, _j in BELOW:
            _place = f": element {_i}{_j}, a copy of {_j}{_i}"
            enter(
                _table,
                _place,
                MISPRINTED,
                repeated_claim((_i, _j)),
                f"{_name}_{_i}{_j}",
            )
    _rest = f": {len(TABLES[_table]) - _wrong} other items"
    enter(_table, _rest, RIGHT, items_claim(_table), _name)
for _table, _elements in ELEMENTS.items():
    _name = _table.replace(", ", "_").replace(" ", "_")
    for (_i, _j), _mark in _elements.items():
        _place = f": element {_i}{_j}{_mark}"
        enter(
            _table,
            _place,
            MISPRINTED,
            element_claim(_table, (_i, _j)),
            f"{_name}_{_i}{_j}",
        )
    _others = sorted(set(elements(TABLES[_table])) - set(_elements))
    _rest = f": {len(_others)} other elements" if len(_others) > 1 else ""
    enter(_table, _rest, RIGHT, elements_claim(_table, _others), _name)
