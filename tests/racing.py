"""Races on a simulated clock: what a run takes is stated, so the answer is known."""

import numpy as np

from simval.bench import Answer, Contender, Done, Race
from simval.bench.rounds import run_race


class Machine:
    """A clock that runs advance, by what they cost and by what the machine is like."""

    def __init__(self, slowing=0.0, noise=0.0, seed=0):
        self.now, self.runs, self.ran = 0.0, 0, []
        self.slowing, self.noise = slowing, noise
        self.rng = np.random.default_rng(seed)

    def __call__(self):
        return self.now

    def work(self, name, seconds):
        self.ran.append(name)
        factor = 1.0 + self.slowing * self.runs
        if self.noise:
            factor *= np.exp(self.noise * self.rng.standard_normal())
        self.now += seconds * factor
        self.runs += 1


def told(value=1.0, within=0.0, items=1):
    """What is seen of a run that has answered some numbers."""
    answer = Answer(values=np.atleast_1d(np.asarray(value, dtype=float)), within=within)
    return lambda _: Done(items=items, answers={"the answer": answer})


def race_on(machine, costs, *, clock="cpu", **more):
    """A race of contenders that take so many seconds; the first is not simval's."""
    contenders = [
        Contender(
            name=name,
            run=lambda name=name, cost=cost: machine.work(name, cost),
            seen=told(),
            ours=k > 0,
            **more,
        )
        for k, (name, cost) in enumerate(costs.items())
    ]
    return Race(
        name="stub", title="Stub", item="runs", contenders=lambda: contenders,
        clock=clock,
    )  # fmt: skip


def raced(machine, costs, rounds=7, seed=0):
    """Results of such a race."""
    return run_race(race_on(machine, costs), rounds, seed=seed, clock=machine)


def failing_race(error, name="stuck", *, after=0):
    """A race whose contender raises an error, at once or after some good runs."""
    runs = []

    def run():
        runs.append(1)
        if len(runs) > after:
            raise error
        return 0

    contender = Contender(name="own", run=run, seen=told())
    other = Contender(name="reference", run=lambda: 0, seen=told(), ours=False)
    return Race(
        name=name, title="Stub", item="runs", contenders=lambda: [other, contender]
    )
