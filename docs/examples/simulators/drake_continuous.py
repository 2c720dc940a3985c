"""Drake: the same sensors on a continuous MultibodyPlant."""

import drake_discrete


def simulate(request):
    """Read at even times of an error-controlled integrator."""
    return drake_discrete.simulate(request, continuous=True)
