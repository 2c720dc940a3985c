"""The site is built, opens from disk, asks the network for nothing, and is strict.

Sphinx lives in an environment of its own, made by `make docs`; without it these tests
skip and say so.
"""

import re
import shutil
import subprocess
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest
from browser import browser, find_chromium
from places import ROOT

PYTHON = ROOT / ".venv-docs" / "bin" / "python"
SITE = ROOT / "docs" / "site"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not PYTHON.exists(), reason="`make docs` installs what builds the site"
    ),
]

# addresses that a browser loads by itself, in contrast to links that a reader follows
LOADED = {
    "script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href",
    "object": "data", "embed": "src", "video": "src", "audio": "src", "use": "href",
}  # fmt: skip
CSS = re.compile(r"url\(\s*['\"]?([^'\")]+)|@import\s+['\"]([^'\"]+)")


def build(source, configuration, target):
    """Run Sphinx as `make docs` does."""
    return subprocess.run(
        [PYTHON, "-m", "sphinx", "--builder", "html", "--fail-on-warning",
         "--keep-going", "--quiet", "--conf-dir", configuration,
         "--doctree-dir", target / "doctrees", source, target / "site"],
        cwd=ROOT, capture_output=True, text=True, timeout=900,
    )  # fmt: skip


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The whole site, built once."""
    folder = tmp_path_factory.mktemp("built")
    done = build(ROOT / "docs", SITE, folder)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder / "site"


class Page(HTMLParser):
    """What a page loads, links to, and calls its places."""

    def __init__(self, path):
        super().__init__()
        self.loaded, self.links, self.places, self.styles = [], [], {""}, []
        self._style = False
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.places |= {given[key] for key in ("id", "name") if given.get(key)}
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        if tag in LOADED and given.get(LOADED[tag]):
            self.loaded.append(given[LOADED[tag]])
        self.loaded += re.findall(r"(\S+)(?: \S+)?(?:,|$)", given.get("srcset") or "")
        self.styles.append(given.get("style") or "")
        self._style = tag == "style"

    def handle_data(self, data):
        if self._style:
            self.styles.append(data)


@pytest.fixture(scope="module")
def parsed(site):
    return {path: Page(path) for path in site.rglob("*.html")}


def local(address):
    """Whether an address is one of the site's own files, or holds its bytes."""
    return not urlsplit(address).netloc and urlsplit(address).scheme in ("", "data")


def test_nothing_is_loaded_from_the_network(site, parsed):
    assert len(parsed) > 100
    texts = {path: "".join(page.styles) for path, page in parsed.items()}
    texts |= {path: path.read_text(encoding="utf-8") for path in site.rglob("*.css")}
    found = [(p, a) for p, page in parsed.items() for a in page.loaded]
    found += [(p, a or b) for p, text in texts.items() for a, b in CSS.findall(text)]
    assert [(path.name, address) for path, address in found if not local(address)] == []
    assert all(
        (path.parent / unquote(urlsplit(address).path)).exists()
        for path, address in found
        if urlsplit(address).scheme == "" and urlsplit(address).path
    )


def test_each_link_leads_to_a_place_of_the_site(site, parsed):
    """By the built files alone: Sphinx checks its sources, not what it wrote."""
    lost = []
    for path, page in parsed.items():
        for address in filter(local, page.links):
            parts = urlsplit(address)
            target = (
                (path.parent / unquote(parts.path)).resolve() if parts.path else path
            )
            place = unquote(parts.fragment)
            if not target.exists() or (
                target in parsed and place not in parsed[target].places
            ):
                lost.append(f"{path.relative_to(site)}: {address}")
    assert lost == []


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


FAULTS = {
    "page": "[nothing](nowhere.md)",
    "place": "[nothing](index.md#nowhere)",
    "name": "`simval.theory.no_such_thing`",
    "equation": r"$\nosuchcommand x$",
    "picture": "![nothing](nowhere.svg)",
    "public": "```{eval-rst}\n.. autofunction:: simval.nothing\n```",
    "alone": "",  # in no navigation
}


def test_each_fault_fails_the_build(tmp_path):
    """A page for each in a small site, and a sound one that nothing is said of."""
    source, configuration = tmp_path / "docs", tmp_path / "configuration"
    source.mkdir()
    shutil.copytree(SITE / "static", configuration / "static")
    (configuration / "conf.py").write_text(
        f"import sys\nsys.path.insert(0, {str(ROOT)!r})\n"
        "from docs.site.conf import *\n"
        "from docs.site.conf import register as setup\n"
    )
    for name, text in FAULTS.items():
        (source / f"{name}.md").write_text(f"# A page\n\n{text}\n")
    sound = "# Sound\n\n`simval.theory.attitude_moments`, $x^2$, [here](#sound).\n"
    listed = "\n".join(name for name in FAULTS if name != "alone")
    (source / "index.md").write_text(f"{sound}\n```{{toctree}}\n{listed}\n```\n")
    done = build(source, configuration, tmp_path)
    assert done.returncode != 0
    assert "index.md" not in done.stderr
    said = {name: f"/{name}.md" for name in FAULTS} | {"public": "'nothing' from"}
    assert [name for name, words in said.items() if words not in done.stderr] == []
