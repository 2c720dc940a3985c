"""A fault: what it breaks, in which suite, and how it is injected into the flow."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import KW_ONLY, dataclass
from typing import Any, Literal

Inject = Callable[[], AbstractContextManager[None]]
Part = Literal["estimator", "formula", "noise", "sensor", "scene", "calibrator", "run"]


@dataclass(frozen=True, slots=True)
class Fault:
    """One injected fault."""

    suite: str  # key of `power.matrix.SUITES`
    part: Part  # where in the flow it is
    name: str  # what is wrong, in words
    inject: Inject  # gives a context in which the flow is broken
    _: KW_ONLY
    # Why theory alone cannot see it; its run is then compared with a baseline too. A
    # fault that has such a reason and is seen by theory makes the catalogue wrong.
    baseline: str = ""
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


def everywhere(owner: Any, name: str, change: Callable[..., Any]) -> Inject:
    """Wrap a function wherever a module has it: the fault is in its own lines."""

    @contextmanager
    def inject() -> Iterator[None]:
        original = getattr(owner, name)

        def broken(*arguments: Any, **options: Any) -> Any:
            return change(original, *arguments, **options)

        with ExitStack() as stack:
            for module in list(sys.modules.values()):
                if vars(module).get(name) is original:
                    stack.enter_context(replaced(module, name, broken))
            yield

    return inject


def after(owner: Any, name: str, change: Callable[[Any], Any]) -> Inject:
    """Change what a function of the flow returns."""

    def broken(original: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        return change(original(*arguments, **options))

    return wrapped(owner, name, broken)
