"""Count right simulators called wrong: python docs/examples/audit_right.py FIRST LAST.

Draw k of FIRST to LAST - 1 has its own generator, of seed (100, k): a rate of 10 Hz to
10 kHz, 150 to 4,000 rows and a pace. A quarter are at rest, half are in single
precision, half declare nothing, and a third have no noise. Prints each one that is
called wrong or not explained, and how many of each motion have each answer.
"""

import sys
from collections import Counter

import click
import numpy as np

from simval.imu.audit import Declared, audit
from simval.studies.simulated_imus import declared, simulated

ANSWERS = {
    0: "right", 3: "not judged whole", 1: "called wrong", 4: "not explained",
}  # fmt: skip
MOVING = ("moves under 1 s", "1 to 3 s", "3 to 30 s", "longer")
STILL = {"move": 0.0, "turn": 0.0, "spin": 0.0}


def drawn(k):
    """Right simulator of this number, and what it declares."""
    rng = np.random.Generator(np.random.SFC64((100, k)))
    rate = 10.0 ** rng.uniform(1.0, 4.0)
    rows = np.exp(rng.uniform(*np.log([150, 4000])))
    pace, spin = rng.uniform(0.3, 1.0), rng.uniform(0.1, 2.0)
    noise = 0.0 if rng.random() < 1 / 3 else 10.0 ** rng.uniform(-5.0, -0.5)
    imu = simulated(
        "right", rng, rate=rate, seconds=rows / rate, noise=noise,
        single=k // 4 % 2 == 0,
        **STILL if k % 4 == 0 else dict(pace=pace, spin=spin, turn=0.5 + spin / 2.0),
    )  # fmt: skip
    return imu, Declared() if k // 8 % 2 == 0 else declared()


def motion(k, seconds):
    """Name the kind of a draw: at rest, or how long it moves."""
    return "at rest" if k % 4 == 0 else MOVING[np.searchsorted([1, 3, 30], seconds)]


def main(first, last):
    """Audit the draws and print the counts."""
    counts: Counter[tuple[str, str]] = Counter()
    for k in range(first, last):
        imu, said = drawn(k)
        found = audit(imu, said)
        unexplained = any(sensor.unexplained for sensor in found.sensors)
        answer = ANSWERS[4 if unexplained else found.exit_code]
        counts[motion(k, np.ptp(imu.time)), answer] += 1
        if unexplained or found.exit_code == 1:
            click.echo(f"draw {k}: {found}")
    click.echo(f"{'':16}" + "".join(f"{x:>18}" for x in ANSWERS.values()))
    for kind in ("at rest", *MOVING):
        each = [counts[kind, x] for x in ANSWERS.values()]
        click.echo(f"{kind:16}" + "".join(f"{x:18}" for x in each))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
