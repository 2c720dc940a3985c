"""Newton: `SensorIMU` as its documentation shows it, with the MuJoCo solver."""

import newton
import numpy as np
import warp as wp
from body import INERTIA, LEVER, MASS, MOUNT, RATE, G, recording, wrench
from newton.sensors import SensorIMU


def simulate(request, integrator=None):
    """Read after each step; the default of the integrator is `implicitfast`."""
    wp.config.quiet = True
    step = 1.0 / request.rate
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -G))
    inertia = wp.mat33(np.diag(INERTIA).astype(np.float32))
    body = builder.add_body(
        xform=wp.transform((0, 0, 1), wp.quat_identity()), mass=MASS, inertia=inertia,
        lock_inertia=True,
    )  # fmt: skip
    shape = newton.ModelBuilder.ShapeConfig(density=0.0, collision_group=0)
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=shape)
    place = wp.transform(tuple(LEVER), wp.quat(*MOUNT))
    builder.add_site(body, xform=place, label="imu_0")
    model = builder.finalize(device="cpu")
    imu = SensorIMU(model, sites="imu_*", request_state_attributes=False)
    solver = newton.solvers.SolverMuJoCo(model, integrator=integrator)
    seen = solver.observables(kinds=imu.solver_observable_kinds)
    now, after, control = model.state(), model.state(), model.control()
    for array, first in ((now.body_qd, 3), (now.joint_qd, 3)):
        values = array.numpy()
        values.reshape(-1)[first : first + 3] = RATE
        array.assign(values)
    newton.eval_fk(model, now.joint_q, now.joint_qd, now)
    rows = []
    for k in range(int(request.seconds * request.rate)):
        now.clear_forces()
        now.body_f.assign(np.concatenate(wrench(k * step)).astype(np.float32)[None])
        solver.step(now, after, control, None, step, observables=seen)
        imu.update(after, observables=seen)
        readings = imu.gyroscope.numpy()[0], imu.accelerometer.numpy()[0]
        rows.append([(k + 1) * step, *after.body_q.numpy()[0], *np.hstack(readings)])
        now, after = after, now
    return recording(rows)
