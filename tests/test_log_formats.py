"""A log in any spelling reads the same; a file that is none ends in a sentence."""

import gzip
import io

import numpy as np
import pytest
import scipy.io
from log_formats import spelled

from simval.cli import run
from simval.errors import InputError, SimvalError
from simval.logs import read_log


def check_read(tmp_path, seed):
    case = spelled(np.random.default_rng([12, seed]))
    path = tmp_path / "log.csv"
    path.write_bytes(case.content)
    log = read_log(path)
    np.testing.assert_array_equal(log.accelerometer, case.force)
    # six digits are printed, of nanoseconds as of seconds; the unit rounds once more
    np.testing.assert_allclose(log.time, case.time, rtol=1e-15, atol=1e-6)
    if case.gyro is not None:
        np.testing.assert_array_equal(log.gyro, case.gyro)
    assert [each.role for each in log.columns][:4] == ["t", "ax", "ay", "az"]


def check_asked(tmp_path, seed):
    case = spelled(np.random.default_rng([13, seed]), accelerometer=False)
    path = tmp_path / "log.csv"
    path.write_bytes(case.content)
    with pytest.raises(InputError, match=r"--columns"):
        read_log(path)


@pytest.mark.parametrize("seed", range(60))
def test_a_log_in_any_spelling_reads_the_same(tmp_path, seed):
    check_read(tmp_path, seed)


@pytest.mark.parametrize("seed", range(30))
def test_a_log_that_names_no_accelerometer_is_a_question(tmp_path, seed):
    check_asked(tmp_path, seed)


@pytest.mark.slow
def test_a_thousand_spellings(tmp_path):
    """Exact: none may be lost, none of the others accepted."""
    for seed in range(1000, 2000):
        check_read(tmp_path, seed)
        check_asked(tmp_path, seed)
