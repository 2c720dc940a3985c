"""What is postponed is not run by SciPy, and is there for who uses it."""

import subprocess
import sys

PROGRAM = """
import sys
from simval.cli.late import postpone
postpone()
import numpy as np
import scipy.special
assert float(scipy.special.gammaincc(1.0, 0.0)) == 1.0
print("numpy.f2py.crackfortran" in sys.modules, "unittest" in sys.modules)
np.testing.assert_array_equal([1.0], [1.0])
print(np.f2py.crackfortran.__name__)
postpone()
import numpy.testing
print(numpy.testing is np.testing is sys.modules["numpy.testing"])
"""


def test_modules_that_nobody_uses_run_at_the_first_look():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["False", "False", "numpy.f2py.crackfortran", "True"]
