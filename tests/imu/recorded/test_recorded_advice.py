"""What a message of `filter` advises is done, and helps."""

import re
import shlex

import pytest
from recorded_logs import made
from written import written

NAMED = "ax [m/s^2],ay [m/s^2],az [m/s^2]"
UNITS = f"t [s],{NAMED},wx [rad/s],wy [rad/s],wz [rad/s],mx [T],my [T],mz [T]"
NONE = "t [s],ax,ay,az,wx,wy,wz,mx,my,mz"
OTHERS = f"t [s],{NAMED},a,b,c,mx [T],my [T],mz [T]"
QUATERNION = ",opt_q_0,opt_q_1,opt_q_2,opt_q_3"
TURNED = [0.0, 0.0, 0.7]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("header", "scale", "given", "said", "done"),
    [
        (NONE, 1.0, "", "give --gyro-unit rad/s or deg/s", "--gyro-unit rad/s"),
        (NONE, 937.0, "--truth log", "for raw counts", None),
        (UNITS, 1.0, "--truth log --gyro-unit deg/s", "check its unit",
         "--truth log --gyro-unit rad/s"),
        (OTHERS, 1.0, "", "name its columns (--columns)",
         "--columns t,ax,ay,az,wx,wy,wz,mx,my,mz,-,-,-,- --gyro-unit rad/s"),
        (f"{UNITS} ", 1.0, "--truth log", "(--truth-world estimated)",
         "--truth log --truth-world estimated"),
    ],
)  # fmt: skip
def test_what_is_advised_is_done_and_helps(
    header, scale, given, said, done, tmp_path, simval
):
    world = TURNED if header.endswith(" ") else [0.0, 0.0, 0.0]
    log = made(0, seconds=30.0, rate=50.0, world=world)
    rows = [log.time, log.force, scale * log.gyro, log.field, log.truth.components]
    path = written(tmp_path / "a.csv", header.strip() + QUATERNION, *rows)
    words = "filter", path, "--plugin", "simval:mekf"
    code, _, err = simval(*words, *given.split())
    assert code in (2, 3)
    assert said in err
    if done is None:
        done = f"{given} {re.search(r'--gyro-unit [0-9.e-]+[0-9]', err)[0]}"
    code, _, err = simval(*words, *shlex.split(done))
    assert code == 0, err
