"""Peng and Choukroun, section 5: the element tables of Terms 1 to 6, exactly.

A claim of a misprint is one item: with every other item put right, and this one as
printed, the sum is not the one that Isserlis' theorem gives.
"""

from errata.claim import MISPRINTED, RIGHT, WORDING, add
from errata.polynomials import (
    INDICES,
    Q,
    R,
    U,
    X,
    corrected,
    elements,
    isserlis,
    parse,
    printed,
    times,
    total,
)

SOURCE = "quaternion"
TABLES = printed()
add(SOURCE, "section 5, Term 5: no elements are printed", WORDING)

# printed: (right, how often)
TERM_1 = {
    "2q3q4(s3^2s14+2s13s14)": ("2q3q4(s3^2s14+2s13s34)", 1),
    "3q2^2s2^2s23+3q4^2s4^2s24": ("3q2^2s2^2s24+3q4^2s4^2s24", 2),
    "2q3q4(s2^2s14+2s13s14)": ("2q3q4(s3^2s14+2s13s34)", 1),
    "2q3q4(s2^2s24+2s23s34)": ("2q3q4(s3^2s24+2s23s34)", 1),
    "2q3q4(s4^2s23+2s24s34)": ("2q3q4(s4^2s13+2s14s34)", 2),
}
_PAIRS = "(s12s34+s13s24+{})".format
_FACTORS = {
    "q2^2q3q4": 2,
    "q1q2q3q4": 3,
    "q2q3^2q4": 2,
    "q1q3^2q4": 2,
    "q2q3q4^2": 2,
    "q1q3q4^2": 2,
    "q1q2q4^2": 2,
}
TERM_2 = {
    f"6{factor}{_PAIRS('s12s34')}": (f"6{factor}{_PAIRS('s14s23')}", count)
    for factor, count in _FACTORS.items()
} | {
    "9q2^2q3q4(s2^2s34+2s23s24)": ("6q2^2q3q4(s2^2s34+2s23s24)", 1),
    "3q1q3^3(s13s3^2+2s13s23)": ("3q1q3^3(s12s3^2+2s13s23)", 2),
    "3q2q3q4^2(s2^2s4^2+2s12^2)": ("3q2q3q4^2(s2^2s4^2+2s24^2)", 2),
    # the coefficients of these two neighbours are exchanged
    "6q2^2q3q4(s2^2s3^2+2s23^2)": ("3q2^2q3q4(s2^2s3^2+2s23^2)", 2),
    "3q2q3q4^2(s24s3^2+2s23s34)": ("6q2q3q4^2(s24s3^2+2s23s34)", 2),
}
TERM_4 = {"3s1^2+3s2^2+3s3^2+3s4^2": ("3s1^4+3s2^4+3s3^4+3s4^4", 1)}
TERM_6 = {
    "12q1q3^3s2^2s12": ("12q1q2^3s2^2s12", 1),
    "12q1q3^2s3^2s13": ("12q1q3^3s3^2s13", 1),
    "24(s12s34+s13s24+s14s23)": ("24q1q2q3q4(s12s34+s13s24+s14s23)", 1),
}
# not in the extracted text: a last line of element 33 or 44 of Term 2; printed as an
# item with an open bracket in Term 6, 12q2q3^2q4(s3^2s24
LOST_2 = {"": ("6q1q2q3q4(s12s34+s13s24+s14s23)", 1)}
LOST_6 = {"": ("12q2^3q4s2^2s24", 1)}


def low_high(i, j):
    """Term 2's tables repeat below the diagonal what stands above."""
    return times(U, U, U, X[min(i, j)], Q[max(i, j)])


MOMENTS = {
    1: (total(isserlis(times(U, U, X[i], X[j])) for i, j in INDICES), TERM_1, {}),
    2: (total(isserlis(low_high(i, j)) for i, j in INDICES), TERM_2, LOST_2),
    4: (isserlis(times(R, R)), TERM_4, {}),
    6: (isserlis(times(U, U, U, U)), TERM_6, LOST_6),
}


def item_claim(term, wrong):
    """The claim of one misprinted item."""
    truth, corrections, lost = MOMENTS[term]
    items = TABLES[f"term {term}, moments"]
    others = {k: v for k, v in corrections.items() if k != wrong}

    def evaluate(rng):
        printed = corrected(items, others | lost)
        right = corrected(items, corrections | lost)
        return truth, printed, right

    return evaluate


def enter_moments():
    """Every misprinted item of the sums, and the rest."""
    for term, (_, corrections, _) in MOMENTS.items():
        items = TABLES[f"term {term}, moments"]
        wrong = sum(count for _, count in corrections.values())
        for k, (item, (_, count)) in enumerate(corrections.items(), 1):
            times_ = "" if count == 1 else f", {count} times"
            place = f"section 5, Term {term}, moments: `{item}`{times_}"
            name = f"term_{term}_moments_{k}"
            add(SOURCE, place, MISPRINTED, item_claim(term, item), name, seeds=1)
        place = f"section 5, Term {term}, moments: {len(items) - wrong} other items"
        add(SOURCE, place, RIGHT, others_claim(term), f"term_{term}_moments", seeds=1)


def term_6_open_bracket(rng):
    """An item that breaks off, where another belongs."""
    truth, corrections, lost = MOMENTS[6]
    items = TABLES["term 6, moments"]
    printed = corrected(items, corrections)
    right = corrected(items, corrections | lost)
    return truth, printed, right


def others_claim(term):
    """The claim that all items but the misprinted ones are right."""
    truth, corrections, lost = MOMENTS[term]

    def evaluate(rng):
        printed = corrected(TABLES[f"term {term}, moments"], corrections | lost)
        return truth, printed

    return evaluate


def element_claims(table, name, form, wrong):
    """One claim for each misprinted element of a table, one for the others."""
    count = len(TABLES[table])

    def one(ij):
        def evaluate(rng):
            printed = elements(TABLES[table])[ij]
            right = form(*ij)
            return form(*ij), printed, right

        return evaluate

    def others(rng):
        found = elements(TABLES[table])
        rest = sorted(set(found) - set(wrong))
        printed = [found[ij] for ij in rest]
        return [form(*ij) for ij in rest], printed

    title = f"section 5, {table[0].upper()}{table[1:]}"
    for (i, j), mark in wrong.items():
        place = f"{title}: element {i}{j}{mark}"
        add(SOURCE, place, MISPRINTED, one((i, j)), f"{name}_{i}{j}", seeds=1)
    place = f"{title}: {count - len(wrong)} other elements"
    add(SOURCE, place, RIGHT, others, name, seeds=1)


enter_moments()
add(
    SOURCE,
    "section 5, Term 6, moments: an item with an open bracket †",
    MISPRINTED,
    term_6_open_bracket,
    "term_6_open_bracket",
    seeds=1,
)
element_claims(
    "term 1, products of x",
    "term_1_products",
    lambda i, j: times(U, U, X[i], X[j]),
    {(2, 4): " †"},
)
element_claims(
    "term 2, products of x",
    "term_2_products",
    lambda i, j: times(U, U, U, X[i], Q[j]),
    dict.fromkeys([(2, 1), (4, 1), (4, 2), (4, 3)], ""),
)
element_claims(
    "term 3, moments",
    "term_3_moments",
    lambda i, j: isserlis(times(R, X[i], X[j])),
    {(1, 4): "", (4, 1): "", (3, 2): " †"},
)


def term_4_products(rng):
    """Term 4 before the mean is taken."""
    printed = parse(TABLES["term 4, products of x"][0])
    return times(R, R), printed


add(
    SOURCE,
    "section 5, Term 4, products of x",
    RIGHT,
    term_4_products,
    "term_4_products",
    seeds=1,
)
