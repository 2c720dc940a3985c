"""The documentation site: see CONTRIBUTING.md, "The site"."""

import re
import sys
from importlib.util import find_spec
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT))

import simval  # noqa: E402
from docs.site import mathml, names, notebook, reference  # noqa: E402

# shipped with the pages, since few machines have a font with mathematics' measures
MATH_FONT = (
    Path(str(find_spec("ziamath").origin)).parent / "fonts/STIXTwoMath-Regular.ttf"
)

project = "simval"
author = "the simval developers"
version = release = simval.__version__
language = "en"

source_suffix = {".rst": "restructuredtext", ".md": "markdown", ".ipynb": "markdown"}
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["site/**", "experiments/**"]
default_role = "name"

myst_enable_extensions = ["deflist", "dollarmath"]
myst_heading_anchors = 4
myst_dmath_double_inline = True

autodoc_typehints = "none"  # the words of Parameters say it, with units
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"
html_title = "simval"
html_math_renderer = "mathml"
html_static_path = ["static", str(MATH_FONT)]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # a browser fetches nothing from files
html_show_sphinx = False
html_show_copyright = False
html_theme_options = {"navigation_with_keys": True}


TREE = "\n\n```{{toctree}}\n:caption: {}\n:hidden:\n:glob:\n\n{}\n```\n"
FOLDERS = (("Tutorials", "tutorials"), ("How to", "howto"))


def list_folders(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put folders' pages into the navigation, in the order of the index's links.

    A notebook becomes a page first.
    """
    if app.env.doc2path(docname).suffix == ".ipynb":
        source[0] = notebook.markdown(source[0])
    if docname == "decisions/README":  # there the list is one of links
        source[0] += TREE.format("Decisions", "[0-9]*")
    if docname == "index":
        docs = Path(app.srcdir)
        found = [(words, ordered(source[0], docs, name)) for words, name in FOLDERS]
        trees = (TREE.format(w, "\n".join(pages)) for w, pages in found if pages)
        head, mark, tail = source[0].partition("\n```{toctree}")
        source[0] = head + "".join(trees) + mark + tail


def ordered(text: str, docs: Path, folder: str) -> list[str]:
    """Pages of a folder: those that a text links to, in its order, then the others."""
    linked = re.findall(rf"\]\(({folder}/\w+)\.(?:md|ipynb)\)", text)
    pages = sorted(f"{folder}/{path.stem}" for path in (docs / folder).iterdir())
    return list(dict.fromkeys([*linked, *pages]))


def register(app: Sphinx) -> None:
    """Register what reads the pages."""
    app.connect("source-read", list_folders)
    mathml.setup(app)
    names.setup(app)


def setup(app: Sphinx) -> None:
    """Write the generated pages first."""
    reference.write(Path(app.srcdir) / "reference")
    register(app)
