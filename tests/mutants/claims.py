"""Damages each claim of tests/errata and sees its test fail.

A test of an erratum must fail when there is none. For each claim that is not right the
printed form takes the place of the right one, and the right one that of the printed.
Every right form is damaged too, one operator, index, name or number at a time, and so
are the printed tables, one item at a time.

    PYTHONPATH=tests python tests/mutants/claims.py [--every N] [NAME ...]

Prints the survivors that are not in `claims_kept.toml`; exits with 1 if there are any.
"""

import argparse
import ast
import copy
import inspect
import sys
import textwrap
import tomllib
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from errata import symmetric, tables
from errata.claim import CLAIMS, RIGHT, Claim, check

# vectors and numbers of the same kind, one taken for the other
TWINS = {"b1": "b2", "r1": "r2", "d1": "d2", "s1": "s2", "q1": "q2", "e1": "e2"}
TWINS |= {twin: name for name, twin in TWINS.items()}

KEPT = Path(__file__).with_name("claims_kept.toml")  # no faults, with reasons


def listed() -> list[dict[str, str]]:
    """Damaged forms that say the same, or what is as true: claim, form, why."""
    kept = tomllib.loads(KEPT.read_text(encoding="utf-8"))["kept"]
    return [one | {"form": form} for one in kept for form in one["forms"]]


@cache
def source_of(evaluate: Any) -> str:
    """The text of an evaluation."""
    return textwrap.dedent(inspect.getsource(evaluate))


def function_of(claim: Claim) -> ast.FunctionDef:
    """The source of a claim's evaluation, or of its group's, without decorators."""
    function = ast.parse(source_of(claim.group or claim.evaluate)).body[0]
    assert isinstance(function, ast.FunctionDef)
    function.decorator_list = []
    return function


Place = tuple[str, int | None]  # a field, and where in it if it is a list


def assigned(function: ast.FunctionDef, name: str) -> ast.Assign:
    """The one assignment to a name."""
    found = [
        node
        for node in ast.walk(function)
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name
    ]
    assert len(found) == 1, f"{function.name} has {len(found)} assignments to {name}"
    return found[0]


def form(claim: Claim, function: ast.FunctionDef, name: str) -> tuple[ast.AST, Place]:
    """Where a claim's `printed` or `right` stands in its function."""
    if claim.group is None:
        return assigned(function, name), ("value", None)
    value = assigned(function, claim.name).value
    assert isinstance(value, ast.Tuple)
    return value, ("elts", 1 if name == "printed" else 2)


def compiled(claim: Claim, function: ast.FunctionDef) -> Any:
    """A damaged evaluation, in the place of the one in the claim."""
    original: Any = claim.group or claim.evaluate
    free = original.__code__.co_freevars
    cells = [cell.cell_contents for cell in original.__closure__ or ()]
    body = ast.unparse(function)
    outer = f"def outer({', '.join(free)}):\n{textwrap.indent(body, '    ')}\n"
    outer += f"    return {function.name}\n"
    names = dict(original.__globals__)
    exec(outer, names)
    damaged = names["outer"](*cells)
    return damaged if claim.group is None else lambda rng: damaged(rng)[claim.name]


Damaged = tuple[str, ast.FunctionDef]  # the form with its fault, and its function


def exchanged(claim: Claim) -> Iterator[Damaged]:
    """The printed form for the right one, and the right one for the printed."""
    for taken, given in (("printed", "right"), ("right", "printed")):
        function = function_of(claim)
        node = copy.deepcopy(at(*form(claim, function, given)))
        put(*form(claim, function, taken), node)
        yield ast.unparse(node), function


def damaged(claim: Claim) -> Iterator[Damaged]:
    """The right form with one fault each, taken out again before the next."""
    assert claim.evaluate is not None
    read = claim.group is None and claim.evaluate.__code__.co_freevars
    if claim.verdict == RIGHT and read:
        return  # its form is read from a table: see `data_survivors`
    function = function_of(claim)
    where = form(claim, function, "printed" if claim.verdict == RIGHT else "right")
    spared = {id(node) for node in harmless(at(*where))}
    for owner, place, node in [(*where, at(*where)), *nodes(at(*where))]:
        for fault in () if id(node) in spared else faults(node):
            put(owner, place, fault)
            yield ast.unparse(at(*where)), function
        put(owner, place, node)


def nodes(tree: ast.AST) -> Iterator[tuple[ast.AST, Place, ast.AST]]:
    """Every node below a tree with its owner and its place there."""
    for owner in list(ast.walk(tree)):
        for field, value in ast.iter_fields(owner):
            if isinstance(value, ast.AST):
                yield owner, (field, None), value
            elif isinstance(value, list):
                for i, one in enumerate(value):
                    yield owner, (field, i), one


def at(owner: ast.AST, place: Place) -> Any:
    """The node at a place of its owner."""
    field, index = place
    value = getattr(owner, field)
    return value if index is None else value[index]


def put(owner: ast.AST, place: Place, node: ast.AST) -> None:
    """Put a node at a place of its owner."""
    field, index = place
    if index is None:
        setattr(owner, field, node)
    else:
        getattr(owner, field)[index] = node


def harmless(tree: ast.AST) -> list[ast.AST]:
    """Limits that are ours, and cross products of which the length alone counts."""
    found: list[ast.AST] = []
    for node in ast.walk(tree):
        match node:
            case ast.Compare():
                found += [x for x in ast.walk(node) if isinstance(x, ast.Constant)]
            case ast.keyword(arg="tol", value=limit):
                found.append(limit)
            case ast.Call(func=ast.Attribute(attr="norm") | ast.Name(id="vanishes")):
                found += node.args
    return found


def faults(node: ast.AST) -> list[ast.AST]:
    """What one may misprint for this node."""
    match node:
        case ast.BinOp(left=a, op=ast.Add(), right=b):
            return [ast.BinOp(a, ast.Sub(), b), a, b]
        case ast.BinOp(left=a, op=ast.Sub(), right=b):
            return [ast.BinOp(a, ast.Add(), b), a, ast.UnaryOp(ast.USub(), b)]
        case ast.UnaryOp(op=ast.USub(), operand=a):
            return [a]
    return misread(node)


def misread(node: ast.AST) -> list[ast.AST]:
    """What one may misread for a number, a name or a product."""
    match node:
        case ast.Constant(value=bool()):
            return []
        case ast.Constant(value=int() | float() as number):
            return [ast.Constant(number + 1)]
        case ast.Attribute(value=a, attr=name) if name in TWINS:
            return [ast.Attribute(a, TWINS[name], ast.Load())]
        case ast.Name(id=name) if name in TWINS:
            return [ast.Name(TWINS[name], ast.Load())]
        case ast.Call(func=ast.Attribute(attr="cross"), args=[a, b]):
            return [ast.Call(node.func, [b, a], [])]
    return []


def table_faults() -> Iterator[tuple[str, str, list[str]]]:
    """(claim, table, its items with one of them wrong)."""
    for key, items in tables.TABLES.items():
        name = key.replace(", ", "_").replace(" ", "_")
        for i, item in enumerate(items):
            ij = int(item[0]), int(item[1])
            if ij not in tables.ELEMENTS.get(key, ()):
                yield name, key, [*items[:i], f"{item}+q1", *items[i + 1 :]]


def line_faults() -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """(claim, line of the symmetric derivation, the line with a fault)."""
    for key, (formula, *said) in symmetric.lines().items():
        if key in symmetric.WRONG:
            name = "symmetric_" + key.replace("+", "_again")
            yield name, key, (symmetric.WRONG[key],)
        else:
            for wrong in (f"{formula}+xy", f"-1({formula})+z"):
                yield f"symmetric_row_{key[0]}", key, (wrong, *said)


def killed(claim: Claim, evaluate: Any = None) -> bool:
    """Whether the test of a claim sees a fault."""
    try:
        with np.errstate(all="ignore"):
            check(claim, evaluate)
    except Exception:  # a form that cannot be evaluated is seen too
        return True
    return False


def survivors(names: list[str], every: int) -> Iterator[tuple[str, str]]:
    """Faults that no test sees, each `every`-th one tried."""
    number = 0
    for name in names:
        claim = CLAIMS[name]
        exchanges = () if claim.verdict == RIGHT else exchanged(claim)
        for changed, function in chain(exchanges, damaged(claim)):
            number += 1
            tried = number % every == 0
            if tried and not killed(claim, compiled(claim, function)):
                yield name, changed


def data_survivors(every: int) -> Iterator[tuple[str, str]]:
    """Faults of the printed tables that the claim of their table does not see."""
    found = [(tables.TABLES, *fault) for fault in table_faults()]
    found += [(symmetric.lines(), *fault) for fault in line_faults()]
    for table, name, key, wrong in found[::every]:
        before, table[key] = table[key], wrong
        if not killed(CLAIMS[name]):
            changed = next(b for a, b in zip(before, wrong, strict=False) if a != b)
            yield name, f"{key}: {changed}"
        table[key] = before


def left_over(names: list[str], every: int) -> list[tuple[str, str]]:
    """The survivors of each `every`-th fault that are not kept."""
    kept = {(one["claim"], one["form"]) for one in listed()}
    found = chain(survivors(names, every), data_survivors(every))
    return sorted(set(found) - kept)


def main() -> int:
    """Print the survivors that are not kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", help="claims; all if none is named")
    parser.add_argument("--every", type=int, default=1, help="each N-th fault only")
    options = parser.parse_args()
    names = options.names or [name for name, claim in CLAIMS.items() if claim.evaluate]
    left = left_over(names, options.every)
    for name, fault in left:
        print(f"{name}: {fault}")
    print(f"{len(left)} survivors")
    return int(bool(left))


if __name__ == "__main__":
    sys.exit(main())
