"""The audit on simulators that are known to be right or wrong.

The zoo's motion is in closed form; nothing of it is shared with the audit's splines.
"""

from itertools import cycle

import numpy as np
import pytest
from faces import check_faces
from scipy import stats

from simval.errors import InputError, RefusedError
from simval.geometry import compose, conjugate, rotation_vector
from simval.imu.audit import Declared, SimulatedImu, audit
from simval.studies.simulated_imus import (
    DENSITY,
    KINDS,
    LEVER,
    MOUNT,
    ONE_SEED,
    G,
    declared,
    names,
    simulated,
)


def rng(*seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


@pytest.mark.parametrize(
    ("name", "noise"), [*zip(KINDS, cycle([0.01, 0.0]), strict=False)]
)
def test_what_is_wrong_is_found_and_named(name, noise):
    """Fewest wrong things; with noise of 0.01 m/s^2 a row and 0.001 rad/s."""
    seed = rng(7, list(KINDS).index(name))
    noise = 0.01 if name == DENSITY else noise
    imu = simulated(name, seed, rate=100.0, seconds=8.0, noise=noise)
    found = audit(imu, declared(noise if name == DENSITY else noise / 10.0))
    assert names(found) == KINDS[name].named, str(found)
    assert found.exit_code == (1 if KINDS[name].named else 0), str(found)
    check_faces(found.account)


RANGE = [
    (10.0, 10.0, {}), (10.0, 60.0, {"spin": 3.0, "turn": 1.5}), (50.0, 1.0, {}),
    (200.0, 2.0, {"noise": 0.05}), (1000.0, 1.0, {"pace": 3.0}),
    (10_000.0, 0.2, {"pace": 5.0}),
    (100.0, 5.0, {"move": 0.0, "turn": 0.0, "spin": 0.0}),
]  # fmt: skip


@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize(("rate", "seconds", "more"), RANGE)
def test_a_right_simulator_is_never_called_wrong(rate, seconds, more, single):
    """From 10 Hz to 10 kHz, at rest and tumbling, in single and double precision."""
    imu = simulated("right", rng(3), rate=rate, seconds=seconds, single=single, **more)
    for said in (declared(), Declared()):
        assert audit(imu, said).exit_code != 1, str(audit(imu, said))


@pytest.mark.parametrize(
    ("draw", "rate", "seconds", "pace"),
    [(555, 4371.0, 0.5, 0.6), (125, 2734.0, 1.0, 1.24)],
)
def test_a_short_motion_and_nothing_declared(draw, rate, seconds, pace):
    """No mirror for a turn of the mount, no delay for a lever arm."""
    imu = simulated(
        "right", rng(101, draw), rate=rate, seconds=seconds, pace=pace, noise=1e-4
    )
    found = audit(imu)
    assert found.exit_code != 1, str(found)


def test_at_rest_a_lever_arm_is_not_judged_and_is_no_pass():
    still = {"move": 0.0, "turn": 0.0, "spin": 0.0}
    found = audit(simulated("no lever arm", rng(1), **still), declared())
    assert found.exit_code == 3
    untold = found.untold(found.accelerometer)
    assert untold["lever arm"].startswith("turn about two axes")
    assert "gravity" not in untold
    # what is left out is not asked
    assert (
        audit(
            simulated("right", rng(1), **still), declared(), only=["gravity"]
        ).exit_code
        == 0
    )
    wrong = audit(simulated("gravity sign", rng(1), **still), declared())
    assert wrong.exit_code == 1
    assert "gravity" in str(wrong)


def test_a_turn_about_one_axis_does_not_tell_a_lever_arm_along_it():
    t = np.arange(2000) * 0.005
    angle = np.sin(2.0 * t)
    q = np.stack([0 * t, 0 * t, np.sin(angle / 2), np.cos(angle / 2)], axis=1)
    w = np.stack([0 * t, 0 * t, 2.0 * np.cos(2.0 * t)], axis=1)
    al = np.stack([0 * t, 0 * t, -4.0 * np.sin(2.0 * t)], axis=1)
    f = np.cross(al, LEVER) + np.cross(w, np.cross(w, LEVER)) + [0.0, 0.0, G]
    imu = SimulatedImu(
        time=t, position=0.0 * w, attitude=q, gyroscope=w, accelerometer=f
    )
    found = audit(imu, Declared(lever=LEVER, mount=np.eye(3), gravity=(0, 0, -G)))
    assert not names(found)
    assert found.exit_code == 3
    lever = found.accelerometer.items["lever"]
    assert lever.judged.tolist() == [True, True, False]


def test_what_is_not_declared_is_fitted():
    found = audit(simulated("right", rng(2), noise=0.01))
    assert found.exit_code == 0, str(found)
    # a root of 3 x 1990 squares is within 4 % in all but one of 1e5
    for each, noise in zip(found.sensors, (0.001, 0.01), strict=True):
        assert each.deviation == pytest.approx(noise, rel=0.08)
    value, sd = found.accelerometer.fitted["lever"]
    assert np.all(np.abs(value - LEVER) < 5.0 * sd)
    assert np.all(sd < 0.005)
    assert np.abs(found.gyroscope.mount - MOUNT).max() < 1e-3


@pytest.mark.parametrize("instant", [0.5, -0.5])
def test_a_mean_over_the_step_is_a_convention(instant):
    """A rate by the turn of a step: half a step late or early, and no finding."""
    imu = simulated("right", rng(4))
    q = imu.attitude
    turns = rotation_vector(compose(conjugate(q[:-1]), q[1:])) / imu.step @ MOUNT.T
    wide = (
        np.vstack([turns[:1], turns]) if instant > 0 else np.vstack([turns, turns[-1:]])
    )
    found = audit(
        SimulatedImu(time=imu.time, position=imu.position, attitude=q, gyroscope=wide,
                     accelerometer=imu.accelerometer), declared(),
    )  # fmt: skip
    assert found.exit_code == 0, str(found)
    assert found.gyroscope.instant == instant
    assert found.reckoning.instants > 10.0 * found.reckoning.position


def test_rounded_poses_do_not_excuse_a_late_reading():
    """What a second derivative of single precision has from row to row goes nowhere."""
    late = simulated("gyroscope late in steps", rng(4), single=True, size=0.1)
    assert not audit(late, declared()).reckoning.good


def test_noise_is_no_delay():
    """Noise of 0.1 m/s^2: the delay's error bar says how little it is known."""
    sizes = []
    for k in range(5):
        imu = simulated("right", rng(5, k), rate=100.0, noise=0.1)
        found = audit(imu, declared())
        delay = found.accelerometer.items["delay"]
        assert not delay.wrong
        sizes.append(float(delay.value[0] / delay.sd[0]))
    assert 0.3 < np.std(sizes) < 2.0


def test_power_is_what_the_allowance_says():
    """A lever arm off by two allowances is found, one by a third of one is not."""
    imu = simulated("right", rng(6), noise=0.02, seconds=20.0)
    allowed = audit(imu, declared()).accelerometer.items["lever"].allowed
    for times, code in ((2.5, 1), (0.3, 0)):
        off = Declared(
            lever=LEVER + times * allowed, mount=MOUNT, gravity=declared().gravity
        )
        assert audit(imu, off).exit_code == code


def test_the_noise_that_is_declared_is_tested():
    rate, noise = 200.0, 0.02
    imu = simulated("right", rng(8), rate=rate, noise=noise, seconds=6.0)
    right = noise / np.sqrt(rate)
    claim = {"accelerometer": (right, 0.0, 0.0), "gyroscope": (0.1 * right, 0.0, 0.0)}
    said = declared()
    for factor, code in ((1.0, 0), (np.sqrt(rate), 1), (1.1, 1), (0.0, 1)):
        noises = {k: tuple(factor * x for x in v) for k, v in claim.items()}
        own = Declared(lever=LEVER, mount=MOUNT, gravity=said.gravity, noise=noises)
        assert audit(imu, own).exit_code == code, factor
    # a walk beside it that is not declared
    still = simulated(
        "right", rng(8), noise=noise, seconds=30.0, move=0.0, turn=0.0, spin=0.0
    )
    walk = np.cumsum(rng(9).standard_normal((*still.time.shape, 3)), axis=0)
    more = SimulatedImu(
        time=still.time, position=still.position, attitude=still.attitude,
        gyroscope=still.gyroscope, accelerometer=still.accelerometer + 2e-3 * walk,
    )  # fmt: skip
    own = Declared(lever=LEVER, mount=MOUNT, gravity=said.gravity, noise=claim)
    assert audit(still, own).exit_code == 3
    assert "Allan variance" in str(audit(more, own))


def test_one_seed_of_two_axes_is_seen():
    imu = simulated("right", rng(10))
    noise = 0.01 * rng(11).standard_normal(imu.accelerometer.shape)
    for other, code in (
        (0.1 * noise, 1),
        (1e-3 * rng(12).standard_normal(noise.shape), 0),
    ):
        both = SimulatedImu(
            time=imu.time, position=imu.position, attitude=imu.attitude,
            gyroscope=imu.gyroscope + other, accelerometer=imu.accelerometer + noise,
        )  # fmt: skip
        found = audit(both, declared())
        assert found.exit_code == code, str(found)
    assert not found.shared


def test_noise_in_bursts_is_not_of_one_seed():
    """Forty loud rows decide a correlation, which chance then makes as great as 0.2."""
    imu = simulated("right", rng(10))
    noise = 0.01 * rng(24, 2).standard_normal(imu.accelerometer.shape)
    noise[800:840] *= 11.0
    loud = SimulatedImu(
        time=imu.time, position=imu.position, attitude=imu.attitude,
        gyroscope=imu.gyroscope, accelerometer=imu.accelerometer + noise,
    )  # fmt: skip
    found = audit(loud, declared())
    assert found.exit_code == 0, str(found)


@pytest.mark.parametrize("row", [2, 700])
def test_readings_far_off_are_told_with_their_time(row):
    imu = simulated("right", rng(13), noise=0.01)
    force = imu.accelerometer.copy()
    force[row] += 15.0
    found = audit(
        SimulatedImu(time=imu.time, position=imu.position, attitude=imu.attitude,
                     gyroscope=imu.gyroscope, accelerometer=force), declared(),
    )  # fmt: skip
    assert names(found) == {"spikes"}
    assert found.spikes.tolist() == pytest.approx([imu.time[row]])
    assert found.exit_code == 1


def test_a_jump_of_the_poses_is_left_out():
    imu = simulated("right", rng(14))
    place = imu.position.copy()
    place[1000:] += 3.0
    found = audit(
        SimulatedImu(time=imu.time, position=place, attitude=imu.attitude,
                     gyroscope=imu.gyroscope, accelerometer=imu.accelerometer),
        declared(),
    )  # fmt: skip
    assert found.exit_code == 0, str(found)
    assert np.all(np.abs(found.rough - imu.time[1000]) < 0.2)


def test_poses_of_another_clock():
    """Poses at other times than readings, at another rate."""
    imu = simulated("right", rng(15))
    poses = simulated("right", rng(15), rate=150.0)
    found = audit(
        SimulatedImu(time=imu.time, position=poses.position, attitude=poses.attitude,
                     pose_time=poses.time, gyroscope=imu.gyroscope,
                     accelerometer=imu.accelerometer), declared(),
    )  # fmt: skip
    assert found.exit_code == 0, str(found)


def test_a_tilted_gravity_is_no_gravity_of_another_size():
    tilted = Declared(lever=LEVER, mount=MOUNT, gravity=(1.0, 0.0, -9.75))
    found = audit(simulated("right", rng(23), noise=0.005), tilted)
    (said,) = [what for _, what, _ in found.wrong()]
    assert said.startswith("has gravity along")


def test_what_cannot_be_audited_is_refused():
    imu = simulated("right", rng(1), seconds=1.0)
    few = {name: getattr(imu, name)[:20] for name in ("time", "position", "attitude")}
    with pytest.raises(RefusedError, match="too few"):
        SimulatedImu(**few, gyroscope=imu.gyroscope[:20])
    with pytest.raises(InputError, match="neither"):
        SimulatedImu(time=imu.time, position=imu.position, attitude=imu.attitude)
    with pytest.raises(InputError, match="no rotation"):
        Declared(mount=2.0 * np.eye(3))
    with pytest.raises(InputError, match="gravity"):
        Declared(gravity=np.zeros(3))
    with pytest.raises(InputError, match="only"):
        audit(imu, only=["colour"])


@pytest.mark.slow
def test_right_simulators_are_refused_at_the_rate_that_is_stated():
    """Drawn over rates, lengths, paces and noises; at a rate that can be counted."""
    draw, alpha, count, refused = rng(20), 0.05, 200, 0
    for k in range(count):
        imu = simulated(
            "right", rng(21, k), rate=float(10.0 ** draw.uniform(1.3, 3.0)),
            seconds=float(draw.uniform(2.0, 12.0)),
            noise=float(10.0 ** draw.uniform(-5.0, -0.5)),
            pace=float(draw.uniform(0.3, 1.0)), single=bool(draw.integers(2)),
        )  # fmt: skip
        found = audit(imu, declared(), alpha=alpha)
        refused += found.exit_code == 1
    assert refused <= stats.binom.isf(1e-3, count, alpha)


@pytest.mark.slow
@pytest.mark.parametrize("name", [x for x in KINDS if x not in (DENSITY, ONE_SEED)])
def test_what_is_wrong_is_found_whatever_its_size(name):
    """Drawn over rates, paces, sizes and noises; one of twenty may be misnamed."""
    draw, missed = rng(22, list(KINDS).index(name)), []
    for k in range(20):
        imu = simulated(
            name, rng(23, k), rate=float(10.0 ** draw.uniform(1.7, 2.7)), seconds=8.0,
            noise=float(draw.choice([0.0, 1e-3, 1e-2])),
            pace=float(draw.uniform(0.7, 1.5)),
        )  # fmt: skip
        found = audit(imu, declared())
        if names(found) != KINDS[name].named:
            missed.append(names(found))
    assert len(missed) <= 1, missed
