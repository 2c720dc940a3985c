"""A check of a function that only this process has, without a file or a child.

A closure or a lambda of a test is in no file that another process could load, so it is
measured where it is, by the same study, and judged by the same gate. Nothing stops it
here if it does not end.
"""

import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from simval.check.cells import settings_of
from simval.check.limits import missed_limits
from simval.check.measure import Checked
from simval.errors import CrashedPluginError, InputError, PluginError
from simval.judge import GateResult, judge_run, read_baseline, write_baseline
from simval.plugins import Calibrator, Estimator, Filter
from simval.plugins.declarations import declarations
from simval.plugins.loading import Meant
from simval.results import Outcome, Row
from simval.studies import STUDIES, calibrator, estimator, filter
from simval.studies.study import Cell
from simval.sweep.cells import REFUSED, CellResult
from simval.sweep.provenance import manifest
from simval.sweep.run import Run
from simval.sweep.suite import expand
from simval.text import message_of
from simval.verdict import ALPHA

Measure = Callable[[Any, Any, Any], Outcome]

MEASURES: Final[Mapping[type, Measure]] = MappingProxyType(
    {
        Estimator: estimator.outcome,
        Calibrator: calibrator.outcome,
        Filter: filter.outcome,
    }
)
"""What measures a plug-in that this process holds."""

FIRST: Final = MappingProxyType(
    {Estimator: "estimate", Calibrator: "calibrate", Filter: "make"}
)
"""The field that is the algorithm itself."""

NUMPYS_OWN: Final[Mapping[str, Any]] = MappingProxyType(
    {"divide": "warn", "over": "warn", "under": "ignore", "invalid": "warn"}
)
"""What NumPy does about floating-point errors if it is not told otherwise."""

OURS = Path(__file__).parents[1]

Held = Estimator | Calibrator | Filter
Algorithm = Callable[..., Any] | Held


def check_function(
    algorithm: Algorithm,
    kind: type[Held],
    /,
    *,
    seed: int = 1,
    alpha: float = ALPHA,
    limits: Iterable[str] = (),
    baseline: str | Path | None = None,
    update_baseline: str = "",
    **words: Any,
) -> Checked:
    """Measure and judge a function in this process.

    Parameters
    ----------
    algorithm : callable, Estimator, Calibrator or Filter
        The function, or all of a plug-in.
    kind : type
        `Estimator`, `Calibrator` or `Filter`: what the function is.
    seed : int, default 1
        Of the noise: the same one gives the same numbers.
    alpha : float, default ALPHA
        False-alarm rate of all checks together.
    limits : iterable of str, default ()
        A user's own, such as ``"rms < 1.1 bounds"``: see `simval.check.limits`.
    baseline : path, optional
        A file of the gate, with which the values are compared.
    update_baseline : str, default ""
        Why the values are written to it; only if they pass without it.
    **words
        What `kind` declares, and parameters of the study; a list of values of a
        parameter is a cell for each. Where both have a word of that name, True and
        False declare.

    Returns
    -------
    Checked
        What was measured, and the gate's answer.

    Raises
    ------
    InputError
        If a word is none of either, or its value is not allowed; a limit is of
        nothing that was measured, or the baseline cannot be read or written.
    """
    study, _, field = kind.taken_by.partition(".")
    declared, settings = _sorted_out(kind, study, words)
    plugin = _plugin(algorithm, kind, declared)
    held = Meant(kind.taken_by, plugin.name, plugin.name, declarations(plugin))
    table = {**settings_of(held), **settings, field: plugin.name}
    suite = expand("check", {"seed": seed, study: table})
    cells = tuple(_ended(i, cell, plugin) for i, cell in enumerate(suite.cells))
    found = {} if baseline is None else manifest(suite)
    run = Run(folder=Path("check"), cells=cells, manifest=found, timing={})
    return Checked(
        plugins=(held,),
        cells=cells,
        result=_judged(run, baseline, update_baseline, alpha),
        missed=tuple(missed_limits(limits, cells)),
    )


def _judged(
    run: Run, baseline: str | Path | None, reason: str, alpha: float
) -> GateResult:
    """Judge a run, beside the baseline if there is one; and make it the baseline."""
    if baseline is None:
        return judge_run(run, None, alpha)
    if reason and judge_run(run, None, alpha).exit_code == 0:
        write_baseline(Path(baseline), run, reason)
    return judge_run(run, read_baseline(Path(baseline)), alpha)


def _sorted_out(
    kind: type[Held], study: str, words: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is declared, and what is set."""
    own = {each.name for each in fields(kind)} - {FIRST[kind]}
    parameters = STUDIES[study].parameters
    set_by = set(parameters.model_fields) - {parameters.plugin, "time_limit"}
    if unknown := words.keys() - own - set_by:
        listed = ", ".join(f"`{word}`" for word in sorted(unknown))
        msg = (
            f"{listed} is no keyword here; {kind.__name__} declares "
            f"{', '.join(sorted(own))}; the study `{study}` has "
            f"{', '.join(sorted(set_by))}; and there are `seed`, `alpha`, "
            "`limits` and `baseline`"
        )
        raise InputError(msg)
    declared = {
        word
        for word in words.keys() & own
        if word not in set_by or isinstance(words[word], bool)
    }
    return (
        {word: words[word] for word in declared},
        {word: _listed(value) for word, value in words.items() if word not in declared},
    )


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _plugin(
    algorithm: Any,
    kind: type[Held],
    declared: Mapping[str, Any],
) -> Held:
    if isinstance(algorithm, kind):
        if declared:
            words = ", ".join(f"`{word}`" for word in sorted(declared))
            msg = f"{words} is for a function; the {kind.__name__} declares it itself"
            raise InputError(msg)
        return algorithm
    name = getattr(algorithm, "__name__", type(algorithm).__name__)
    try:
        return kind(**{"name": name, **declared, FIRST[kind]: algorithm})
    except (TypeError, PluginError) as error:
        msg = f"{name} cannot be used as it is declared: {error}"
        raise InputError(msg) from None


def _ended(position: int, cell: Cell, plugin: Held) -> CellResult:
    start, error = time.process_time(), ""
    rows: tuple[Row, ...] = ()
    # a test's own settings must not change what is measured
    with warnings.catch_warnings(), np.errstate(**NUMPYS_OWN):
        warnings.simplefilter("default")
        try:
            rows = MEASURES[type(plugin)](plugin, cell.parameters, cell.streams).rows
        except CrashedPluginError as crash:
            error = _told(crash)
        except PluginError as refusal:
            error = f"{REFUSED}{refusal}\n"
        except SystemExit as ending:
            error = f"the plug-in raised {message_of(ending)}\n"
    return CellResult(
        position=position,
        name=cell.name,
        study=cell.study,
        seed=cell.seed,
        parameters=cell.parameters.named(),
        status="failed" if error else "done",
        error=error,
        seconds=time.process_time() - start,
        rows=rows,
    )


def _told(crash: CrashedPluginError) -> str:
    """Frames of the user's own code, then the message."""
    cause = crash.__cause__
    frames = traceback.extract_tb(None if cause is None else cause.__traceback__)
    own = [frame for frame in frames if not Path(frame.filename).is_relative_to(OURS)]
    return f"{''.join(traceback.format_list(own))}{crash}\n"
