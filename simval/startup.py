"""MuJoCo and `scipy.special` in a process of our own: they run when they are used.

`import mujoco` takes twice what `import numpy` does, and many a command reads about
scenes and builds none. `scipy.special` takes three times as much, as it runs 400
modules, `numpy.f2py` and `numpy.testing` among them, to serve arrays of other
libraries. Its functions are in one compiled module. After `load_lightly` the package
has `FUNCTIONS` of that module, and runs the rest when any other name is asked for.
They are the same objects either way: no bit of a result can depend on it. A command
that judges or lists starts 0.3 to 0.6 s earlier.

The program and its workers call it. A user's process that imports simval is the
user's, and is left as it is.
"""

import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from importlib.abc import Loader
else:  # it imports what reads archives, in 0.02 s
    Loader = object

COMPILED: Final = {"mujoco": "", "scipy.special": "scipy.special._ufuncs"}
"""Packages that run when something is asked of them, and where `FUNCTIONS` are."""
FUNCTIONS: Final = (
    *("betainc", "binom", "chdtr", "chdtrc", "chdtri", "fdtrc", "fdtri", "gammaincc"),
    *("gammainccinv", "gammaincinv", "gammaln", "ndtr", "ndtri", "stdtr", "stdtrit"),
)
"""Those of which answers and verdicts are made."""
RENDERER: Final = "MUJOCO_GL"
"""Environment variable by which MuJoCo chooses a graphics library."""


@contextmanager
def no_renderer() -> Iterator[None]:
    """Let MuJoCo be imported for its physics alone, whatever `RENDERER` says.

    It ends its own import where the variable names a library that is not there.
    """
    wanted = os.environ.get(RENDERER)
    os.environ[RENDERER] = "disable"
    try:
        yield
    finally:
        if wanted is None:
            del os.environ[RENDERER]
        else:
            os.environ[RENDERER] = wanted


class _Light(Loader):
    """Finds the packages of `COMPILED`, and runs each when it is asked for a name."""

    def __init__(self) -> None:
        self.own: dict[str, Loader] = {}

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None = None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(fullname, path) if fullname in COMPILED else None
        if spec is not None and spec.loader is not None:
            self.own[fullname], spec.loader = spec.loader, self
        return spec

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return None

    def exec_module(self, module: ModuleType) -> None:
        members, lock, runs = vars(module), threading.RLock(), False

        def ask(name: str) -> Any:
            nonlocal runs
            with lock:  # another thread waits until it has run
                if "__getattr__" in members and not runs:
                    runs = True
                    try:
                        self._run(module)
                        del members["__getattr__"]
                    finally:
                        runs = False
            if name in members:
                return members[name]
            msg = f"module {module.__name__!r} has no attribute {name!r}"
            raise AttributeError(msg, name=name, obj=module)

        place = COMPILED[module.__name__]
        try:
            compiled = import_module(place) if place else None
            members.update({f: getattr(compiled, f) for f in FUNCTIONS if place})
        except (ImportError, AttributeError):  # of another SciPy
            self._run(module)
        else:
            members["__getattr__"] = ask

    def _run(self, module: ModuleType) -> None:
        # MuJoCo's without a renderer if it fails with one
        try:
            self.own[module.__name__].exec_module(module)
        except Exception:
            if module.__name__ != "mujoco":
                raise
            with no_renderer():
                self.own[module.__name__].exec_module(module)


def load_lightly() -> None:
    """Let `scipy.special` run no more than what it is asked for, in this process."""
    if not any(isinstance(finder, _Light) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Light())
