"""Where an estimator of one's own fails: a row for each class of attitudes."""

from simval.plugins import Estimator
from simval.plugins.failures import failure_shares
from simval.plugins.noise import VectorNoise
from simval.results import Row, limit, unjudged
from simval.statistics import FAILURES, TRUTH


def failure_rows(
    plugin: Estimator,
    cases: int,
    vectors: int = 2,
    noise: VectorNoise | None = None,
) -> tuple[Row, ...]:
    """Share of failures of each class; one that is declared is not judged."""
    shares = failure_shares(plugin, cases, vectors, noise)
    declared = dict.fromkeys(name for name in plugin.fails_at if name in shares)
    known = {name: shares.pop(name) for name in declared}
    return (
        *limit(FAILURES.each(shares), tuple(shares.values()), 0.0, TRUTH, n=cases),
        *unjudged(FAILURES.each(known), tuple(known.values()), n=cases),
    )
