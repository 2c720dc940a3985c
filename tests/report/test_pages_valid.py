"""Every page against two judges that are not ours: axe-core and the Nu HTML checker.

Both come from `tests/pages` by ``make tests/pages/installed`` (npm); a machine without
npm, Java or Chromium skips, and says which.
"""

import json
import shutil
import subprocess

import pytest
from browser import browser, find_chromium
from every_page import every_page
from places import ROOT
from read_back import not_numbers, off_datum

from simval.imu.logs import read_log
from simval.imu.multiposition import calibrate_log, calibrate_sensors
from simval.imu.multiposition.log_units import Scale
from simval.imu.multiposition.noise import log_noise
from simval.judge import compare_runs
from simval.report import drawings
from simval.report.calibration_page import calibration_page
from simval.report.comparison import comparison_sections
from simval.report.noise_page import SensorNoise, allan_drawing
from simval.sweep import load_run

MODULES = ROOT / "tests" / "pages" / "node_modules"
AXE = MODULES / "axe-core" / "axe.min.js"
NU = MODULES / "vnu-jar" / "build" / "dist" / "vnu.jar"
INSTALL = "run `make tests/pages/installed`"

pytestmark = pytest.mark.slow

with_axe = pytest.mark.skipif(
    find_chromium() is None or not AXE.is_file(),
    reason=f"axe-core judged no page: Chromium is not installed, or {INSTALL}",
)
with_nu = pytest.mark.skipif(
    shutil.which("java") is None or not NU.is_file(),
    reason=f"the HTML checker judged no page: Java is not installed, or {INSTALL}",
)

NAMES = (
    "sound", "failing", "algorithms", "compared", "calibrated", "outlier", "filtered",
    "blind", "noise", "stuck",
)  # fmt: skip
WIDTHS, SCHEMES = (380, 1280), ("light", "dark")

JUDGE = """axe.run(document, {resultTypes: ['violations']}).then((found) =>
  found.violations.map((each) =>
    `${each.id}: ${each.help}: ` +
    each.nodes.slice(0, 3).map((node) => node.target.join(' ')).join(', ')))"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    found = every_page(tmp_path_factory.mktemp("every"))
    assert tuple(found) == NAMES
    return found


@pytest.fixture(scope="module")
def tab(tmp_path_factory):
    with browser(tmp_path_factory.mktemp("profile")) as page:
        yield page


def violations(tab, path, width, scheme):
    """What axe-core finds wrong, with every fold open."""
    tab.open(path, width=width, scheme=scheme)
    tab.run("document.querySelectorAll('details').forEach(d => d.open = true)")
    tab.run(AXE.read_text(encoding="utf-8") + "; undefined")
    return tab.run(JUDGE)


@with_axe
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", NAMES)
def test_no_page_has_an_accessibility_violation(tab, pages, name, width, scheme):
    assert violations(tab, pages[name], width, scheme) == []


@with_axe
def test_a_page_with_violations_would_be_seen(tab, tmp_path):
    """Power of the test above: a figure without a text, and pale ink."""
    path = tmp_path / "bad.html"
    path.write_text(
        "<!DOCTYPE html><html lang=en><title>bad</title><main><h1>bad</h1>"
        "<img src='data:,'><p style='color: #999; background: #fff'>pale</main>"
    )
    found = violations(tab, path, 1280, "light")
    assert {line.split(":")[0] for line in found} == {"image-alt", "color-contrast"}


def errors(paths):
    """What the HTML checker calls an error, by page."""
    words = ["java", "-jar", str(NU), "--format", "json", "--exit-zero-always"]
    done = subprocess.run(
        [*words, *map(str, paths)], capture_output=True, text=True, check=True
    )
    return [
        f"{each['url'].rpartition('/')[2]}: {each['message']}"
        for each in json.loads(done.stderr)["messages"]
        if each["type"] != "info"
    ]


@with_nu
def test_every_page_is_valid_html(pages):
    assert errors(pages.values()) == []


@pytest.mark.skipif(find_chromium() is None, reason="Chromium is not installed")
@pytest.mark.parametrize("name", NAMES)
def test_every_page_prints_whole(tab, pages, name):
    assert tab.printed(pages[name], 718) == []


def every_drawing(folder):
    """Figures of the pages; those of filters over a log have no markers."""
    runs = [load_run(folder / name) for name in ("sound", "broken", "own")]
    for run in runs:
        yield from drawings(run)
    compared = comparison_sections(*runs[:2], compare_runs(*runs[:2]))
    for name in ("log <b> & c.csv", "odd.csv"):
        log = read_log(folder / name)
        whole = calibrate_sensors(log, calibrate_log(log))
        compared += calibration_page(log, whole).sections
    yield from (drawing for section in compared for drawing in section.drawings)
    noise = log_noise(read_log(folder / "still.csv"))
    unit = Scale(1.0, "")
    yield allan_drawing("a", [SensorNoise(name="gyro", axes=noise.gyro, scale=unit)])


def test_every_marker_stands_at_its_datum(pages):
    found = [off_datum(each) for each in every_drawing(pages["sound"].parent)]
    assert [off for off, _ in found if off] == []
    assert sum(count for _, count in found) > 400


@pytest.mark.parametrize("name", NAMES)
def test_every_number_of_an_attribute_is_one(pages, name):
    assert not_numbers(pages[name].read_text(encoding="utf-8")) == []
