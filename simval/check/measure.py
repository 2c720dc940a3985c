"""A check by a sweep: into a temporary run folder, and judged without a baseline."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from simval.check.cells import suite_of
from simval.judge import GateResult, judge_run
from simval.plugins.loading import Meant, meant
from simval.plugins.names import located, portable
from simval.sweep import run_suite
from simval.sweep.run import CellResult
from simval.sweep.runner import Progress
from simval.verdict import ALPHA


@dataclass(frozen=True, slots=True, kw_only=True)
class Checked:
    """Some plug-ins, measured and judged.

    Attributes
    ----------
    plugins : tuple of Meant
        Each plug-in: what it is called, and what it declares.
    cells : tuple of CellResult
        What was measured of them.
    result : GateResult
        The gate's answer.
    missed : tuple of str, default ()
        The user's own limits that are missed, each with what misses it.
    """

    plugins: tuple[Meant, ...]
    cells: tuple[CellResult, ...]
    result: GateResult
    missed: tuple[str, ...] = ()

    @property
    def good(self) -> bool:
        """Whether all that was judged passes, and no limit is missed."""
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
    """Measure and judge the plug-ins that a word names.

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

    Raises
    ------
    UnusablePluginError
        If there is no such plug-in, or it cannot be loaded.
    """
    plugins = meant(plugin)
    suite = suite_of(plugins, seed)
    with TemporaryDirectory(prefix="simval-check-") as folder:
        run = run_suite(suite, Path(folder, "run"), workers=2, progress=progress)
    return Checked(
        plugins=tuple(plugins),
        cells=tuple(run.cells),
        result=judge_run(run, None, alpha),
    )
