"""Jiminy: its ImuSensor on a free-flyer, at even times of its default integrator."""

import tempfile

import jiminy_py.core as jiminy
import numpy as np
from body import INERTIA, LEVER, MASS, MOUNT, RATE, recording, wrench

URDF = """<robot name="b"><link name="b"><inertial><mass value="{}"/>
<inertia ixx="{}" iyy="{}" izz="{}" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>
""".format(MASS, *INERTIA)


def simulate(request):
    """Read after each step."""
    robot, step = jiminy.Robot("b"), 1.0 / request.rate
    with tempfile.NamedTemporaryFile("w", suffix=".urdf") as file:
        file.write(URDF)
        file.flush()
        robot.initialize(file.name, has_freeflyer=True)
    turn = jiminy.pinocchio.Quaternion(MOUNT).matrix()
    robot.add_frame("imu", "b", jiminy.pinocchio.SE3(turn, LEVER))
    imu = jiminy.ImuSensor("imu")
    robot.attach_sensor(imu)
    imu.initialize("imu")
    engine = jiminy.Engine()
    engine.add_robot(robot)

    def load(t, q, v, out):
        out[:] = np.concatenate(wrench(t))

    engine.register_profile_force("b", "b", load)
    engine.start(np.eye(7)[6], np.concatenate([np.zeros(3), RATE]))
    rows = []
    for k in range(int(request.seconds * request.rate)):
        engine.step(step)
        rows.append([(k + 1) * step, *engine.robot_states[0].q, *imu.data])
    engine.stop()
    return recording(rows)
