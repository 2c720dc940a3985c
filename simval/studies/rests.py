"""The rests of a recorded log: found in seconds, whatever its rate."""

from simval.errors import RefusedError
from simval.logs import Log
from simval.poses import PARAMETERS
from simval.statics import (
    SLOWEST_NOISE,
    WHITE,
    WINDOWS,
    EvenLog,
    Intervals,
    Rest,
    evened,
    variance_magnitude,
)


def find_rests(
    log: Log,
    rest: float | None,
    multipliers: tuple[float, ...],
    least: int = PARAMETERS,
) -> tuple[EvenLog, Rest, list[tuple[float, Intervals]]]:
    """Find the rests of a log with the longest window that sees enough of them.

    Raises
    ------
    RefusedError
        If there is no rest, or no threshold finds enough.

    Notes
    -----
    A short window is trusted only where the rest is white noise: in half a second a
    slow motion, too, looks still.
    """
    count = None if rest is None else log.rows_within(rest)
    refusal: RefusedError | None = None
    for window in WINDOWS:
        even = evened(log.time, log.accelerometer, window)
        spread = variance_magnitude(even.samples, even.window)
        try:
            start = even.initial_rest(count, spread)
            limit = WHITE if refusal else 1.0 + SLOWEST_NOISE * even.rate
            if start.found or refusal:
                _require_noise(log, start, even.wander(start, spread), limit)
        except RefusedError as error:
            refusal = refusal or error
            continue
        found = [(m, even.intervals(spread, m * start.variance)) for m in multipliers]
        usable = [(m, part) for m, part in found if len(part) >= least]
        if usable:
            return even, start, usable
        refusal = refusal or too_few(max(len(part) for _, part in found))
    raise refusal or too_few(0)


def _require_noise(log: Log, rest: Rest, wander: float, limit: float) -> None:
    if not wander <= limit:
        msg = (
            f"no initial rest found: even where the log is most quiet, from "
            f"{log.time[rest.start]:.2f} s to {log.time[rest.stop - 1]:.2f} s, its "
            f"variance is {wander:.3g} times what it is from row to row, and the noise "
            f"of a sensor at rest leaves {limit:.3g} at most; it is moving there, so "
            "record with rests, or state the initial one (--rest SECONDS)"
        )
        raise RefusedError(msg)


def too_few(most: int) -> RefusedError:
    """Refusal of a log in which at most so many rests were found."""
    return RefusedError(
        f"at most {most} static interval(s) found, and a calibration needs "
        f"{PARAMETERS} or more, each from a rest of two seconds or longer; hold the "
        "sensor still in more poses, or state the initial rest (--rest SECONDS) if it "
        "was found wrongly"
    )
