"""The check of shapes is alive in the tests, and absent from a user's run."""

import subprocess
import sys

import numpy as np
import pytest
from jaxtyping import Float, TypeCheckError
from typechecked import checked

from simval.arrays import Array
from simval.imu.calibrate import residuals
from simval.imu.sensor import forms


@pytest.mark.parametrize(
    "parameters", [np.zeros(8), np.zeros((9, 1)), np.zeros(9, int), [0.0] * 9]
)
def test_an_inner_function_refuses_another_shape_or_type(parameters):
    with pytest.raises(TypeCheckError, match="parameters"):
        checked(forms.matrix.__wrapped__)("triangular", parameters)


def test_axes_of_one_name_have_one_length():
    with pytest.raises(TypeCheckError, match="sampson_slopes"):
        checked(residuals.sampson_slopes.__wrapped__)(
            np.ones((1, 4)), np.ones((1, 5)), newton=False
        )


def test_a_wrong_result_is_refused():
    @checked
    def shortened(x: Float[Array, " n"]) -> Float[Array, " n"]:
        return x[:-1]

    with pytest.raises(TypeCheckError, match="return value"):
        shortened(np.zeros(3))


def test_garbage_passes_unchecked(unchecked):
    assert forms.matrix("triangular", np.zeros(9, int)).shape == (3, 3)


LATE = [
    *("beartype", "jaxtyping", "hypothesis", "matplotlib", "jinja2", "rich", "pyarrow"),
    *("scipy.special", "scipy.optimize", "scipy.spatial", "scipy.linalg"),
    *("scipy.stats", "scipy.io", "distributed"),
]
"""What a worker of a sweep, a plug-in's child and `simval calibrate` import when they
first use it, or never."""


@pytest.mark.ci
def test_a_start_imports_neither_a_checker_nor_what_is_used_late():
    program = (
        "import sys, simval.imu.multiposition, simval.plugins, simval.sweep; "
        f"print([name for name in {LATE} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n"
