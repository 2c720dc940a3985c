"""Packages that run when they are used, in the program and its workers."""

import importlib
import subprocess
import sys

import pytest
import scipy

from simval.startup import COMPILED, FUNCTIONS

HEAD = "import sys\nfrom simval.startup import load_lightly\nload_lightly()\n"


def told(program, **environment):
    """What a process prints that loads lightly; its last line where it fails."""
    import os

    done = subprocess.run(
        [sys.executable, "-c", HEAD + program],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    return done.stdout.strip() or done.stderr.strip().splitlines()[-1]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_is_the_same_object(name):
    compiled = importlib.import_module(COMPILED["scipy.special"])
    assert getattr(compiled, name) is getattr(scipy.special, name)


def test_functions_load_without_the_package():
    program = (
        "import scipy\nprint(scipy.special.ndtri(0.975).hex(), "
        "*(name in sys.modules for name in ('scipy.special._basic', 'numpy.f2py')))"
    )
    number = float(scipy.special.ndtri(0.975)).hex()
    assert told(program) == f"{number} False False"


@pytest.mark.ci
@pytest.mark.parametrize(
    "asks",
    [
        "import scipy.special as s; s.erf",
        "from scipy.special import logsumexp",
        "from scipy.special import *",
        "import scipy.special._basic as b; assert b is sys.modules[b.__name__]",
        "import scipy.special.cython_special",
        "import scipy.stats, scipy.optimize",
        "import scipy.special, importlib; importlib.reload(scipy.special)",
    ],
)
def test_whoever_asks_for_more_gets_the_package(asks):
    program = (
        f"{asks}\nimport scipy.special as s\n"
        "assert s.zeta is s._basic.zeta and s.ndtri is s._ufuncs.ndtri\n"
        "assert s is sys.modules['scipy.special'] and type(s) is type(sys)\n"
        "print(len(set(s.__all__) - set(dir(s))), s.gamma(5.0))"
    )
    assert told(program) == "0 24.0"


@pytest.mark.ci
def test_threads_that_ask_at_once():
    program = (
        "import scipy.special as s\n"
        "from concurrent.futures import ThreadPoolExecutor\n"
        "with ThreadPoolExecutor(8) as pool:\n"
        "    print({pool.submit(lambda: s.erf(0.0)).result() for _ in range(8)})"
    )
    assert told(program) == "{np.float64(0.0)}"


@pytest.mark.ci
def test_an_unknown_name_is_refused():
    program = "import scipy.special as s\nprint(hasattr(s, 'nothing'))"
    assert told(program) == "False"


@pytest.mark.ci
def test_the_physics_engine_runs_when_it_is_used():
    program = (
        "import mujoco\nimport mujoco\nprint('mujoco._structs' in sys.modules)\n"
        "mujoco.MjModel\nimport mujoco.batch\n"
        "print('mujoco._structs' in sys.modules, type(mujoco) is type(sys))"
    )
    assert told(program) == "False\nTrue True"


@pytest.mark.ci
def test_a_package_that_fails_says_why():
    program = (
        "import mujoco\nsys.modules['mujoco._version'] = None\n"
        "try: mujoco.MjModel\n"
        "except ImportError as error: print(error)\n"
        "del sys.modules['mujoco._version']; print(mujoco.MjModel.__name__)"
    )
    *said, found = told(program).splitlines()
    assert "mujoco" in "".join(said)
    assert found == "MjModel"  # it runs again when it is asked again
