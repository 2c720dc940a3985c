"""The refusal of a batch of fits of which some did not converge."""

from typing import Any

import numpy as np

from simval.errors import ConvergenceError


def require_all(converged: Any, status: Any, message: str) -> None:
    """Raise unless all converged; the message takes {count}, {first} and {status}.

    Raises
    ------
    ConvergenceError
        With the number of trials that did not, the first of them and its status.
    """
    bad = np.flatnonzero(~np.atleast_1d(converged))
    if bad.size:
        why = np.atleast_1d(status)[bad[0]]
        raise ConvergenceError(message.format(count=bad.size, first=bad[0], status=why))
