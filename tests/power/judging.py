"""How often sound rests are accused, and faults named: `python -m power.judging`.

In a checkout, with `PYTHONPATH=.:tests`; a number of sets may be given. Each set has a
seed of its own.
"""

import sys
import time
from collections import Counter
from collections.abc import Iterator

import numpy as np
from rest_sets import FAULTS, FURTHER, SOUND, UNLISTED, faulty, log_of

from simval.imu.explain import Judgement, judge

SEED = 480_000


def kinds_of(judgement: Judgement) -> frozenset[str]:
    """Kinds among what makes up nine tenths of the posterior."""
    return frozenset().union(*(f.explanation.kinds for f in judgement.candidates))


def standing(judgement: Judgement, kind: str) -> str:
    """Named, partly named with others, misnamed or unnamed."""
    if judgement.answer != "refusal":
        return "unnamed"
    kinds = kinds_of(judgement)
    if kinds == {kind}:
        return "named"
    return "partly" if kind in kinds else "misnamed"


def sound(sets: int, seed: int = SEED) -> Iterator[tuple[str, Counter[str]]]:
    """Answers to each family of sound logs, and how many were accused."""
    for family, make in SOUND.items():
        each: Counter[str] = Counter()
        for k in range(sets):
            judgement = judge(make(np.random.default_rng([seed, k])))
            each[judgement.answer] += 1
            each["accused"] += judgement.accuses
            each["odds of 10"] += judgement.odds > np.log(10.0)
        yield family, each


def faults(
    sets: int, where: str = "sphere", seed: int = SEED + 1
) -> Iterator[tuple[str, int, Counter[str]]]:
    """Standing of each fault at each of its sizes."""
    for name, fault in (FAULTS | FURTHER).items():
        for size in range(3):
            each: Counter[str] = Counter()
            for k in range(sets):
                rng = np.random.default_rng([seed, size, k])
                rests, kind = faulty(fault, size, rng, where)
                judgement = judge(rests)
                each[standing(judgement, kind)] += 1
                each["remark"] += judgement.answer == "remark"
            yield name, size, each


def unlisted(
    sets: int, seed: int = SEED + 2
) -> Iterator[tuple[str, float, Counter[str]]]:
    """What is said of faults that are in no catalogue."""
    for name, (sizes, act) in UNLISTED.items():
        for size in sizes:
            each: Counter[str] = Counter()
            for k in range(sets):
                rng = np.random.default_rng([seed, k])
                log = log_of(rng)
                for field, value in act(log, size, int(rng.integers(3))).items():
                    setattr(log, field, value)
                judgement = judge(log.rests())
                said = " or ".join(sorted(kinds_of(judgement)))
                refused = judgement.answer == "refusal"
                each[said if refused else judgement.answer] += 1
            yield name, size, each


def speed(sets: int = 40) -> tuple[float, float]:
    """Median processor time of a sound log and of one that misfits, s."""
    medians = []
    for size in (None, 1):
        rng, each = np.random.default_rng(SEED), []
        for k in range(sets):
            log = log_of(rng).rests()
            if size is not None:
                log, _ = faulty(list(FAULTS.values())[k % len(FAULTS)], size, rng)
            start = time.process_time()
            judge(log)
            each.append(time.process_time() - start)
        medians.append(float(np.median(each)))
    return medians[0], medians[1]


def main(sets: int = 40) -> None:
    """Print the tables: sound logs, then faults by where the poses are."""
    total: Counter[str] = Counter()
    for family, each in sound(7 * sets + sets // 2):
        print(f"{family:21}", _row(each), flush=True)
        total += each
    print(f"{'all':21}", _row(total))
    for where in ("sphere", "few", "faces"):
        sums = [Counter[str]() for _ in range(3)]
        for name, size, each in faults(sets if where == "sphere" else sets // 2, where):
            print(f"{where:7} {name:21} {size}", _row(each), flush=True)
            if name in FAULTS:
                sums[size] += each
        for size, each in enumerate(sums):
            print(f"{where:7} {'all of the first 12':21} {size}", _row(each))
    for name, much, each in unlisted(sets):
        print(f"{name:21} {much:g}", _row(each), flush=True)
    print("processor time, ms: sound {:.2g}, misfit {:.3g}".format(
        *(1e3 * seconds for seconds in speed())))  # fmt: skip


def _row(each: Counter[str]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(each.items()) if count)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
