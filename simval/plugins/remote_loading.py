"""Find a plug-in in another process.

What it declares is what its process says, and is checked as where it is declared; its
functions are the process's answers, whose shapes must be those that were asked for, and
which are then judged like those of a function that we hold.
"""

from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Final, TypeVar

from simval.plugins.filter_protocol import Filter
from simval.plugins.protocol import Calibrator, Estimator, Plugin
from simval.plugins.remote import RemoteCalibrator, RemoteEstimator
from simval.plugins.remote_filter import RemoteFilter
from simval.plugins.session import Session

Kind = TypeVar("Kind", bound=Plugin)

REMOTE: Final[Mapping[type[Plugin], Any]] = MappingProxyType(
    {
        Estimator: RemoteEstimator,
        Calibrator: RemoteCalibrator,
        Filter: RemoteFilter,
    }
)


def remote(session: Session, word: str, kind: type[Kind]) -> Kind:
    """Find a plug-in in another process, by its word.

    Raises
    ------
    PluginError
        If it cannot be used.
    """
    asked, says = {"word": word, "kind": kind.taken_by}, ("declared", "gives")
    answer = session.ask("find", asked, says=says)
    known = {each.name for each in fields(kind)}  # type: ignore[arg-type]
    declared, gives = answer.words.get("declared"), answer.words.get("gives")
    if not isinstance(declared, dict) or not isinstance(gives, list):
        msg = "it declares nothing"
        raise session.unreadable(msg)
    values = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in declared.items()
    }
    values |= {str(name): _elsewhere for name in gives}
    if not values.keys() <= known:
        msg = "it declares what there is not"
        raise session.unreadable(msg)
    try:
        found: Kind = REMOTE[kind](**values, session=session)
    except TypeError as error:
        raise session.unreadable(error) from None
    return found


def _elsewhere(*_: Any, **__: Any) -> Any:
    msg = "this function is in another process"
    raise AssertionError(msg)
