"""A fault: what it breaks, in which suite, and how it is injected into the flow."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

Inject = Callable[[], AbstractContextManager[None]]
Part = Literal["estimator", "formula", "noise", "sensor", "scene", "calibrator", "run"]


@dataclass(frozen=True, slots=True)
class Fault:
    """One injected fault."""

    suite: str  # key of `simval.selftest.matrix.SUITES`
    part: Part  # where in the flow it is
    name: str  # what is wrong, in words
    inject: Inject  # gives a context in which the flow is broken
    _: KW_ONLY
    # whether the run is compared with a stored baseline too: for faults that theory
    # cannot see, because every number is right by itself
    baseline: bool = False
    # Whether a cell is expected to crash. An unexpected crash is a fault of the
    # injection, and does not count as a detection.
    crash: bool = False
    stops: bool = False  # whether the driver stops; then the unfinished run is judged


@contextmanager
def replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Replace an attribute while the context lasts."""
    before = owner.__dict__[name]
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


def wrapped(owner: Any, name: str, change: Callable[..., Any]) -> Inject:
    """Wrap a function of the flow: ``change(original, *arguments)`` takes its place."""

    def inject() -> AbstractContextManager[None]:
        original = owner.__dict__[name]

        def broken(*arguments: Any, **options: Any) -> Any:
            return change(original, *arguments, **options)

        return replaced(owner, name, broken)

    return inject


def after(owner: Any, name: str, change: Callable[[Any], Any]) -> Inject:
    """Change what a function of the flow returns."""

    def broken(original: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        return change(original(*arguments, **options))

    return wrapped(owner, name, broken)
