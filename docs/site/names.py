"""Names of the package in text: each becomes a link, and must exist.

In docstrings these are the words in single backticks, in Markdown whatever stands as
code and begins with ``simval.``.
"""

import importlib
import re
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.transforms import SphinxTransform
from sphinx.util import logging
from sphinx.util.docutils import SphinxRole

from docs.site.equations import CITED, IN_LINE, anchor, home, modules, room_of

_LOGGER = logging.getLogger(__name__)
_DOTTED = re.compile(r"simval(\.[A-Za-z_]\w*)+$")
_SHORT = re.compile(r"(?!simval\.)[a-z]\w*(\.[A-Za-z_]\w*)+$")
_MARKS = re.compile(r"\||(?<=\w)_(?!\w)")
_AS_IT_IS = r"(`+[^`]*`+|^\.\. math::.*\n(?:[ \t]*\n|[ \t]+.*\n)*)"
_EQUATION = re.compile(r"(?P<module>\S+) (?P<number>\S+)$")


def exists(name: str) -> bool:
    """Whether a dotted name of the package is one of a module or of what is in it."""
    parts = name.split(".")
    for known in range(len(parts), 0, -1):
        try:
            value: Any = importlib.import_module(".".join(parts[:known]))
        except ImportError:
            continue
        for part in parts[known:]:
            fields = getattr(value, "__dataclass_fields__", {})
            if not hasattr(value, part) and part not in fields:
                return False
            value = getattr(value, part, None)
        return True
    return False


class NameRole(SphinxRole):
    """Words in single backticks: a name, of the module at hand or in full."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Make a reference, which stays code where nothing has that name."""
        here = self.env.ref_context
        return [_reference(self.text, self.env.docname, dict(here))], []


class EquationRole(SphinxRole):
    """A cited equation: its module and its number."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Make a link to the page of the module's equations."""
        found = _EQUATION.match(self.text)
        module, number = found["module"], found["number"]  # type: ignore[index]
        package = room_of(module)
        page = f"reference/equations/{package}"
        uri = self.env.app.builder.get_relative_uri(self.env.docname, page)
        link = f"{uri}#{anchor(number, module)}"
        return [nodes.reference("", f"({number})", refuri=link, internal=True)], []


class NamesInCode(SphinxTransform):
    """Inline code that is a name of the package becomes a link, and must exist."""

    default_priority = 700

    def apply(self, **kwargs: Any) -> None:
        """Go through the code of a page."""
        for node in list(self.document.findall(nodes.literal)):
            shown = node.astext()
            text = _in_full(shown)
            if not _DOTTED.match(text) or isinstance(node.parent, pending_xref):
                continue
            if not exists(text):
                _LOGGER.warning("there is no %s", text, location=node)
            elif not isinstance(node.parent, nodes.reference | nodes.title):
                node.replace_self(_reference(text, self.env.docname, {}, shown))


def _in_full(text: str) -> str:
    """A name that leaves the first word out, as ``theory.expansion`` does, with it."""
    short = _SHORT.match(text) and exists(f"simval.{text}")
    return f"simval.{text}" if short else text


def _reference(
    text: str, docname: str, here: dict[str, Any], shown: str = ""
) -> nodes.Node:
    code = nodes.literal(shown or text, shown or text, classes=["name"])
    if not re.fullmatch(r"[A-Za-z_][\w.]*", text):
        return code
    if text.startswith("simval.") and not exists(text):
        _LOGGER.warning("there is no %s", text, location=docname)
    return pending_xref(
        "", code, refdomain="py", reftype="obj", reftarget=text, refdoc=docname,
        refwarn=False,
        **{key: here.get(key) for key in ("py:module", "py:class")},
    )  # fmt: skip


def _outward(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.Element
) -> nodes.Element | None:
    """Find a short name in the packages around the module that uses it."""
    around = str(node.get("py:module") or "")
    documented = env.domains.python_domain.objects
    while around:
        entry = documented.get(f"{around}.{node['reftarget']}")
        if entry is not None:
            uri = app.builder.get_relative_uri(node["refdoc"], entry.docname)
            link = f"{uri}#{entry.node_id}"
            return nodes.reference("", "", content, refuri=link, internal=True)
        around = around.rpartition(".")[0]
    return None


def _cite(
    app: Sphinx, what: str, name: str, obj: Any, opts: Any, lines: list[str]
) -> None:
    """Make links of the equations that a docstring cites, targets of those in line."""
    module = name if what == "module" else getattr(obj, "__module__", name)
    lines[:] = _letters(lines)
    known = modules().get(str(module))
    if known is None:
        return
    inside = False
    for i, line in enumerate(lines):
        if line.startswith(".. math::"):
            inside = True
        elif inside and line and not line.startswith(" "):
            inside = False
        if not inside:
            lines[i] = CITED.sub(lambda m: _cited(m, known), line)


def _letters(lines: list[str]) -> list[str]:
    """Take bars and last underscores as letters: ``|q|``, ``bool_`` are no markup."""
    parts = re.split(_AS_IT_IS, "\n".join(lines), flags=re.MULTILINE)
    odd = [x if i % 2 else _MARKS.sub(r"\\\g<0>", x) for i, x in enumerate(parts)]
    return "".join(odd).split("\n")


def _cited(found: re.Match[str], module: Any) -> str:
    number = found[1]
    if re.compile(IN_LINE).match(found.string, found.start()):
        return f":raw-anchor:`{anchor(number, module.name)}` ({number})"
    owner = home(number, module)
    return found[0] if owner is None else f":equation:`{owner.name} {number}`"


class AnchorRole(SphinxRole):
    """A place that a link can lead to."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Make an empty target."""
        return [nodes.raw("", f'<span id="{self.text}"></span>', format="html")], []


def setup(app: Sphinx) -> dict[str, bool]:
    """Register roles, transform and docstrings' hook."""
    app.add_role("name", NameRole())
    app.add_role("equation", EquationRole())
    app.add_role("raw-anchor", AnchorRole())
    app.add_transform(NamesInCode)
    app.connect("missing-reference", _outward)
    app.connect("autodoc-process-docstring", _cite)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
