"""Genesis: its IMU sensor as `scene.step` leaves it, in double precision."""

import genesis
import numpy as np
from body import LEVER, MOUNT, RATE, G, mjcf, recording, wrench
from scipy.spatial.transform import Rotation


def simulate(request, turned=False):
    """Read after each step; the sensor along the body's axes, or turned in it."""
    genesis.init(backend=genesis.cpu, precision="64", logging_level="error")
    step, options = 1.0 / request.rate, genesis.options
    scene = genesis.Scene(
        sim_options=options.SimOptions(dt=step, gravity=(0.0, 0.0, -G)),
        rigid_options=options.RigidOptions(enable_collision=False),
        show_viewer=False,
    )
    body = scene.add_entity(genesis.morphs.MJCF(file=mjcf(step)))
    mount = MOUNT if turned else np.array([0.0, 0.0, 0.0, 1.0])
    angles = Rotation.from_quat(mount).as_euler("xyz", degrees=True)
    place = dict(pos_offset=tuple(LEVER), euler_offset=tuple(angles))
    imu = scene.add_sensor(genesis.sensors.IMU(entity_idx=body.idx, **place))
    scene.build()
    body.set_dofs_velocity(np.concatenate([np.zeros(3), RATE]))
    rows = []
    for k in range(int(request.seconds * request.rate)):
        body.apply_links_external_wrench(*(x[None] for x in wrench(k * step)))
        scene.step()
        (w, *xyz), read = body.get_quat().tolist(), imu.read()
        rows.append([(k + 1) * step, *body.get_pos().tolist(), *xyz, w,
                     *read.ang_vel.tolist(), *read.lin_acc.tolist()])  # fmt: skip
    return recording(rows) | {"mount": mount}
