"""Newton: the same sensor, with the Euler integrator."""

import newton_imu


def simulate(request):
    """Read after each step."""
    return newton_imu.simulate(request, integrator="euler")
