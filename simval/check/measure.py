r"""A check of plug-ins: by a sweep into a temporary folder, or in this process.

A closure or a lambda of a test is in no file that another process could load, so it is
measured where it is, by the same study, and judged by the same gate. Nothing stops it
here if it does not end.

A limit names a family of statistics, or one member as tables spell it, ``bias[K_x]``;
every value of that name must keep it, in every cell. The number is in the unit of the
statistic, which may be said, or in bounds: the Cramer-Rao bound of its row.
"""

import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from simval.account import Account, Told
from simval.errors import CrashedPluginError, InputError, PluginError
from simval.judge import Gap, GateResult, judge_run, read_baseline, write_baseline
from simval.plugins import Calibrator, Estimator, Filter
from simval.plugins.loading import Meant, meant
from simval.plugins.names import COMMAND, located, portable
from simval.plugins.protocol import declarations
from simval.results import Row
from simval.statistics import BELOW_BOUND, CRAMER_RAO, CUBATURE
from simval.studies import STUDIES
from simval.studies.plugin import outcome
from simval.studies.study import Cell
from simval.sweep import run_suite
from simval.sweep.cells import REFUSED, CellResult
from simval.sweep.provenance import manifest
from simval.sweep.run import Run
from simval.sweep.runner import Progress
from simval.sweep.suite import Suite, expand
from simval.verdict import ALPHA

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

READ_NOISE: Final = ("body", "unequal")
"""Noise with which an estimator is checked that reads what noise there is."""

OF_A_COMMAND: Final[Mapping[str, Any]] = MappingProxyType(
    {"noise_std": NOISE[0], "trials": 896}
)
"""A process for each trial: one cell, and about the fewest trials to be judged by."""


def settings_of(plugin: Meant) -> dict[str, Any]:
    """Settings that differ from the study's defaults."""
    settings = dict(SETTINGS.get(plugin.field.partition(".")[0], {}))
    reads = plugin.declared.get("reads", "none") != "none"
    if reads and plugin.field == Estimator.taken_by:
        settings["noise"] = list(READ_NOISE)
    return settings


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


BOUNDS = "bounds"
_FORM = re.compile(r"\s*([^<>]*?)\s*([<>])\s*([-+.\deE]+)\s*(\S*)\s*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """A limit that the user sets for a statistic."""

    text: str
    statistic: str
    below: bool
    number: float
    unit: str  # of the number; `BOUNDS`, or empty where it is not said

    def of(self, row: Row) -> bool:
        """True if the limit is about this row."""
        named = self.statistic in (str(row.statistic), row.statistic.family.name)
        return named and (self.unit != BOUNDS or _has_bound(row))

    def missed(self, row: Row) -> str:
        """Say what value a row has, if it breaks the limit; else nothing."""
        bounds = self.unit == BOUNDS
        if self.unit and not bounds and self.unit != row.unit:
            msg = f"limit {self.text!r}: {row.statistic} has the unit {row.unit}"
            raise InputError(msg)
        value = row.value / (row.prediction if bounds and row.prediction else 1.0)
        kept = value < self.number if self.below else value > self.number
        unit = f" {BOUNDS}" if bounds else "" if row.unit == "1" else f" {row.unit}"
        return "" if kept else f"{row.statistic} is {value:.4g}{unit}"


def _has_bound(row: Row) -> bool:
    """True if the row's prediction is the Cramér-Rao bound on its value."""
    return row.predictor == CRAMER_RAO and row.statistic.family != BELOW_BOUND


def limit_of(text: str) -> Limit:
    """Read a limit from its text."""
    found = _FORM.fullmatch(str(text))
    try:
        name, sign, number, unit = found.groups() if found else ("", "", "", "")
        return Limit(
            text=text, statistic=name, below=sign == "<", number=float(number),
            unit=unit,
        )  # fmt: skip
    except ValueError:
        msg = (
            f"limit {text!r} cannot be read; it must be a statistic, < or >, a number "
            'and its unit or "bounds": "rms < 1.1 bounds", "efficiency > 0.9"'
        )
        raise InputError(msg) from None


def missed_limits(limits: Iterable[str], cells: Sequence[CellResult]) -> Iterator[str]:
    """Say which limits are broken, in which cell, and with what value."""
    done = [cell for cell in cells if cell.status == "done"]
    for limit in map(limit_of, limits):
        rows = [(cell, row) for cell in done for row in cell.rows if limit.of(row)]
        if done and not rows:
            beside = limit.unit == BOUNDS
            names = {
                row.statistic.family.name
                for cell in done
                for row in cell.rows
                if not beside or _has_bound(row)
            }
            msg = (
                f"limit {limit.text!r}: no such statistic was "
                f"measured{' beside a bound' * beside}; there are "
                f"{', '.join(sorted(names))}"
            )
            raise InputError(msg)
        for cell, row in rows:
            if words := limit.missed(row):
                yield f"{limit.text}: {words} in {cell.name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Checked(Told):
    """The result of a check of some plug-ins."""

    plugins: tuple[Meant, ...]  # what each is called, and what it declares
    cells: tuple[CellResult, ...]  # what was measured of them
    result: GateResult
    missed: tuple[str, ...] = ()  # the user's own limits, each with what misses it

    @property
    def account(self) -> Account:
        """Everything that there is to say of the check."""
        from simval.check.explanation import account_of  # which is of this

        return account_of(self)

    @property
    def good(self) -> bool:
        """True if every judged row passes and every limit is kept."""
        return self.result.exit_code == 0 and not self.missed

    def of(self, plugin: Meant) -> tuple[CellResult, ...]:
        """Cells of one plug-in.

        Parameters
        ----------
        plugin : Meant
            One of `plugins`.

        Returns
        -------
        tuple of CellResult
            In the order of their noise.
        """
        study, _, field = plugin.field.partition(".")
        word = portable(located(plugin.word))
        return tuple(
            cell
            for cell in self.cells
            if cell.study == study and cell.parameters[field] == word
        )


def check_plugin(
    plugin: str,
    *,
    seed: int = 1,
    alpha: float = ALPHA,
    progress: Progress | None = None,
) -> Checked:
    """Measure and judge the plug-ins of a name.

    Parameters
    ----------
    plugin : str
        ``FILE.py``, ``FILE.py:NAME``, an entry point, or ``command: PROGRAM {poses}``.
    seed : int, default 1
        Of the noise: the same one gives the same numbers.
    alpha : float, default ALPHA
        False-alarm rate of all checks together.
    progress : Progress, optional
        Told of each cell.

    Returns
    -------
    Checked
        What was measured, and the gate's answer.
    """
    plugins = meant(plugin)
    suite = suite_of(plugins, seed)
    with TemporaryDirectory(prefix="simval-check-") as folder:
        run = run_suite(suite, Path(folder, "run"), workers=2, progress=progress)
    return Checked(
        plugins=tuple(plugins),
        cells=tuple(run.cells),
        result=_judged(run, None, alpha),
    )


UNSETTLED: Final = (
    "cubature of the function does not settle at this noise: it jumps, or is far from "
    "smooth"
)
"""Why a row by cubature is outside the range: what it leaves out is the function's."""


def _judged(run: Run, baseline: Mapping[str, Any] | None, alpha: float) -> GateResult:
    """Judge as the gate does, and count what cubature left open as not measured."""
    result = judge_run(run, baseline, alpha)
    unsettled = [pair for pair in result.outside if pair[1].predictor == CUBATURE]
    gaps = [Gap(cell=cell, reason=UNSETTLED) for cell in dict(unsettled)]
    return replace(result, gaps=(*result.gaps, *gaps))


NUMPYS_OWN: Final[Mapping[str, Any]] = MappingProxyType(
    {"divide": "warn", "over": "warn", "under": "ignore", "invalid": "warn"}
)
"""What NumPy does about floating-point errors if it is not told otherwise."""

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
        A user's own, such as ``"rms < 1.1 bounds"``: see `simval.check.measure`.
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
    cells = tuple(_measured(i, cell, plugin) for i, cell in enumerate(suite.cells))
    found = {} if baseline is None else manifest(suite)
    run = Run(folder=Path("check"), cells=cells, manifest=found, timing={})
    result = _judged(run, None, alpha)
    if baseline is not None:
        if update_baseline and result.exit_code == 0:
            write_baseline(Path(baseline), run, update_baseline)
        result = _judged(run, read_baseline(Path(baseline)), alpha)
    return Checked(
        plugins=(held,),
        cells=cells,
        result=result,
        missed=tuple(missed_limits(limits, cells)),
    )


def _sorted_out(
    kind: type[Held], study: str, words: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Separate the keywords of a fixture into declarations and settings."""
    own = {each.name for each in fields(kind)} - {kind.runs}
    parameters = STUDIES[study].parameters
    set_by = set(parameters.model_fields) - {parameters.plugin, "time_limit"}
    if unknown := words.keys() - own - set_by:
        listed = ", ".join(f"`{word}`" for word in sorted(unknown))
        msg = (
            f"{listed} is not a keyword of this fixture; {kind.__name__} "
            f"declares {', '.join(sorted(own))}, the study `{study}` has "
            f"{', '.join(sorted(set_by))}, and there are `seed`, `alpha`, "
            "`limits` and `baseline`"
        )
        raise InputError(msg)
    declared = {
        word: value
        for word, value in words.items()
        if word in own and (word not in set_by or isinstance(value, bool))
    }
    settings = {
        word: list(value) if isinstance(value, tuple) else value
        for word, value in words.items()
        if word not in declared
    }
    return declared, settings


def _plugin(
    algorithm: Any,
    kind: type[Held],
    declared: Mapping[str, Any],
) -> Held:
    if isinstance(algorithm, kind):
        if declared:
            words = ", ".join(f"`{word}`" for word in sorted(declared))
            msg = (
                f"{words} goes with a function; the {kind.__name__} declares it "
                "itself, so leave it out"
            )
            raise InputError(msg)
        return algorithm
    name = getattr(algorithm, "__name__", type(algorithm).__name__)
    try:
        return kind(**{"name": name, **declared, kind.runs: algorithm})
    except (TypeError, PluginError) as error:
        msg = f"{name} cannot be used as it is declared: {error}"
        raise InputError(msg) from None


def _measured(position: int, cell: Cell, plugin: Held) -> CellResult:
    start, error = time.process_time(), ""
    parameters: Any = cell.parameters
    rows: tuple[Row, ...] = ()
    # a test's own settings must not change what is measured
    with warnings.catch_warnings(), np.errstate(**NUMPYS_OWN):
        warnings.simplefilter("default")
        try:
            rows = outcome(plugin, parameters, cell.streams).rows
        except PluginError as fault:
            crashed = isinstance(fault, CrashedPluginError)
            error = f"{'' if crashed else REFUSED}{fault}\n"
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
