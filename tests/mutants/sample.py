"""A seeded sample of one-line faults in a room, and those that its tests do not see.

    python tests/mutants/sample.py --count 20 --seed 1 plugins imu/attitude

Each fault is put into a copy of the checkout, in ``simval/ROOM``, and the quick tests
in ``tests/ROOM`` are run until one fails. A survivor is printed: whether it says the
same as before, or asks for a test, is for a reader.
"""

import argparse
import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

SWAPS = {
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt},
    **{ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In},
    **{ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.And: ast.Or, ast.Or: ast.And},
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult},
}
"""Operators, and what may be mistaken for each."""


def faults(tree: ast.AST) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Expressions below a tree, each with one that is wrong; messages do not count."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.arg):
            continue
        if isinstance(node, ast.expr) and (wrong := mistaken(node)):
            yield node, wrong
        yield from faults(node)


def mistaken(node: ast.expr) -> ast.expr | None:
    """What one may write for an expression by mistake."""
    match node:
        case ast.Compare(left=a, ops=[op], comparators=rest) if type(op) in SWAPS:
            return ast.Compare(a, [SWAPS[type(op)]()], rest)
        case ast.BinOp(left=a, op=op, right=b) if type(op) in SWAPS:
            return ast.BinOp(a, SWAPS[type(op)](), b)
        case ast.BoolOp(op=op, values=values):
            return ast.BoolOp(SWAPS[type(op)](), values)
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=a):
            return a
        case ast.Constant(value=bool() as value):
            return ast.Constant(not value)
        case ast.Constant(value=int() | float() as value):
            return ast.Constant(value + 1)
    return None


def damaged(text: str, place: ast.expr, wrong: ast.expr) -> str:
    """The text with another expression in a place of one line."""
    lines = text.splitlines(keepends=True)
    line = lines[place.lineno - 1].encode()
    start, end = place.col_offset, place.end_col_offset
    now = line[:start] + f"({ast.unparse(wrong)})".encode() + line[end:]
    lines[place.lineno - 1] = now.decode()
    return "".join(lines)


def drawn(room: Path, count: int, seed: int) -> list[tuple[Path, int, str]]:
    """Files of a room, each with a line and the whole text with a fault in it."""
    found = []
    for file in sorted(room.rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        for place, wrong in faults(ast.parse(text)):
            if place.lineno == place.end_lineno:
                found.append((file, place.lineno, damaged(text, place, wrong)))
    return Random(f"{seed} {room.name}").sample(found, min(count, len(found)))


def seen(copy: Path, tests: str) -> bool:
    """Whether a test fails, in a copy of the checkout."""
    words = ["-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", tests]
    chosen = ["-m", "not (ci or slow or wheel or league)", "--hypothesis-seed=0"]
    own = {**os.environ, "PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1"}
    run = [sys.executable, *words, *chosen]
    return subprocess.run(run, cwd=copy, env=own, capture_output=True).returncode != 0


def main() -> None:
    """Draw, run and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("rooms", nargs="+", help="folders of simval and of tests")
    parser.add_argument("--count", type=int, default=20, help="faults of each")
    parser.add_argument("--seed", type=int, default=1, help="of the sample")
    asked = parser.parse_args()
    listed = subprocess.run(["git", "ls-files", "-z"], capture_output=True, check=True)
    with TemporaryDirectory(prefix="mutants-") as folder:
        copy = Path(folder)
        for name in filter(None, listed.stdout.decode().split("\0")):
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(name, copy / name)
        for room in asked.rooms:
            if seen(copy, f"tests/{room}"):
                sys.exit(f"tests/{room} fail without a fault")
            sample = drawn(copy / "simval" / room, asked.count, asked.seed)
            alive = 0
            for file, number, text in sample:
                sound = file.read_text(encoding="utf-8")
                file.write_text(text, encoding="utf-8")
                if not seen(copy, f"tests/{room}"):
                    alive += 1
                    was, now = (t.splitlines()[number - 1] for t in (sound, text))
                    print(f"{file.relative_to(copy)}:{number}\n  -{was}\n  +{now}")
                file.write_text(sound, encoding="utf-8")
            print(f"{room}: {len(sample)} faults, {alive} not seen", flush=True)


if __name__ == "__main__":
    main()
