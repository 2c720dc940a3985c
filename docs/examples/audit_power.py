"""How small an error `simval audit` finds: python docs/examples/audit_power.py TRIALS.

The motions are those of the study `audit`: 60 s at 200 Hz, as of a hand, with white
noise of 0.02 m/s^2 and 0.002 rad/s a row. Prints what is allowed of each term in the
first motion, and the share of TRIALS motions in which an error of so many times that is
the only one that is named.
"""

import sys

import click
import numpy as np

from simval.imu.audit import audit
from simval.studies.simulated_imus import SIZED, declared, names, simulated

TIMES = (0.25, 0.5, 1.0, 2.0, 4.0)
ERRORS = (
    "lever arm in m",
    "gyroscope late in steps",
    "scale of the gyroscope",
    "two instants in steps",
)


def found(name, motion, size=None):
    """Audit of a simulator with an error of this size."""
    rng = np.random.Generator(np.random.SFC64(motion))
    imu = simulated(name, rng, rate=200.0, seconds=60.0, noise=0.02, size=size)
    return audit(imu, declared())


def main(trials, errors=ERRORS, times=TIMES):
    """Print both tables."""
    right = found("right", 0)
    terms = {
        f"{sensor.name[0]}.{name}": (sensor.name, each)
        for sensor in right.sensors
        for name, each in sensor.items.items()
    }
    for sensor, each in terms.values():
        size = f"{each.allowed.max():.2g} {each.term.unit}"
        click.echo(f"{sensor:14} {each.term.title:22} {size}".rstrip())
    click.echo(f"\n{'share named at':30}" + "".join(f"{k:7g}" for k in times))
    for name in errors:
        allowed = terms[SIZED[name].named][1].allowed.max()
        shares = [
            np.mean([
                names(found(name, motion, k * allowed)) == {SIZED[name].named}
                for motion in range(trials)
            ])
            for k in times
        ]  # fmt: skip
        click.echo(f"{name:30}" + "".join(f"{share:7.2f}" for share in shares))


if __name__ == "__main__":
    main(int(sys.argv[1]))
