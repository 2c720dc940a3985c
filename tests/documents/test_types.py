"""The programs of the documents, and what a wrong word is, before a type checker.

A page's blocks are one program, but those that are files of their own (`title=`). What
a user writes need not be annotated; the README's program is checked as strictly as the
package. pyright comes from `tests/pages` by ``make tests/pages/installed`` (npm).
"""

import json
import re
import subprocess
import sys

import pytest
from places import EXAMPLES, ROOT

PYRIGHT = ROOT / "tests" / "pages" / "node_modules" / ".bin" / "pyright"

PLAIN = """# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False
# mypy: check-untyped-defs=True, disallow-any-generics=False
# mypy: disable-error-code="name-defined, has-type, import-untyped, import-not-found"
"""
"""Of a page's program: names that its text introduces stand for anything."""

WRONG = {
    'calibrate(READINGS, model="triangel")': "triangular",
    'calibrate(READINGS, method="lmx")': "gauss-newton",
    'calibrate(READINGS, residual="cubed")': "sampson",
    'two_vector_quaternion(R, R, R, R, frame="w")': "combined",
    "attitude_moments(Q, R, R, 0.01, order=5)": "4-paper",
    'simulate("gimbal", integrator="euler")': "RK4",
    'AccelerometerModel(T="no", K=[1, 1, 1], B=[0, 0, 0])': "Sequence",
}
"""Programs that a checker refuses, each with a word of what it says is right."""
USES = """import numpy as np
from simval import AccelerometerModel, calibrate, two_vector_quaternion
from simval.scene import simulate
from simval.theory import attitude_moments
READINGS, R, Q = np.ones((12, 3)), np.ones(3), np.array([0.0, 0.0, 0.0, 1.0])
"""


def programs():
    """The program of each page, or of each file that it shows, by name."""
    found = {}
    for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]:
        name = re.sub(r"\W", "_", str(path.relative_to(ROOT)))
        blocks = re.findall(r"```python([^\n]*)\n(.*?)```", path.read_text(), re.DOTALL)
        found[name] = "\n".join(text for title, text in blocks if not title.strip())
        for k, text in enumerate(text for title, text in blocks if title.strip()):
            found[f"{name}_{k}"] = text
    for path in EXAMPLES.glob("*.py"):
        found[f"examples_{path.stem}"] = path.read_text()
    notebook = json.loads((ROOT / "docs" / "tutorials" / "notebook.ipynb").read_text())
    cells = (c for c in notebook["cells"] if c["cell_type"] == "code")
    found["notebook"] = "\n\n".join("".join(cell["source"]) for cell in cells)
    return {name: text for name, text in found.items() if text.strip()}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A folder with the programs, and one in which each line is wrong."""
    folder = tmp_path_factory.mktemp("programs")
    for name, text in programs().items():
        head = "" if name == "README_md" else PLAIN
        (folder / f"{name}.py").write_text(head + text)
    (folder / "wrong.py").write_text(USES + "\n".join(WRONG))
    return folder


def complaints(command, folder):
    """Errors of a checker: file, line and words."""
    paths = sorted(map(str, folder.glob("*.py")))
    done = subprocess.run([*command, *paths], capture_output=True, text=True, cwd=ROOT)
    pattern = r"(\w+)\.py:(\d+)(?::\d+)?(?: -|:) error: (.*(?:\n[^\S\n]{3,}.*)*)"
    return [(f, int(line), what) for f, line, what in re.findall(pattern, done.stdout)]


def judge(found):
    """Only the wrong lines are refused, every one of them, and for what they say."""
    assert [each for each in found if each[0] != "wrong"] == []
    first = USES.count("\n") + 1
    for place, (line, right) in enumerate(WRONG.items(), first):
        said = [what for _, at, what in found if at == place]
        assert any(right in words for words in said), line


@pytest.mark.slow  # two seconds after `make check`, a minute without
def test_programs_of_the_documents_are_sound_to_mypy(written):
    assert len(list(written.glob("*.py"))) > 25
    judge(complaints([sys.executable, "-m", "mypy"], written))


@pytest.mark.slow
@pytest.mark.skipif(
    not PYRIGHT.exists(),
    reason="pyright judged no program: run `make tests/pages/installed`",
)
def test_the_readme_is_sound_to_pyright(written, tmp_path):
    for name in ("README_md", "wrong"):
        (tmp_path / f"{name}.py").write_text((written / f"{name}.py").read_text())
    judge(complaints([PYRIGHT, "--pythonpath", sys.executable], tmp_path))
