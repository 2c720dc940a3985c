"""A fault as data: what it breaks in which suite, and the function that it replaces."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal

from simval.imu.filters import Mekf, mekf

Part = Literal["estimator", "formula", "noise", "sensor", "scene", "calibrator", "run"]


@dataclass(frozen=True, slots=True)
class Fault:
    """One injected fault: ``change(original, *arguments)`` takes a function's place."""

    suite: str  # key of `power.matrix.SUITES`
    part: Part  # where in the flow it is
    owner: Any  # module or class that has the function
    function: str
    name: str  # what is wrong, in words
    change: Callable[..., Any] | None = None
    everywhere: bool = False  # wherever a module has it: the fault is in its own lines
    # Why theory alone cannot see it; its run is then compared with a baseline too. A
    # fault that has such a reason and is seen by theory makes the catalogue wrong.
    baseline: str = ""
    # Whether a cell is expected to crash. An unexpected crash is a fault of the
    # injection, and does not count as a detection.
    crash: bool = False
    stops: bool = False  # whether the driver stops; then the unfinished run is judged
    context: Callable[[], AbstractContextManager[None]] | None = None  # instead

    def inject(self) -> AbstractContextManager[None]:
        """A context in which the flow is broken."""
        if self.context:
            return self.context()
        broken = changed(self.owner, self.function, self.change, self.everywhere)
        return in_numpy(broken) if self.owner in (Mekf, mekf) else broken


@contextmanager
def in_numpy(broken: AbstractContextManager[None]) -> Iterator[None]:
    """A broken filter in the NumPy form, which is the definition."""
    with replaced(mekf, "_compiled", lambda: None), broken:
        yield


@contextmanager
def replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Replace an attribute while the context lasts."""
    before = owner.__dict__[name]
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


@contextmanager
def changed(owner: Any, name: str, change: Any, everywhere: bool = False) -> Any:
    """Wrap a function of the flow while the context lasts."""
    original = owner.__dict__[name]

    def broken(*arguments: Any, **options: Any) -> Any:
        return change(original, *arguments, **options)

    owners = [m for m in list(sys.modules.values()) if vars(m).get(name) is original]
    with ExitStack() as stack:
        for each in owners if everywhere else [owner]:
            stack.enter_context(replaced(each, name, broken))
        yield


def then(change: Callable[[Any], Any]) -> Callable[..., Any]:
    """Change what a function returns."""
    return lambda original, *arguments, **options: change(
        original(*arguments, **options)
    )


def times(factor: float) -> Callable[..., Any]:
    """Multiply what a function returns."""
    return then(lambda value: factor * value)


def result(**changes: Callable[[Any], Any]) -> Callable[..., Any]:
    """Change fields of what a function returns, each by the whole of it."""
    return then(lambda whole: changed_fields(whole, changes))


def given(**changes: Callable[[Any], Any]) -> Callable[..., Any]:
    """Change fields of what a function is given first, each by the whole of it."""
    return lambda original, first, *arguments, **options: original(
        changed_fields(first, changes), *arguments, **options
    )


def changed_fields(whole: Any, changes: dict[str, Callable[[Any], Any]]) -> Any:
    """A copy with other values of some fields."""
    return replace(whole, **{name: f(whole) for name, f in changes.items()})


def told(**changes: Callable[[Any], Any]) -> Callable[..., Any]:
    """Change the arguments that a function is given by name."""
    return lambda original, *arguments, **options: original(
        *arguments, **options | {k: f(options[k]) for k, f in changes.items()}
    )


def told_instead(**values: Any) -> Callable[..., Any]:
    """Give a function these values by name, whatever it was given."""
    return lambda original, *arguments, **options: original(
        *arguments, **options | values
    )
