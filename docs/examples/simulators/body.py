"""The body that all these simulators move: free, under a smooth wrench, IMU off it."""

import numpy as np

MASS, INERTIA, G = 1.0, np.array([0.02, 0.03, 0.04]), 9.81
LEVER = np.array([0.10, -0.05, 0.20])  # the IMU in the body, m
MOUNT = np.array([0.147_6, -0.246_0, 0.098_4, 0.952_9])  # and its quaternion, x y z w
MOUNT /= np.linalg.norm(MOUNT)
RATE = np.array([0.6, -0.8, 0.5])  # of the body at the start, rad/s


def wrench(t):
    """Force without gravity and torque, world axes, at the centre of mass."""
    force = np.sin([2.1 * t, 2.9 * t + 1.57, 1.3 * t + 0.4]) * [3.0, 2.5, 3.0]
    torque = np.sin([3.1 * t, 2.3 * t + 1.57, 4.1 * t + 1.0]) * [0.06, 0.09, 0.07]
    return MASS * force + [0.0, 0.0, MASS * G], torque


def recording(rows):
    """What `simval audit` takes: rows of time, position, quaternion x y z w, IMU."""
    t, p, q, gyro, force = np.split(np.array(rows, float), [1, 4, 8, 11], axis=1)
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    # a clock in single precision is of even steps
    return dict(
        time=np.linspace(t[0, 0], t[-1, 0], len(t)), position=p, attitude=q,
        gyroscope=gyro, accelerometer=force, lever=LEVER, mount=MOUNT,
        gravity=(0.0, 0.0, -G),
    )  # fmt: skip


def mjcf(step):
    """Model of it for MuJoCo and its kin."""
    x, y, z, w = MOUNT
    return f"""
<mujoco><option timestep="{step}" gravity="0 0 {-G}"/>
<worldbody><body name="b"><freejoint/>
<inertial pos="0 0 0" mass="{MASS}" diaginertia="{" ".join(map(str, INERTIA))}"/>
<geom type="box" size=".1 .1 .1" contype="0" conaffinity="0" mass="0"/>
<site name="imu" pos="{" ".join(map(str, LEVER))}" quat="{w} {x} {y} {z}"/>
</body></worldbody>
<sensor><accelerometer site="imu"/><gyro site="imu"/></sensor></mujoco>"""


def row(t, qpos, sensordata):
    """Row of MuJoCo's arrays."""
    return [t, *qpos[:3], *qpos[4:7], qpos[3], *sensordata[3:], *sensordata[:3]]
