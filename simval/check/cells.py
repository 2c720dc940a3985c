"""The cells in which a plug-in is checked: few, cheap, and enough to be judged."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, Final

from simval.plugins.loading import Meant
from simval.plugins.names import COMMAND
from simval.plugins.protocol import Estimator
from simval.sweep.suite import Suite, expand

NOISE: Final = (0.01, 0.05)
"""Of a cell each: per axis of a unit vector, or of a pose mean in m/s²."""

TIME_LIMIT: Final = 120.0
"""Of a cell, s: whoever waits for a table wants to know what hangs."""

SETTINGS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        # rows resolved; a failure of 1.8 % of a class is missed once in a hundred
        "estimator": {
            "noise_std": list(NOISE),
            "samples": 4096,
            "cases": 256,
            "time_limit": TIME_LIMIT,
        },
        "calibrator": {"noise_std": list(NOISE), "time_limit": TIME_LIMIT},
        # 256 trials, which the gate needs to judge; coning shows in a fast motion
        "filter": {
            "scenario": ["gimbal slow", "gimbal fast"],
            "rate": 50.0,
            "seconds": 6.0,
            "time_limit": 5.0 * TIME_LIMIT,
        },
        "custom_scene": {"time_limit": TIME_LIMIT},
    }
)
"""What differs from the default of a study."""

TOLD: Final = ("body", "unequal")
"""Noise with which an estimator is checked that reads what noise there is."""

OF_A_COMMAND: Final[Mapping[str, Any]] = MappingProxyType(
    {"noise_std": NOISE[0], "trials": 896}
)
"""A process for each trial: one cell, and about the fewest trials to be judged by."""


def settings_of(plugin: Meant) -> dict[str, Any]:
    """What differs from the default of its study."""
    settings = SETTINGS.get(plugin.field.partition(".")[0], {})
    told = (
        plugin.field == Estimator.taken_by
        and plugin.declared.get("reads", "none") != "none"
    )
    return {**settings, "noise": list(TOLD)} if told else dict(settings)


def suite_of(plugins: Iterable[Meant], seed: int) -> Suite:
    """Suite that checks some plug-ins and nothing else."""
    content: dict[str, Any] = {"seed": seed}
    for each in plugins:
        study, _, field = each.field.partition(".")
        command = each.word.startswith(COMMAND)
        settings = OF_A_COMMAND if command else settings_of(each)
        table = content.setdefault(study, {field: []})
        table |= {**settings, **table}  # what one of a file needs, all of it have
        table[field].append(each.word)
    return expand("check", content)
