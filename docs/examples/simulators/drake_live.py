"""Drake: the same sensors on a discrete plant whose output ports are not sampled."""

import drake_discrete


def simulate(request):
    """Read after each step; acceleration is of the state and the forces of now."""
    return drake_discrete.simulate(request, sampled=False)
