"""What `simval selftest` does."""

from collections.abc import Iterable

import click
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from simval.cli.options import refuse_if, stated
from simval.cli.progress import bar
from simval.selftest.matrix import Result, faults, inject_all
from simval.selftest.random_settings import SETTINGS, WITHOUT_CHANCE
from simval.selftest.rates import (
    Rate,
    attitude_rows,
    calibration_rows,
    false_alarm_rates,
    powers,
)
from simval.selftest.tails import Tail, tails

CLEAN_RUNS = {0.05: 2000, 0.01: 2000, 0.001: 20_000}
"""Runs at each rate. Chosen: at least 20 false alarms are expected at each."""
CALIBRATION_RUNS = {0.05: 2000, 0.01: 2000, 0.001: 2000}
"""Fewer at 0.1 %, as a run takes longer: two false alarms are expected."""
POWER_RUNS = 400
"""Chosen: if all find the fault, the power is above 0.99 (Wilson's interval)."""
CLEAN_SEED, CALIBRATION_SEED, POWER_SEED = 8_000_000, 7_000_000, 9_000_000
"""First seeds. Any will do; so far apart, no two measurements share one."""
TAIL_RUNS = {
    "sampling": 1000,
    "calibration": 500,
    "ladder": 500,
    "coverage": 500,
    "gyroscope": 20,
    "magnetometer": 100,
    "attitude": 1000,
    "attitude_efficiency": 300,
    "attitude_limits": 300,
    "attitude_vectors": 500,
    "noise_model": 50,
    "detector": 150,
    "end_to_end": 60,
    "estimator": 600,
    "calibrator": 200,
    "filter": 200,
}
"""Runs of each study on random settings. Chosen: some minutes each."""
TAIL_SEED = 11_000_000
QUICK = 8
"""With --quick every eighth fault is injected: some of every part of the flow."""


def run(quick: bool, rates: bool, share: float, studies: tuple[str, ...]) -> int:
    """Do what `simval selftest` is asked."""
    refuse_if(quick and rates, "`--quick` does not apply to `--rates`; give one")
    refuse_if(
        stated("share") and not rates, "`--share` applies to `--rates`; give that too"
    )
    refuse_if(
        bool(studies) and not rates, "`--study` applies to `--rates`; give that too"
    )
    for study in studies:
        refuse_if(
            study in WITHOUT_CHANCE,
            f"there is no p-value of `{study}`: it {WITHOUT_CHANCE.get(study)}; give "
            f"one of {', '.join(SETTINGS)}",
        )
    if not rates:
        return _inject(quick)
    return _count(share, studies) if studies else _measure(share)


def _inject(quick: bool) -> int:
    chosen = faults()[::QUICK] if quick else faults()
    with bar(len(chosen), "faults") as progress:
        results = list(inject_all(chosen, progress.update))
    table = Table(title="injected faults and the gate's answers")
    for heading in (
        "part",
        "fault",
        "with it",
        "theory alone",
        "without",
        "first finding",
    ):
        table.add_column(heading, overflow="fold")
    for result in results:
        table.add_row(*(escape(word) for word in _words(result)))
    Console(highlight=False).print(table)
    wrong = [result for result in results if not result.right]
    for result in wrong:
        click.echo(
            f"the gate was wrong: {result.fault.name}: {result.seen}, its clean twin "
            f"{result.twin}, by theory alone {result.alone}"
            f"{', and cells of it crashed' if result.crashed else ''}"
        )
    click.echo(f"{len(results) - len(wrong)} of {len(results)} faults found")
    _say_what_theory_finds(results)
    return int(bool(wrong) or not results)


def _say_what_theory_finds(results: list[Result]) -> None:
    unseen = [result.fault for result in results if result.alone == "pass"]
    click.echo(f"theory alone finds {len(results) - len(unseen)} of {len(results)}")
    for fault in unseen:
        why = fault.baseline or "nobody knows why"
        click.echo(f"only a baseline sees: {fault.name}: {why}")


def _words(result: Result) -> list[str]:
    # leave out the cell's name: the statistic and the reason explain the answer
    reason = result.reason.partition("@1")[2].strip(" :") or result.reason
    fault = result.fault
    return [fault.part, fault.name, result.seen, result.alone, result.twin, reason]


def _measure(share: float) -> int:
    faulty = max(1, round(share * POWER_RUNS))
    alarms: list[Rate] = []
    for what, clean, wanted, seed in (
        ("clean attitude", attitude_rows, CLEAN_RUNS, CLEAN_SEED),
        ("clean calibration", calibration_rows, CALIBRATION_RUNS, CALIBRATION_SEED),
    ):
        runs = {alpha: max(1, round(share * n)) for alpha, n in wanted.items()}
        with bar(max(runs.values()), what) as progress:
            alarms += false_alarm_rates(clean, runs, seed, progress.update)
    small = _small(share, SETTINGS)
    with bar(faulty, "runs with faults") as progress:
        detected = powers(faulty, POWER_SEED, progress.update)
    console = Console(highlight=False)
    console.print(_table("false alarms: at most the stated rate", alarms))
    console.print(_tails_table(small))
    console.print(_table("faults found: at least the stated rate", detected))
    # only an interval wholly beyond the stated rate shows that the rate is wrong
    broken = [f"{r.name} at {r.nominal:g}" for r in alarms if r.interval[0] > r.nominal]
    broken += _too_many(small)
    broken += [r.name for r in detected if r.interval[1] < r.nominal]
    return _said(broken)


def _count(share: float, studies: Iterable[str]) -> int:
    small = _small(share, dict.fromkeys(studies))
    Console(highlight=False).print(_tails_table(small))
    return _said(_too_many(small))


def _small(share: float, studies: Iterable[str]) -> list[Tail]:
    found: list[Tail] = []
    for study in studies:
        runs = max(2, round(share * TAIL_RUNS[study]))
        with bar(runs, f"{study}, random settings") as progress:
            found += tails(study, runs, TAIL_SEED, progress.update)
    return found


def _too_many(found: list[Tail]) -> list[str]:
    return [f"{t.study}, {t.check}, {t.level:g}" for t in found if t.too_many]


def _said(broken: list[str]) -> int:
    for name in broken:
        click.echo(f"not as stated: {name}")
    return int(bool(broken))


def _table(title: str, rates: list[Rate]) -> Table:
    table = Table(title=title)
    for heading in ("what", "stated", "seen", "95 % interval", "runs"):
        table.add_column(heading)
    for rate in rates:
        low, high = rate.interval
        table.add_row(
            rate.name,
            f"{rate.nominal:g}",
            f"{rate.count / rate.runs:.4g}",
            f"{low:.4g} to {high:.4g}",
            str(rate.runs),
        )
    return table


def _tails_table(found: list[Tail]) -> Table:
    table = Table(title="p-values below a level, on random settings")
    for heading in ("study", "check", "runs", "rows", "level", "expected", "seen"):
        table.add_column(heading)
    for each in found:
        table.add_row(
            each.study, each.check, str(each.runs), str(each.rows), f"{each.level:g}",
            f"{each.expected:.3g} +- {each.error:.2g}", str(each.seen),
        )  # fmt: skip
    return table
