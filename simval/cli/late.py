"""Parts of NumPy that most commands never need, imported on first use."""

import importlib.util
import sys

import numpy as np

UNUSED = ("f2py", "testing", "random")
"""Of NumPy: SciPy asks for every name of it, and these three take 50 ms of its 110."""


def postpone() -> None:
    """Delay the import of the modules in `UNUSED` until somebody reads from them."""
    for name in UNUSED:
        spec = importlib.util.find_spec(f"numpy.{name}")
        if spec is None or spec.loader is None or spec.name in sys.modules:
            continue
        spec.loader = importlib.util.LazyLoader(spec.loader)
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)
        setattr(np, name, module)  # an import statement would look into it
