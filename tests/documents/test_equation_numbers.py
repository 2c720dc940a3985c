"""Equations: each number that is cited is defined, derivations have the code's."""

import re

import pytest
from places import ROOT

from docs.site.equations import NUMBER, TAG, home, modules, numbers

DOCS = ROOT / "docs"


@pytest.mark.ci
def test_each_citation_of_an_equation_has_a_home():
    """The number of an equation in a docstring, a message or a comment."""
    lost = [
        f"{module.name} cites ({number})"
        for module in modules().values()
        for number in sorted(module.cited)
        if home(number, module) is None
    ]
    assert lost == []
    assert sum(len(module.defined) for module in modules().values()) > 100


# modules whose equations a written page derives, and so may number
DERIVED = {
    "theory.md": (
        "geometry", "imu.attitude.kernel", "theory.expansion",
    ),
    "magnetometer.md": ("theory.magnetometer",),
    "theory_calibration.md": (
        "imu.sensor.models", "imu.sensor.forms", "poses",
        "imu.calibrate.residuals",
        "imu.calibrate.minimization", "imu.calibrate.covariance",
        "theory.calibration",
        "theory.calibration_classes",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DERIVED)
def test_numbers_of_a_derivation_are_those_of_the_code(name):
    """A tag of a written page is one of the modules that it derives, or a source's."""
    text = (DOCS / name).read_text(encoding="utf-8")
    known = {n for m in DERIVED[name] for n in modules()[f"simval.{m}"].defined}
    tagged = [n for tag in re.findall(TAG, text) for n in numbers(tag)]
    tagged += re.findall(rf"(?m)^\(({NUMBER})\) \[", text)
    own = [number for number in tagged if re.fullmatch(NUMBER, number)]
    assert set(own) <= known
    assert len(own) == len(set(own))
    cited = set(re.findall(rf"\(({NUMBER})\)", text))
    assert cited <= known
