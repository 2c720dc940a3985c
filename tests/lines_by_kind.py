"""Lines of the package by kind: code, docstring, comment, blank.

python tests/lines_by_kind.py [FOLDER]
"""

import ast
import sys
from collections import Counter
from pathlib import Path


def lines_by_kind(text):
    """Count the lines of one module."""
    docs = set()
    for node in ast.walk(ast.parse(text)):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        for child in body:
            value = getattr(child, "value", None)
            if isinstance(child, ast.Expr) and isinstance(value, ast.Constant):
                docs |= set(range(child.lineno, child.end_lineno + 1))
    kinds = Counter()
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.strip()
        kind = "comment" if bare.startswith("#") else "code" if bare else "blank"
        kinds["docstring" if number in docs else kind] += 1
    return kinds


def main(folder):
    """Print the counts of a folder."""
    total = Counter()
    for path in sorted(Path(folder).rglob("*.py")):
        total += lines_by_kind(path.read_text(encoding="utf-8"))
    for kind, count in (*sorted(total.items()), ("total", sum(total.values()))):
        sys.stdout.write(f"{kind:10s} {count:6d}\n")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "simval")
