"""No line installs simval from an index; what finds such lines finds every kind."""

import re

import installing
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from installing import by_name, is_bare, kind_of
from packaging.requirements import InvalidRequirement, Requirement
from places import ROOT

READ = {".md", ".rst", ".py", ".toml", ".yml", ".yaml", ".cfg", ".ini", ".in", ".txt"}
READ |= {
    ".sh",
    ".bash",
    ".zsh",
    ".fish",
    ".j2",
    ".js",
    ".c",
    "",
}  # "": Makefile and the like
PLACES = ("simval", "docs", "models", "reports", ".ci", ".github")


def shipped():
    """Every text of the project but its tests, which name such lines on purpose."""
    beside = [path for path in ROOT.iterdir() if path.is_file()]
    below = [p for name in PLACES for p in (ROOT / name).rglob("*") if p.is_file()]
    made = (ROOT / "reports" / "runs", ROOT / "docs" / "reference")
    return sorted(
        path
        for path in (*beside, *below)
        if path.suffix in READ and not any(path.is_relative_to(m) for m in made)
    )


@pytest.mark.parametrize(
    "where", ["pages", pytest.param("program", marks=pytest.mark.ci)]
)
def test_no_text_installs_simval_by_name(where):
    texts = {
        path.relative_to(ROOT): path
        for path in shipped()
        if (where == "program") is path.is_relative_to(ROOT / "simval")
    }
    assert len(texts) > {"pages": 150, "program": 400}[where]
    found = {
        str(name): lines
        for name, path in texts.items()
        if (lines := by_name(path.read_text(encoding="utf-8"), kind_of(path)))
    }
    # a package's own extras, named in its metadata, are resolved without an index
    for own in found.pop("pyproject.toml", []):
        assert re.fullmatch(r'"simval\[[\w,]+\]",', own)
    assert found == {}


COMMANDS = [
    "pip install",
    "pip3 install",
    "pip3.11 install",
    "python -m pip install",
    "python3.12 -m pip --quiet install",
    "py -3 -m pip install",
    ".venv/bin/pip install",
    '"$BIN"/python -m pip install',
    "sudo -H pip install",
    "!pip install",
    "%pip install",
    "pip --isolated --proxy http://proxy:8080 install",
    "pip wheel --no-deps",
    "pip download",
    "uv pip install",
    "uv add",
    "uv tool install",
    "uv tool run",
    "uvx",
    "uvx --from",
    "uv run --with",
    "pipx install",
    "pipx run",
    "pipx run --spec",
    "pipx install --python python3.12",
    "pipenv install",
    "poetry add",
    "pdm add --dev",
    "pixi add --pypi",
    "conda install -c conda-forge",
    "mamba create -n new",
    "easy_install",
    "RUN --mount=type=cache,target=/root pip install --no-cache-dir",
    "env PIP_PRE=1 pip install --upgrade --index-url https://index/simple",
    "cd /somewhere && pip install -q",
    "pip install . && pip install",
    "pip install -r requirements.txt -c simval.txt",
    "pip install --upgrade pip numpy 'scipy>=1.15'",
]
NAMES = [
    "simval",
    "Simval",
    "simval==0.1.0",
    "'simval>=0.1,<1'",
    '"simval~=0.1"',
    "simval[cluster]",
    "'simval[cluster,parquet]'",
    '"simval[cluster] == 0.1.*"',
    "simval[render]!=0.1",
    "\"simval; python_version < '3.13'\"",
]
FRAMES = {
    "a line": ("code", "{}\n"),
    "a step": ("code", "    steps:\n      - run: {}\n"),
    "a step of lines": (
        "code",
        "- name: set up\n  run: |\n    set -e\n    {}\n    simval list\n",
    ),
    "a comment after it": ("code", "{}    # the newest\n"),
    "more after it": ("code", "{} && simval sweep smoke\n"),
    "a pipe": ("code", "({} | tail -n 1); simval list\n"),
    "a block": ("prose", "Do this:\n\n```sh\n{}\n```\n\nand `simval list`.\n"),
    "a console": ("prose", "1. First\n\n   ```console\n   $ {}\n   ```\n"),
    "a span": ("prose", "You may also call `{}`, as everywhere.\n"),
    "a row": ("prose", "| how | `{}` |\n| --- | --- |\n"),
    "a comment": ("python", "# first `{}`\nx = 1\n"),
    "a document": ("python", 'def f():\n    """Do `{}`, then work."""\n'),
    "a make rule": ("code", "all: .venv\n\t@{}\n"),
    "markup": ("code", "<p>Call <code>{}</code> first.</p>\n"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_found_with_every_name(command):
    texts = [
        (around.format(f"{command} {name}"), kind)
        for kind, around in FRAMES.values()
        for name in NAMES
    ]
    assert [text for text, kind in texts if not by_name(text, kind)] == []


GOOD_NAMES = [
    ".",
    "'.[cluster]'",
    "-e '.[test]'",
    "-e simval",
    "./simval",
    "simval/",
    "../simval",
    "simval-0.1.0-*.whl",
    "'simval-0.1.0-cp311-abi3-linux_x86_64.whl[cluster]'",
    "wheels/simval-0.1.0-py3-none-any.whl",
    "git+URL",
    "git+https://host/simval",
    "git+file:///home/me/simval#egg=simval",
    "'simval @ git+https://host/simval@main'",
    "'simval[cluster] @ file:///wheels/simval-0.1.0-py3-none-any.whl'",
    "simval@git+https://host/simval",
    "distributed",
    "--no-index --find-links wheels simval",
    "simval-plugins",
    "-r simval/requirements.txt",
]


@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_is_found_that_names_what_to_install(command):
    takes_a_value = command.endswith(("--from", "--with", "--spec"))
    texts = [
        (around.format(f"{command} {name}"), kind)
        for kind, around in FRAMES.values()
        for name in GOOD_NAMES
        if not (takes_a_value and name.startswith("-"))
    ]
    assert [text for text, kind in texts if by_name(text, kind)] == []


BAD = {
    "requirements": [
        "simval",
        "numpy\nsimval  # newest\n",
        "simval==0.1",
        "Simval[a]>=1",
    ],
    "code": [
        'dependencies = ["numpy", "simval"]',
        'dependencies = [\n  "numpy>=2",\n  "simval[cluster]",\n]\n',
        '[project.optional-dependencies]\n"x" = [\n  "simval>=0.1",\n]',
        "dependencies:\n  - python=3.12\n  - pip:\n    - simval\n",
        "dependencies:\n- numpy\n- simval\n",
        "deps =\n    pytest\n    simval\n",
        "deps = simval",
        "install_requires=['simval']",
        "additional_dependencies: [mypy, simval]",
        "additional_dependencies: [simval==0.1.0]",
        'requires = ["simval[parquet]"]',
        'CMD ["pip", "install", "simval"]',
        "pip install \\\n  --upgrade \\\n  simval",
        "pip install 'simval",  # the quote is not closed
    ],
    "prose": [
        "Add `simval[pandas]` to it.",
        "The line is `simval==0.1.0`.",
        "A call of\n`pip install\nsimval` is enough.",
        "Then pip install simval, and go on.",
        "Or (pip install -U simval).",
        '```text title="requirements.txt"\nsimval\n```\n',
        "~~~\npip install simval\n~~~\n",
        "```python\nrun('pip install simval')\n```\n",
        "<pre>pip install simval</pre>",
    ],
    "python": [
        'subprocess.run([sys.executable, "-m", "pip", "install", "simval"])',
        'run(\n    "pip",\n    "install",\n    "simval[cluster]",\n)',
        "session.install('simval')",
        'session.install("-U", "simval[test]", "pytest")',
        'msg = "the extra is missing: pip install "\\\n    "\'simval[cluster]\'"',
        'msg = f"{what} needs the extra `{extra}`: pip install simval[{extra}]"',
        'msg = f"pip install simval=={version}"',
        "x = 'pip install simval'",
    ],
}
GOOD = {
    "requirements": [
        "numpy",
        "./simval-0.1.0-py3-none-any.whl",
        "simval @ file:///x.whl",
    ],
    "code": [
        "pip install .\nsimval sweep smoke",
        "pip install . && simval report run",
        "pip install . ; simval report run",
        "pip install . # simval",
        "pip uninstall simval",
        "pip show simval",
        "pip install --target simval .",
        "pip install --no-index --find-links=wheels simval",
        "uvx --from ./simval-0.1.0-py3-none-any.whl simval list",
        "uv run simval sweep smoke",
        "uv tool run --from . simval",
        "pipx run --spec . simval list",
        "pipx inject simval distributed",
        "name: simval\non: [push]\n",
        'root_package = "simval"',
        'wheel.packages = ["simval"]',
        'containers = ["simval"]',
        'dependencies = ["numpy"]\n[project.scripts]\nsimval = "simval.cli:main"\n',
        "docker build -t simval .",
        "simval > help.txt",
        "simval (see below)",
        "artifacts:\n  name: simval\n",
        "apt-get install -y chromium && simval list",
    ],
    "prose": [
        "`pip install .` installs simval.",
        "pip install the wheel, then simval runs.",
        "`simval` is on no package index.",
        "Do not look for simval with pip: install a wheel.",
        "```\npip install git+URL     # simval's repository\nsimval list\n```\n",
        "simval needs Python 3.11 or newer.",
        "`simval`, `pip` and `install` are words.",
        "- simval\n- numpy\n",
    ],
    "python": [
        'x = ["simval"]',
        "if simval == 3: pass",
        "from simval import install",
        'msg = "install simval again, `pip install -e .` in a checkout"',
        'msg = f"{python} -m pip install {packages}"',
        "session.install('.')",
        'run("pip", "install", "-e", ".")\nrun("simval", "list")\n',
        "models.install(simval)",
    ],
}


def cases(table):
    return [(kind, text) for kind, texts in table.items() for text in texts]


@pytest.mark.parametrize(("kind", "text"), cases(BAD))
def test_it_is_found(kind, text):
    assert by_name(text, kind)


@pytest.mark.parametrize(("kind", "text"), cases(GOOD))
def test_it_is_no_false_alarm(kind, text):
    assert by_name(text, kind) == []


PARTS = """simval SimVal numpy [ a ] a,b == >= < ~= != === 0.1 1.* , . _ / ( ) -0.1
git+file:///x https://host/x.whl"""
WORDS = st.lists(
    st.sampled_from([*PARTS.split(), " ", " @ ", "; python_version < '3.13'"]),
    max_size=9,
).map("".join)


@given(WORDS | WORDS.map("simval{}".format))
def test_a_bare_name_is_what_the_packaging_standard_says(word):
    """Against the parser that pip itself uses."""
    try:
        parsed = Requirement(word)
    except InvalidRequirement:
        return
    assume("()" not in word)  # valid, and nobody's; `simval()` is a call
    by_index = parsed.url is None or parsed.url[0].isdigit()  # simval@0.1, as uv has it
    assert is_bare(word) is (parsed.name.lower() == "simval" and by_index)


def test_the_readers_see_the_readmes_lines():
    """Where nothing is found something was read: its three lines install."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(re.findall(installing.INSTALLS, text)) >= 4
    for good in (".  ", "simval-0.1.0-*.whl", "git+URL"):
        bad = text.replace(f"pip install {good}", "pip install simval ", 1)
        assert bad != text
        assert len(by_name(bad, "prose")) == 1
