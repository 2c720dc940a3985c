"""Genesis: the same sensor, turned in the body by its `euler_offset`."""

import genesis_imu


def simulate(request):
    """Read after each step."""
    return genesis_imu.simulate(request, turned=True)
