"""A name of a type means one thing in the library under test."""

import ast
import re
from collections import defaultdict
from pathlib import Path

from simval import imu


def types_of(tree):
    """Names of classes and aliases of a module, without leading underscores."""
    for node in tree.body:
        targets = getattr(node, "targets", [getattr(node, "target", None)])
        named = [node.name] if isinstance(node, ast.ClassDef) else []
        named += [each.id for each in targets if isinstance(each, ast.Name)]
        yield from (x.lstrip("_") for x in named if re.match("_?[A-Z][a-z]", x))


def test_a_name_means_one_thing():
    homes = defaultdict(list)
    for path in Path(imu.__file__).parent.rglob("*.py"):
        for name in types_of(ast.parse(path.read_text(encoding="utf-8"))):
            homes[name].append(path)
    assert len(homes) > 200
    assert {name: own for name, own in homes.items() if len(own) > 1} == {}
