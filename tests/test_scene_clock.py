"""The clock of a simulation: regular to the rounding of its sums, and no further.

MuJoCo adds its step to its time. Within a binade of the time each addition is rounded
the same way, so the drift grows evenly and not as a walk does: the limit grows, too.
"""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simval.errors import SimulationError
from simval.scene.run import CLOCK_TOLERANCE, check_run, is_regular

OFF = 1e-9  # relative, of a step that is wrong
ROWS = 10_000


def added(timestep, rows):
    """Time of each row, by one addition after the other."""
    steps = np.full(rows, timestep)
    steps[0] = 0.0
    return np.add.accumulate(steps)


@pytest.mark.parametrize(
    ("seconds", "timestep"),
    [
        (600.0, 1e-3),
        pytest.param(600.0, 2e-4, marks=pytest.mark.ci),
        pytest.param(86_400.0, 0.03, marks=pytest.mark.ci),
    ],
)
def test_a_long_run_has_a_regular_clock(seconds, timestep):
    rows = round(seconds / timestep)
    clock = added(timestep, rows)
    assert is_regular(clock, timestep).all()
    # power: the constant limit of a millionth of a step would refuse it
    assert abs(clock[-1] - timestep * (rows - 1)) > CLOCK_TOLERANCE * timestep
    wrong = added(timestep * (1.0 + OFF), rows)
    assert not is_regular(wrong, timestep)[rows // 10 :].any()
    clock[rows // 2 :] -= timestep
    clock[rows // 3] = np.nan
    refused = np.flatnonzero(~is_regular(clock, timestep))
    assert refused[:2].tolist() == [rows // 3, rows // 2]
    assert len(refused) == 1 + rows - rows // 2


@given(
    timestep=st.floats(1e-6, 1.0),
    rows=st.integers(4000, ROWS),
    lost=st.floats(0.0, 1.0),
    late=st.booleans(),
)
@example(timestep=1e-3, rows=ROWS, lost=0.5, late=True)
@example(timestep=2.0**-10, rows=ROWS, lost=1.0, late=False)  # every sum is exact
def test_any_step_added_up_is_regular_and_another_is_not(timestep, rows, lost, late):
    clock = added(timestep, rows)
    assert is_regular(clock, timestep).all()
    # beyond a millionth of a step from the thousandth row on, and its sum may drift
    # the other way by k spacing(end)/2, at most 10 000^2 eps = 2e-8 of a step
    off = added(timestep * (1.0 + (OFF if late else -OFF)), rows)
    assert not is_regular(off, timestep)[2000:].any()
    row = 1 + round(lost * (rows - 2))
    clock[row:] += -timestep if late else timestep
    assert np.flatnonzero(~is_regular(clock, timestep)).tolist() == list(
        range(row, rows)
    )


def test_the_limit_is_that_of_the_sums():
    """Some step drifts by nearly half of what is allowed, so a third would refuse it.

    At most the last half of the rows lies in the last binade. If each addition there
    is off by half a unit, those in the one before are hardly off at all.
    """
    used = []
    for timestep in np.random.default_rng(4).uniform(1e-4, 1e-3, 600):
        clock = added(timestep, ROWS)
        expected = timestep * np.arange(ROWS)
        allowed = ROWS * np.spacing(expected[-1]) / 2.0
        used.append(abs(clock[-1] - expected[-1]) / allowed)
    assert 0.4 < max(used) < 0.5


def test_a_run_with_a_step_too_few_is_refused_by_name():
    rows = np.zeros((4000, 14))
    rows[:, 13] = added(1e-3, 4000)
    none = np.zeros((8, 2), dtype=np.int64)
    check_run("made", rows, none, [], 1e-3, 1e3, 1e2)
    rows[2500:, 13] -= 1e-3
    with pytest.raises(SimulationError, match=r"clock .* regular, first at row 2500"):
        check_run("made", rows, none, [], 1e-3, 1e3, 1e2)
