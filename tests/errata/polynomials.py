"""Exact polynomial algebra: the printed element tables, products, Isserlis' theorem."""

import re
from collections import Counter, defaultdict
from functools import cache
from pathlib import Path

DATA = Path(__file__).parents[1] / "data" / "peng_choukroun_terms.txt"
INDICES = [(i, j) for i in range(1, 5) for j in range(1, 5)]


def printed():
    """The tables as printed, by name, a list of items "12: ..." each."""
    tables, name = {}, ""
    for line in DATA.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            name = line[1:-1].removesuffix(" of x")
            tables[name] = []
        elif not line.startswith("#"):
            tables[name].append(line if line[2:4] == ": " else f"00: {line}")
    return tables


@cache
def parse(text):
    """A sum of products as {sorted factors: coefficient}; s1^2 is the variance s11."""
    total, depth, start = Counter(), 0, 0
    pieces = []
    for i, ch in enumerate(text + "+"):
        depth += (ch == "(") - (ch == ")")
        if ch == "+" and depth == 0:
            pieces.append(text[start:i])
            start = i + 1
    for piece in pieces:
        head, _, tail = piece.partition("(")
        number, names = re.fullmatch(r"(\d*?)((?:[qxs]\d+(?:\^\d)?)*)", head).groups()
        factors = []
        for kind, index, power in re.findall(r"([qxs])(\d+)(?:\^(\d))?", names):
            count = int(power or 1)
            if kind == "s":
                count //= 3 - len(index)  # s1^2 is one covariance, s12 is one too
                index = "".join(sorted(index * (3 - len(index))))
            factors += [kind + index] * count
        inner = parse(tail[:-1]) if tail else {(): 1}
        for names, value in inner.items():
            total[tuple(sorted([*factors, *names]))] += int(number or 1) * value
    return total


def times(*polynomials):
    """Product of polynomials."""
    result = Counter({(): 1})
    for polynomial in polynomials:
        product = Counter()
        for a, x in result.items():
            for b, y in polynomial.items():
                product[tuple(sorted(a + b))] += x * y
        result = product
    return result


def isserlis(polynomial):
    """Mean of a quartic: that of x_a x_b x_c x_d is the sum over three pairings."""
    total = Counter()
    for names, value in polynomial.items():
        a, b, c, d = (name[1] for name in names if name[0] == "x")
        rest = [name for name in names if name[0] != "x"]
        for pairs in ((a + b, c + d), (a + c, b + d), (a + d, b + c)):
            moments = ["s" + "".join(sorted(pair)) for pair in pairs]
            total[tuple(sorted(rest + moments))] += value
    return total


Q = {i: Counter({(f"q{i}",): 1}) for i in range(1, 5)}
X = {i: Counter({(f"x{i}",): 1}) for i in range(1, 5)}
U = Counter({(f"q{i}", f"x{i}"): 1 for i in range(1, 5)})  # q'x
R = Counter({(f"x{i}", f"x{i}"): 1 for i in range(1, 5)})  # x'x


def elements(items):
    """Items "12: ..." summed by their indices; 00 where a term has one element."""
    found = defaultdict(Counter)
    for item in items:
        found[int(item[0]), int(item[1])].update(parse(item[4:]))
    return found
