"""Our own scenes, audited: right in each convention of the gyroscope's rows.

A body that flies between contacts reads hardly more than what its turning adds, which
does not tell a delay; the rows about a contact are left out.
"""

import numpy as np
import pytest

from simval.imu.audit import Declared, SimulatedImu, audit
from simval.imu.logs import Rows
from simval.scene.run import plan_run, run_plan
from simval.scene.trajectory import gyroscope_rows

# what they are told to do, and what their motion does not tell of the accelerometer
SCENES = {
    "gimbal": ({"poses": 3}, set()),
    "handheld": ({"poses": 4}, set()),
    "freefall": ({"seconds": 10.0}, set()),
    "pivot": ({"spin_rate": 4.0, "turns": 8.0}, set()),
    "die": ({"poses": 3}, {"delay"}),
    "cube": ({"poses": 3}, {"delay"}),
    "shaker": ({"poses": 3}, {"one instant"}),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_our_scenes_are_right(name):
    settings, silent = SCENES[name]
    run = run_plan(plan_run(name, **settings), positions=True)
    said = Declared(lever=np.zeros(3), mount=np.eye(3), gravity=run.gravity)
    for kind, late in (("before", 0.5), ("instant", 0.0), ("after", -0.5)):
        imu = SimulatedImu(
            time=run.time, position=run.position, attitude=run.attitude,
            gyroscope=gyroscope_rows(run, rows=Rows(kind=kind)),
            accelerometer=run.specific_force, source=name,
        )  # fmt: skip
        found = audit(imu, said)
        assert found.exit_code == (3 if silent else 0), str(found)
        assert found.gyroscope.instant == late
        assert [each.unexplained for each in found.sensors] == [0.0, 0.0]
        assert set(found.untold(found.accelerometer)) == silent
