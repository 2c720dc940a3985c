"""Pytest plug-in: judge a test's own function like a plug-in of simval.

    def test_my_estimator(simval_estimator):
        simval_estimator(my_function, components="sxyz", matrix="active")

Each fixture returns what was measured, a `simval.check.Checked`. Beside what it
declares and sets, a test may state limits of its own and a baseline:

    found = simval_filter(make, limits=["rms < 1.1 bounds", "settling < 5 s"])
    simval_calibrator(fit, baseline="tests/fit.json")

``pytest --simval-update-baseline WHY`` writes the baselines of the tests that it runs.

Installed with the package, and loaded by every pytest: nothing but pytest is imported
until a test asks for a fixture.
"""

from collections.abc import Callable
from typing import Any

import pytest

Check = Callable[..., Any]

UPDATE = "--simval-update-baseline"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that writes baselines."""
    parser.addoption(
        UPDATE,
        default="",
        metavar="WHY",
        help="write the baselines of tests with simval's fixtures, and why they change",
    )


@pytest.fixture(scope="session")
def simval_estimator(pytestconfig: pytest.Config) -> Check:
    """Judge an attitude estimator: ``simval_estimator(function, components=...)``.

    Keywords are what `simval.plugins.Estimator` declares, parameters of the study
    ``estimator`` (``noise_std``, ``geometry``, ``samples``), ``seed``, and ``alpha``,
    the false-alarm rate of all checks together.
    """
    return _judging("Estimator", pytestconfig)


@pytest.fixture(scope="session")
def simval_calibrator(pytestconfig: pytest.Config) -> Check:
    """Judge a calibrator: ``simval_calibrator(function)``.

    Keywords are what `simval.plugins.Calibrator` declares, parameters of the study
    ``calibrator`` (``noise_std``, ``poses``, ``trials``), ``seed``, and ``alpha``.
    """
    return _judging("Calibrator", pytestconfig)


@pytest.fixture(scope="session")
def simval_filter(pytestconfig: pytest.Config) -> Check:
    """Judge an attitude filter: ``simval_filter(make, components=...)``.

    Keywords are what `simval.plugins.Filter` declares, parameters of the study
    ``filter`` (``scenario``, ``seconds``, ``trials``), ``seed``, and ``alpha``.
    """
    return _judging("Filter", pytestconfig)


@pytest.fixture(scope="session")
def simval_audit() -> Check:
    """Judge a simulated IMU: ``simval_audit(imu, lever=(0, 0, 0))``.

    `imu` is a `simval.imu.audit.SimulatedImu`; keywords are what `Declared` has, and
    ``only``, ``alpha`` of `simval.imu.audit.audit`. What the motion does not tell
    fails, too, unless ``only`` leaves it out.
    """

    def check(imu: Any, /, *, only: Any = (), alpha: float = 1e-3, **words: Any) -> Any:
        __tracebackhide__ = True
        from simval.imu.audit import Declared, audit

        found = audit(imu, Declared(**words), only=only, alpha=alpha)
        if found.exit_code:
            pytest.fail(str(found), pytrace=False)
        print(found)  # noqa: T201, for pytest's -rP and -s
        return found

    return check


def _judging(kind: str, config: pytest.Config) -> Check:
    def check(function: Any, /, **words: Any) -> Any:
        __tracebackhide__ = True
        from simval import plugins
        from simval.check import check_function
        from simval.errors import SimvalError

        checked, why = None, config.getoption(UPDATE)
        own = getattr(plugins, kind)
        try:
            checked = check_function(function, own, **words, update_baseline=why)
            text = str(checked)
        except SimvalError as error:
            text = str(error).replace("--update-baseline", UPDATE)
        if checked is None or not checked.good:  # not above: it would be reported twice
            pytest.fail(text, pytrace=False)
        print(text)  # noqa: T201, for pytest's -rP and -s
        return checked

    return check
