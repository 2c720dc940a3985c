"""In the child: what studies ask of a plug-in, beside the plug-in's own answers."""

from collections.abc import Mapping
from types import MappingProxyType, SimpleNamespace
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.plugins.messages import Message
from simval.plugins.serving import Question, Served, serve
from simval.studies.call_time import call_time


def _series(served: Served, words: Any, arrays: Mapping[str, Array]) -> Message:
    from simval.studies.estimator_series import series

    return Message(words={}, arrays=series(served.plugin, words, arrays))


def _times(served: Served, words: Any, _: Mapping[str, Array]) -> Message:
    parameters = SimpleNamespace(**words["parameters"])
    taken_by = served.plugin.taken_by
    return Message(words={"times": call_time(taken_by, served.word, parameters)})


def _trajectory(_: Served, words: Any, __: Mapping[str, Array]) -> Message:
    from simval.scene import simulate
    from simval.studies.custom_scene import BY_ROW, ONCE

    found = simulate(words["scene"])
    arrays = {
        name: np.asarray(getattr(found, name), dtype=float) for name in (*BY_ROW, *ONCE)
    }
    return Message(words={}, arrays=arrays)


MORE: Final[Mapping[str, Question]] = MappingProxyType(
    {"series": _series, "times": _times, "trajectory": _trajectory}
)


def answer() -> None:
    """Answer the questions of any study."""
    serve(MORE)
