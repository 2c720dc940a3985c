"""Keep linear algebra to one thread while cells are computed.

A product of matrices is summed in another order on two threads than on one, so its last
bits would depend on the number of processors. Libraries that are loaded are set by
`threadpoolctl`, those that a cell loads read the environment, and so does a plug-in's
own process. When the last cell has ended, all is as the caller had it.
"""

import os
from collections import Counter
from threading import Lock, get_ident
from typing import Any, Final

VARIABLES: Final = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
)
"""Variables that a library of linear algebra reads when it is loaded."""


class OneThread:
    """A context in which linear algebra has one thread; it may be nested."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._inside: Counter[int] = Counter()  # how often, by thread
        self._words: dict[str, str | None] = {}
        self._before: dict[str, int] = {}  # threads of each library, by its file

    def __enter__(self) -> None:
        with self._lock:
            own = get_ident()
            if own not in self._inside:  # OpenMP counts for each thread
                self._hold(_libraries())
            self._inside[own] += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            own = get_ident()
            self._inside[own] -= 1
            if not self._inside[own]:
                del self._inside[own]
            if not self._inside:
                self._restore()

    def _hold(self, libraries: list[Any]) -> None:
        if not self._inside:
            self._words = {name: os.environ.get(name) for name in VARIABLES}
            os.environ.update(dict.fromkeys(VARIABLES, "1"))
            self._before = {lib.filepath: lib.num_threads for lib in libraries}
        for library in libraries:
            library.set_num_threads(1)

    def _restore(self) -> None:
        for name, value in self._words.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
        # one that a cell has loaded gets what the others have
        usual = max(self._before.values(), default=os.cpu_count() or 1)
        for library in _libraries():
            library.set_num_threads(self._before.get(library.filepath, usual))


ONE_THREAD: Final = OneThread()
"""The one of this process."""


def linear_algebra() -> str:
    """Library and processor kernels of NumPy's linear algebra."""
    found = [lib.info() for lib in _libraries() if lib.user_api == "blas"]
    # SciPy's wheel brings one too, of the same kind, which is loaded when it is used
    found.sort(key=lambda info: ("numpy" not in info["filepath"], info["filepath"]))
    if not found:
        return "unknown"
    words = (found[0].get(key) for key in ("internal_api", "version", "architecture"))
    return " ".join(word for word in words if word)


def _libraries() -> list[Any]:
    from threadpoolctl import ThreadpoolController

    return list(ThreadpoolController().lib_controllers)
