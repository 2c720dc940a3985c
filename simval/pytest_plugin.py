"""Plug-in of pytest: a test's own function, measured and judged as a plug-in is.

    def test_my_estimator(simval_estimator):
        simval_estimator(my_function, components="sxyz", matrix="active")

Installed with the package, and loaded by every pytest: nothing but pytest is imported
until a test asks for a fixture.
"""

from collections.abc import Callable
from typing import Any

import pytest

Check = Callable[..., None]


@pytest.fixture(scope="session")
def simval_estimator() -> Check:
    """Judge an attitude estimator: ``simval_estimator(function, components=...)``.

    Keywords are what `simval.plugins.Estimator` declares, parameters of the study
    ``estimator`` (``noise_std``, ``geometry``, ``samples``), ``seed``, and ``alpha``,
    the false-alarm rate of all checks together.
    """

    def check(function: Any, /, **words: Any) -> None:
        __tracebackhide__ = True
        from simval.plugins import Estimator

        _judge(function, Estimator, words)

    return check


@pytest.fixture(scope="session")
def simval_calibrator() -> Check:
    """Judge a calibrator: ``simval_calibrator(function)``.

    Keywords are what `simval.plugins.Calibrator` declares, parameters of the study
    ``calibrator`` (``noise_std``, ``poses``, ``trials``), ``seed``, and ``alpha``.
    """

    def check(function: Any, /, **words: Any) -> None:
        __tracebackhide__ = True
        from simval.plugins import Calibrator

        _judge(function, Calibrator, words)

    return check


@pytest.fixture(scope="session")
def simval_filter() -> Check:
    """Judge an attitude filter: ``simval_filter(make, components=...)``.

    Keywords are what `simval.plugins.Filter` declares, parameters of the study
    ``filter`` (``scenario``, ``seconds``, ``trials``), ``seed``, and ``alpha``.
    """

    def check(function: Any, /, **words: Any) -> None:
        __tracebackhide__ = True
        from simval.plugins import Filter

        _judge(function, Filter, words)

    return check


def _judge(function: Any, kind: Any, words: dict[str, Any]) -> None:
    __tracebackhide__ = True
    from simval.check import check_function, told
    from simval.errors import SimvalError

    try:
        checked = check_function(function, kind, **words)
        text, good = told(checked), checked.result.exit_code == 0
    except SimvalError as error:
        text, good = str(error), False
    if not good:  # not above: the error would be told a second time
        pytest.fail(text, pytrace=False)
    print(text)  # noqa: T201, for pytest's -rP and -s
