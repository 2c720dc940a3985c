"""The package's own algorithms as plug-ins: what a user's is set beside.

They are entry points as any package has them, ``simval:NAME``, and are measured by the
same studies on the same terms. Their code is in `simval.algorithms`, loaded only when
one is asked for.
"""

from collections.abc import Mapping
from importlib import metadata
from importlib.metadata import EntryPoint
from types import MappingProxyType
from typing import Any, Final

from simval.plugins.filter_protocol import Filter
from simval.plugins.protocol import Calibrator, Estimator
from simval.text import nearest

GROUP: Final = "simval.plugins"
PREFIX: Final = "simval:"

_ESTIMATORS = ("wahba", "weighted-wahba", "triad", "closed-form", "combined")
_CALIBRATORS = ("squared", "norm", "weighted", "sampson", "adjusted")
_FILTERS = ("mekf",)

BUILTIN: Final[Mapping[str, EntryPoint]] = MappingProxyType(
    {
        f"{PREFIX}{name}": EntryPoint(
            name=f"{PREFIX}{name}",
            value=f"simval.algorithms:{name.replace('-', '_')}",
            group=GROUP,
        )
        for name in (*_ESTIMATORS, *_CALIBRATORS, *_FILTERS)
    }
)
"""By the name that suites and the command line call it."""

BESIDE: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        Estimator.taken_by: (f"{PREFIX}wahba", f"{PREFIX}triad"),
        Calibrator.taken_by: (f"{PREFIX}squared",),
        Filter.taken_by: (f"{PREFIX}mekf",),
    }
)
"""What ``--plugin`` adds beside a user's, by the field: the optimum first, whose time
is the unit of a call's; of estimators the plainest one too."""


def meant_builtin(word: str) -> str:
    """Words that ask whether one of these was meant; none if none is near."""
    own = {name.removeprefix(PREFIX): name for name in BUILTIN}
    near = nearest(word.removeprefix(PREFIX), own)
    return f" (did you mean `{own[near[0]]}`?)" if near else ""


def points_of(name: str) -> tuple[Any, ...]:
    """Entry points of a name: the package's own, else those of installed packages.

    Of the standard library's kind, or of `importlib_metadata`'s, which some packages
    put in its place when they are imported.
    """
    if name in BUILTIN:
        return (BUILTIN[name],)
    return tuple(metadata.entry_points(group=GROUP, name=name))


def beside_builtin(
    chosen: Mapping[str, list[str]],
) -> dict[str, list[str]]:
    """Plug-ins by field, with the built-in ones where there is a user's."""
    return {
        field: [*words, *(own for own in BESIDE.get(field, ()) if own not in words)]
        if any(word not in BUILTIN for word in words)
        else words
        for field, words in chosen.items()
    }
