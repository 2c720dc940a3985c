"""The site is built without a warning, opens from disk, and asks nothing of a network.

Sphinx lives in an environment of its own, made by `make docs`; without it these tests
skip and say so.
"""

import re
import subprocess

import pytest
from browser import browser, find_chromium
from places import ROOT

PYTHON = ROOT / ".venv-docs" / "bin" / "python"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not PYTHON.exists(), reason="`make docs` installs what builds the site"
    ),
]

# what a browser loads by itself from a network, in contrast to links
LOADED = re.compile(
    r"""<(?!a\b)\w+[^>]*\s(?:src|href|data|srcset)=["'](?:https?:)?//"""
    r"""|url\(\s*['"]?(?:https?:)?//|@import\s+['"](?:https?:)?//"""
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The whole site, built once as `make docs` does: a link that is lost fails it."""
    target = tmp_path_factory.mktemp("built")
    done = subprocess.run(
        [PYTHON, "-m", "sphinx", "--builder", "html", "--fail-on-warning",
         "--keep-going", "--quiet", "--conf-dir", ROOT / "docs" / "site",
         "--doctree-dir", target / "doctrees", ROOT / "docs", target / "site"],
        cwd=ROOT, capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    return target / "site"


def test_nothing_is_loaded_from_the_network(site):
    assert LOADED.search('<img alt="a" src="https://host/a.png">')
    assert not LOADED.search('<a class="b" href="https://host">')
    pages = [*site.rglob("*.html"), *site.rglob("*.css")]
    assert len(pages) > 100
    texts = {page: page.read_text(encoding="utf-8") for page in pages}
    assert [page.name for page, text in texts.items() if LOADED.search(text)] == []


def test_equations_are_mathematics(site):
    text = (site / "theory.html").read_text(encoding="utf-8")
    assert text.count("<math") > 100
    assert "$" not in re.sub(
        r"<(script|style|code|annotation).*?</\1>", "", text, flags=re.S
    )


@pytest.mark.skipif(find_chromium() is None, reason="there is no Chromium")
def test_it_opens_and_searches_from_disk(site, tmp_path):
    with browser(tmp_path) as page:
        for name in ("index", "theory", "conventions", "reference/commands"):
            page.open(site / f"{name}.html", width=380)
            assert page.run("document.documentElement.scrollWidth") <= 380, name
            assert page.complaints() == []
            assert all(url.startswith(("file:", "data:")) for url in page.requests())
        page.open(site / "theory.html")
        fonts = "document.fonts.ready.then(f => [...f].some(x => x.status == 'loaded'))"
        assert page.run(fonts)  # the shipped one, or each machine would show another
        page.run(f"location.href = '{(site / 'search.html').as_uri()}?q=isserlis'")
        found = """new Promise(done => { const look = () => {
          const links = [...document.querySelectorAll('#search-results li a')];
          links.length ? done(links.map(a => a.getAttribute('href')).join(' '))
                       : setTimeout(look, 50); }; look(); })"""
        assert "theory.html" in page.run(found)
        assert all(url.startswith(("file:", "data:")) for url in page.requests())
