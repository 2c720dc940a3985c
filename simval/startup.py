"""MuJoCo and `scipy.special` in a process of our own: they run when they are used.

`import mujoco` takes twice what `import numpy` does, and many a command reads about
scenes and builds none. `scipy.special` takes three times as much, as it runs 400
modules, `numpy.f2py` and `numpy.testing` among them, to serve arrays of other
libraries. Its functions are in one compiled module. After `load_lightly` the package
has `FUNCTIONS` of that module, and runs the rest when any other name is asked for.
They are the same objects either way: no bit of a result can depend on it
(`tests/test_startup.py`).

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
    from importlib.abc import Loader, MetaPathFinder
else:  # these import what reads archives, in 0.02 s
    Loader = MetaPathFinder = object

COMPILED: Final = {"mujoco": "", "scipy.special": "scipy.special._ufuncs"}
"""Packages that run when something is asked of them, and where `FUNCTIONS` are."""
FUNCTIONS: Final = (
    "betainc",
    "binom",
    "chdtr",
    "chdtrc",
    "chdtri",
    "fdtrc",
    "fdtri",
    "gammaincc",
    "gammainccinv",
    "gammaincinv",
    "gammaln",
    "ndtr",
    "ndtri",
    "stdtr",
    "stdtrit",
)
"""Those of which answers and verdicts are made."""
_RUNNING = threading.RLock()
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


class _Package(ModuleType):
    # the package before its own text has run; without a path, so that the import
    # system, too, asks for one before it looks for any other module in it
    _rest: tuple[Loader, list[str]]

    def __getattr__(self, name: str) -> Any:
        with _RUNNING:
            if type(self) is _Package:
                self._run(name)
        return getattr(self, name)

    def _run(self, name: str) -> None:
        # run the text of the package, which asks for what it has yet to import
        if "__path__" in vars(self):
            msg = f"module {self.__name__!r} has no attribute {name!r}"
            raise AttributeError(msg, name=name, obj=self)
        loader, self.__path__ = self._rest
        try:
            _execute(loader, self)
        except BaseException:
            del self.__path__  # asked again, it runs again
            raise
        self.__class__ = ModuleType  # type: ignore[assignment]


def _execute(loader: Loader, module: ModuleType) -> None:
    # run the text of a package; MuJoCo's without a renderer if it fails with one
    try:
        loader.exec_module(module)
    except Exception:
        if module.__name__ != "mujoco":
            raise
        with no_renderer():
            loader.exec_module(module)


class _Light(Loader):
    # gives the package its compiled functions, and its own loader for the rest
    def __init__(self, own: Loader) -> None:
        self.own = own

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self.own.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        module.__class__ = _Package
        try:
            functions = _functions(COMPILED[module.__name__])
        except (ImportError, AttributeError):  # of another SciPy
            module.__class__ = ModuleType
            self.own.exec_module(module)
        else:
            vars(module).update(functions, _rest=(self.own, module.__path__))
            del module.__path__


def _functions(place: str) -> dict[str, Any]:
    # the compiled functions that a package has before its text has run
    if not place:
        return {}
    compiled = import_module(place)
    return {name: getattr(compiled, name) for name in FUNCTIONS}


class _Loaded(Loader):
    # for a module that was imported while the path to it was asked for
    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return sys.modules[spec.name]

    def exec_module(self, module: ModuleType) -> None:
        pass


class _Finder(MetaPathFinder):
    # finds both where they are
    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None = None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        if fullname in COMPILED:
            spec = PathFinder.find_spec(fullname, path)
            if spec is not None and spec.loader is not None:
                spec.loader = _Light(spec.loader)
            return spec
        if fullname.startswith(tuple(f"{p}." for p in COMPILED)) and (
            fullname in sys.modules
        ):
            return None if target is not None else ModuleSpec(fullname, _Loaded())
        return None


def load_lightly() -> None:
    """Let `scipy.special` run no more than what it is asked for, in this process."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
