r"""What became slower than in an earlier run of the races.

Two intervals of confidence c bound the change of a ratio: with
:math:`[l_0, h_0]` then and :math:`[l_1, h_1]` now,

.. math:: \rho_1/\rho_0 \in [l_1/h_0,\ h_1/l_0]
   \text{ at a confidence of at least } 2c - 1. \tag{B2}

It is slower if all of this is below :math:`1/(1 + s)`, as fast if none is, and else
nothing can be said yet: more rounds make the interval shorter.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from simval.bench.interval import CONFIDENCE, rounds_for
from simval.bench.race import Race
from simval.bench.record import Kept, kept_of
from simval.bench.rounds import Result, joined, run_race
from simval.bench.untimed import Untimed

SLOWER: Final = 0.2
"""Share s by which the time may grow. Chosen: runs of the same code differ by less."""
TIMES: Final = 4
"""Bound on the rounds of what does not pass, in those that were asked for."""

Standing = Literal["pass", "slower", "inconclusive", "not judged"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """What became of a contender's ratio, or of a race that has none, then or now."""

    then: Kept | None
    now: Kept | None
    standing: Standing
    words: str = ""  # why, where it is not what the interval says
    # interval of its time now, in its time then
    low: float | None = None
    high: float | None = None
    untimed: Untimed | None = None

    @property
    def key(self) -> tuple[str, str]:
        """Race and contender: it was there then, or is there now; all of a race."""
        if self.untimed is not None:
            return self.untimed.race, ""
        one = self.now if self.now is not None else self.then
        assert one is not None
        return one.key

    @property
    def race(self) -> str:
        """Its race."""
        return self.key[0]

    @property
    def contender(self) -> str:
        """Its name; empty for all of a race."""
        return self.key[1]


def measured(
    race: Race,
    then: Mapping[tuple[str, str], Kept],
    rounds: int,
    run: Callable[..., list[Result]] = run_race,
    tell: Callable[[str], None] = lambda _: None,
) -> tuple[list[Result], list[Change]]:
    """Run a race, and more rounds of it while something in it does not pass."""
    results, done = run(race, rounds), rounds
    changes = changes_of(then, kept_of(results), race.name)
    while done < TIMES * rounds and (still := [c for c in changes if _open(c)]):
        names = ", ".join(change.contender for change in still)
        tell(f"{race.name}: {done} more rounds, because of {names}")
        results = joined(results, run(race, done, seed=done))
        done *= 2
        changes = changes_of(then, kept_of(results), race.name)
    return results, changes


def changes_of(
    then: Mapping[tuple[str, str], Kept], now: Iterable[Kept], race: str
) -> list[Change]:
    """Compare the contenders of a race with those of an earlier run."""
    found = {kept.key: kept for kept in now}
    gone = [k for key, k in then.items() if key[0] == race and key not in found]
    return [
        *(_change(then.get(key), kept) for key, kept in found.items()),
        *map(_gone, gone),
    ]


def code_of(changes: Sequence[Change]) -> int:
    """Exit code: 1 if something is slower, 3 if that cannot be said, else 0."""
    standings = {change.standing for change in changes}
    if "slower" in standings:
        return 1
    return 0 if "pass" in standings and "inconclusive" not in standings else 3


def uncompared(untimed: Untimed, *, before: bool) -> Change:
    """Nothing in a race can be compared that had no times before, or has none now."""
    words = f"cannot be compared, {untimed}"
    if before:
        words = (
            f"cannot be compared, when the file was made it was {untimed}; make the "
            "file anew"
        )
    return Change(
        then=None, now=None, standing="inconclusive", words=words, untimed=untimed
    )


def _open(change: Change) -> bool:
    return change.low is not None and change.standing in ("slower", "inconclusive")


def _gone(kept: Kept) -> Change:
    standing: Standing = "not judged"
    words = "is not there now"
    if _judged(kept):
        standing = "inconclusive"
        words = f"{words}; if that is meant, make the file anew"
    return Change(then=kept, now=None, standing=standing, words=words)


def _judged(kept: Kept) -> bool:
    return kept.ours and kept.clock != "wall"


def _change(then: Kept | None, now: Kept) -> Change:
    if not _judged(now):
        words = "not simval's" if not now.ours else "its time is that on the wall"
        return Change(then=then, now=now, standing="not judged", words=words)
    if then is None:
        return Change(then=then, now=now, standing="not judged", words="is new")
    if (then.reference, then.clock) != (now.reference, now.clock):
        words = (
            f"its reference was {then.reference} ({then.clock} time) and is "
            f"{now.reference} ({now.clock} time); make the file anew"
        )
        return Change(then=then, now=now, standing="inconclusive", words=words)
    few = [k for k in (then, now) if k.confidence < CONFIDENCE]
    if few:
        words = (
            f"{few[0].rounds} rounds have an interval of {few[0].confidence:.0%}; "
            f"{rounds_for()} are needed"
        )
        return Change(then=then, now=now, standing="inconclusive", words=words)
    return _compared(then, now)


def _compared(then: Kept, now: Kept) -> Change:
    low, high = then.low / now.high, then.high / now.low  # of times: eq. (B2) inverted
    standing: Standing = "inconclusive"
    if low > 1.0 + SLOWER:
        standing = "slower"
    elif high <= 1.0 + SLOWER:
        standing = "pass"
    return Change(then=then, now=now, standing=standing, low=low, high=high)
