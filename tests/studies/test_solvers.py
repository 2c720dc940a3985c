"""The study of the solvers: all end at the same place, Newton in fewest steps."""

import numpy as np
from rows_by_name import named

from simval.studies import solvers
from simval.studies.study import Cell
from simval.verdict import judge, overall


def outcome(noise_std):
    cell = Cell("solvers", solvers.Parameters(noise_std=noise_std), 1)
    return solvers.run(cell.parameters, cell.streams)


def test_every_method_ends_at_the_same_parameters():
    found = outcome(0.3)
    assert overall(judge(named(found.rows))) == "pass"


def test_newton_is_quadratic_and_the_others_are_linear():
    (ways,) = outcome(1.0).artifacts.values()
    gauss, newton = ways["gauss-newton"], ways["newton"]
    # linear: the distance falls by one factor a step, within 20 % of itself
    factors = gauss[1:] / gauss[:-1]
    assert np.ptp(np.log(factors)) < 0.2
    # quadratic: three more digits in the first step (and its order: `test_leverage`)
    assert newton[0] < 1e-3 * gauss[0]
    assert len(newton) < len(gauss)
