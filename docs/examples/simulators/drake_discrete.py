"""Drake: its Accelerometer and Gyroscope on a discrete MultibodyPlant, the default."""

import numpy as np
from body import INERTIA, LEVER, MASS, MOUNT, RATE, G, recording, wrench
from pydrake.all import (
    Accelerometer,
    DiagramBuilder,
    ExternallyAppliedSpatialForce,
    Gyroscope,
    LeafSystem,
    MultibodyPlant,
    Quaternion,
    RigidTransform,
    RotationMatrix,
    Simulator,
    SpatialForce,
    SpatialInertia,
    SpatialVelocity,
    UnitInertia,
)
from pydrake.common.value import Value


class Wrench(LeafSystem):
    """The wrench as an output."""

    def __init__(self, body):
        super().__init__()
        self.body = body
        kind = Value[list[ExternallyAppliedSpatialForce]]
        self.DeclareAbstractOutputPort("wrench", kind, self.calc)

    def calc(self, context, output):
        """At the centre of mass."""
        found, (force, torque) = (
            ExternallyAppliedSpatialForce(),
            wrench(context.get_time()),
        )
        found.body_index, found.p_BoBq_B = self.body.index(), np.zeros(3)
        found.F_Bq_W = SpatialForce(torque, force)
        output.set_value([found])


def simulate(request, continuous=False, sampled=True):
    """Read after each step; of a continuous plant at the same times."""
    step = 1.0 / request.rate
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(0.0 if continuous else step))
    if not sampled:
        plant.SetUseSampledOutputPorts(False)
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -G])
    inertia = SpatialInertia(MASS, [0, 0, 0], UnitInertia(*(INERTIA / MASS)))
    body = plant.AddRigidBody("b", inertia)
    plant.Finalize()
    load = builder.AddSystem(Wrench(body))
    builder.Connect(
        load.get_output_port(), plant.get_applied_spatial_force_input_port()
    )
    turned = RotationMatrix(Quaternion(MOUNT[3], *MOUNT[:3]))
    place = RigidTransform(turned, LEVER)
    force = builder.AddSystem(
        Accelerometer(body=body, X_BS=place, gravity_vector=[0, 0, -G])
    )
    gyro = builder.AddSystem(Gyroscope(body=body, X_BS=place))
    poses, speeds = (
        plant.get_body_poses_output_port(),
        plant.get_body_spatial_velocities_output_port(),
    )
    for each in (force, gyro):
        builder.Connect(poses, each.get_body_poses_input_port())
        builder.Connect(speeds, each.get_body_velocities_input_port())
    builder.Connect(
        plant.get_body_spatial_accelerations_output_port(),
        force.get_body_accelerations_input_port(),
    )
    simulator = Simulator(builder.Build())
    context = simulator.get_mutable_context()
    own = plant.GetMyMutableContextFromRoot(context)
    plant.SetFreeBodySpatialVelocity(own, body, SpatialVelocity(RATE, np.zeros(3)))
    if continuous:
        simulator.get_mutable_integrator().set_target_accuracy(1e-10)
    rows = []
    for k in range(1, int(request.seconds * request.rate) + 1):
        simulator.AdvanceTo(k * step)
        pose = plant.EvalBodyPoseInWorld(own, body)
        q = pose.rotation().ToQuaternion()
        read = [x.get_output_port().Eval(x.GetMyContextFromRoot(context))
                for x in (gyro, force)]  # fmt: skip
        rows.append([k * step, *pose.translation(), q.x(), q.y(), q.z(), q.w(),
                     *np.hstack(read)])  # fmt: skip
    return recording(rows)
