"""The gate's power: `make power`, or `PYTHONPATH=tests python -m power --help`.

Each fault is put into the whole flow, suite, run and gate; the gate must not pass it,
and must pass its clean twin. With --rates, clean runs of every study on fresh seeds, at
random settings, count the false alarms, and runs with a fault in a prediction the
power. Exit code 1 if the gate was wrong about something.
"""

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence

from power.matrix import Result, faults, inject_all
from power.rates import powers
from power.tails import Rate, Tail, tails, together

POWER_RUNS = 400
"""Chosen: if all find the fault, the power is above 0.99 (Wilson's interval)."""
POWER_SEED = 9_000_000
TAIL_RUNS = {
    "sampling": 1000,
    "calibration": 500,
    "ladder": 500,
    "coverage": 500,
    "thermal": 50,
    "gyroscope": 20,
    "magnetometer": 100,
    "attitude": 1000,
    "attitude_efficiency": 300,
    "attitude_limits": 300,
    "attitude_singular": 300,
    "attitude_vectors": 500,
    "noise_model": 50,
    "detector": 150,
    "end_to_end": 60,
    "estimator": 600,
    "calibrator": 200,
    "filter": 200,
    "told": 60,
    "solvers": 200,
    "attitude_order": 200,
    "attitude_geometries": 20,
    "attitude_map": 20,
    "scene": 10,
    "whole_log": 10,
    "diagnosis": 30,
    "audit": 30,
}
"""Runs of each study on random settings. Chosen: some minutes each."""
TAIL_SEED = 11_000_000
"""First seeds. Any will do; so far apart, no two measurements share one."""
THIRD = 3
"""With --quick every third fault is put in: some of every part of the flow."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what is asked; 1 if the gate was wrong."""
    parser = argparse.ArgumentParser(prog="power", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="every third fault")
    parser.add_argument("--part", default="1/1", help="2/3: the second third of them")
    parser.add_argument("--rates", action="store_true", help="measure the rates")
    parser.add_argument("--share", type=float, default=1.0, help="of --rates' runs")
    parser.add_argument(
        "--study", action="append", choices=TAIL_RUNS, help="rates of this study only"
    )
    asked = parser.parse_args(arguments)
    if asked.study:
        return _say_wrong(_tails(asked.share, asked.study))
    if asked.rates:
        return _say_wrong(_rates(asked.share))
    chosen = faults()[::THIRD] if asked.quick else faults()
    part, parts = map(int, asked.part.split("/"))
    return inject(chosen[part - 1 :: parts])


def inject(chosen: tuple) -> int:
    """Put each fault in, and print a line for each as it comes."""
    print("part | fault | with it | theory alone | without | first finding")
    results: list[Result] = []
    for result in inject_all(chosen):
        results.append(result)
        fault = result.fault
        # without the cell's name: the statistic and the reason explain the answer
        reason = result.reason.partition("@1")[2].strip(" :") or result.reason
        words = (fault.part, fault.name, result.seen, result.alone, result.twin, reason)
        print(*words, sep=" | ", flush=True)
    wrong = [result for result in results if not result.right]
    for result in wrong:
        print(
            f"the gate was wrong: {result.fault.name}: {result.seen}, its clean twin "
            f"{result.twin}, by theory alone {result.alone}"
            f"{', and cells of it crashed' if result.crashed else ''}"
        )
    print(f"{len(results) - len(wrong)} of {len(results)} faults found")
    unseen = [result.fault for result in results if result.alone == "pass"]
    print(f"theory alone finds {len(results) - len(unseen)} of {len(results)}")
    for fault in unseen:
        why = fault.baseline or "nobody knows why"
        print(f"only a baseline sees: {fault.name}: {why}")
    return int(bool(wrong) or not results)


def _rates(share: float) -> Iterator[str]:
    yield from _tails(share, TAIL_RUNS)
    found = powers(max(1, round(share * POWER_RUNS)), POWER_SEED)
    print("faults found: at least the stated rate")
    yield from _stated(found, lambda rate, low, high: high < rate.nominal)


def _stated(
    rates: Iterable[Rate], wrong: Callable[[Rate, float, float], bool]
) -> Iterator[str]:
    for rate in rates:
        low, high = rate.interval
        print(
            f"{rate.name} | stated {rate.nominal:g} | seen "
            f"{rate.count / rate.runs:.4g} | {low:.4g} to {high:.4g} | "
            f"{rate.runs} runs",
            flush=True,
        )
        if wrong(rate, low, high):
            yield f"{rate.name} at {rate.nominal:g}"


def _tails(share: float, studies: Iterable[str]) -> Iterator[str]:
    alarms: list[Rate] = []
    print("study | check | runs | rows | level | expected | seen")
    for study in studies:
        runs = max(2, round(share * TAIL_RUNS[study]))
        found, rates = tails(study, runs, TAIL_SEED)
        alarms += rates
        for each in found:
            _print_tail(each)
            if each.too_many:
                yield f"{each.study}, {each.check}, {each.level:g}"
    # what is not as stated: only an interval wholly beyond the stated rate shows that
    print("runs of sound cells that fail: at most the stated rate")
    every = [*alarms, *together(alarms)]
    yield from _stated(every, lambda rate, low, high: low > rate.nominal)


def _print_tail(each: Tail) -> None:
    expected = f"{each.expected:.3g} +- {each.error:.2g}"
    words = (each.study, each.check, each.runs, each.rows, f"{each.level:g}", expected)
    print(*words, each.seen, sep=" | ", flush=True)


def _say_wrong(broken: Iterable[str]) -> int:
    names = list(broken)
    for name in names:
        print(f"not as stated: {name}")
    return int(bool(names))


if __name__ == "__main__":
    sys.exit(main())
