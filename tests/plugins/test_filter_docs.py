"""What docs/plugins.md says of filters is so."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from sound_filters import told, tumbling

from simval.geometry import attitude_error, attitude_matrix
from simval.plugins import Filter, find_plugin, find_world, run_filter
from simval.plugins.attitudes import WORLDS
from simval.plugins.protocol import ANSWERS, READS

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLE = DOCS / "examples" / "complementary.py"
SECTION = (DOCS / "plugins.md").read_text().partition("## A filter\n")[2]
SECTION = SECTION.partition("\n## ")[0]


def test_the_page_shows_the_example_as_it_is():
    code = EXAMPLE.read_text().partition("\n\n")[2]
    assert f"```python\n{code}```" in SECTION


def test_every_word_is_on_the_page():
    declared = [field.name for field in fields(Filter) if field.name != "name"]
    for word in (*READS, *ANSWERS, *WORLDS, *declared):
        assert f"`{word}`" in SECTION, word


@pytest.mark.ci
def test_the_example_stays_in_its_world_and_near_the_truth():
    """A pull of 2 1/s towards vectors that are noisy by 2e-3 and 5e-3 rad."""
    pulled = find_plugin(str(EXAMPLE), Filter)
    assert find_world(pulled, told(), 10.0).world == "NWU"
    given, truth = tumbling(1, 300)
    found = run_filter(pulled, given, np.arange(0, 300, 50), "NWU")
    off = truth[:, ::50] @ np.swapaxes(attitude_matrix(found.attitude), -1, -2)
    angle = np.arccos(np.clip((np.trace(off, axis1=2, axis2=3) - 1) / 2, -1, 1))
    # one row's two vectors alone are off by some 7e-3 rad, and 50 rows are averaged
    assert angle.max() < 7e-3
    assert attitude_error(found.attitude[:, 0], given.start).max() < 0.1
