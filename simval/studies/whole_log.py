r"""Whole logs: choices, error bars and joint fits of `simval calibrate`.

Each trial is a log of three sensors on the gimbal, read as a user's: the rests are
found, the noise is measured in the longest, temperature and specific force are judged
by evidence, and accelerometer, gyroscope and magnetometer are fitted together. Every
second log has no temperature and a gyroscope that feels no force; in the others the
biases of accelerometer and gyroscope are linear in temperature, and the gyroscope feels
force. So each choice of the evidence is asked for where it is right and where it is
wrong.

Errors are judged by the chance that the stated covariance gives to errors as great (or
as small), from chi-square where the noise is taken as known, from F where it is
estimated with few degrees of freedom. Of n independent chances u

.. math:: X = -\tfrac{1}{n} \sum \ln u_i  \tag{WL1}

is Fisher's combination, n X of the gamma law of shape n. A log takes seconds, so there
are too few of them for a mean with a standard error: each row is held to a limit
that it exceeds in `SELDOM` of the runs. Error bars of a log are never narrowed and
sometimes widened by its own residuals, so of small errors it is asked only whether the
bars are too wide by more than `WIDER`.
"""

from collections.abc import Iterator

import numpy as np
import scipy

from simval import statistics as stat
from simval.arrays import Array
from simval.consistency import normalised_squares
from simval.errors import RefusedError
from simval.figures import Headline, Quote
from simval.geometry import normalize
from simval.imu.calibrate.thermal import Term
from simval.imu.logs import Log
from simval.imu.multiposition import LogCalibration, calibrate_log, calibrate_sensors
from simval.imu.multiposition.noise import log_noise
from simval.imu.sensor import (
    Effects,
    GyroscopeEffects,
    ImuModel,
    MagnetometerEffects,
    Motion,
    read_imu,
)
from simval.poses import PARAMETERS
from simval.results import Outcome, Row, limit
from simval.scene import simulate_cached
from simval.scene.trajectory import motion_of
from simval.streams import Streams
from simval.studies.calibration import true_sensor
from simval.studies.gyroscope import true_gyroscope
from simval.studies.magnetometer import true_magnetometer
from simval.studies.study import Cost, StudyParameters, ranged
from simval.studies.trials import Drawn, drawn_rows

TITLE = "Whole log: do evidence, error bars and joint fits of a user's log hold?"
SECTION = None
HEADLINE = Headline(
    says="errors of all three sensors are {surprise} times as surprising as their "
    "stated error bars expect",
    quotes={
        "surprise": Quote(
            of=stat.CHANCE_OF_ERRORS("all three", "great"), by=stat.CHI_SQUARE
        )
    },
)

EVERY = 10  # rows of 500 Hz to a row of the log
STD = {"accelerometer": 0.01, "gyroscope": 1e-3, "magnetometer": 1e-3}
"""Noise of a row: m/s^2, rad/s, and of a field of length 1."""
WARM = {
    "accelerometer": np.array([2e-3, -3e-3, 1e-3]),  # m/s^2/K
    "gyroscope": np.array([3.5e-4, -1.7e-4, 2.6e-4]),  # rad/s/K
}
FORCE = 2e-4 * np.array([[1.0, -0.5, 0.0], [0.3, 0.8, 0.2], [0.0, 0.4, -1.0]])
"""Sensitivity of the gyroscope, rad/s per m/s^2."""
MIDDLE, SWING, CYCLES = 25.0, 10.0, 1.3
"""Temperature of a log: degrees Celsius, K, and periods, so that no drift is alike."""
PARTS = {
    "accelerometer": slice(0, 9),
    "gyroscope": slice(9, 21),
    "magnetometer": slice(21, 34),
    "all three": slice(0, 34),
}
LINE = (("bias", 1),)
KNOWN = 1e12  # degrees of freedom of a noise that is taken as known
LEVEL = (
    0.95  # of intervals; a choice of the evidence is wrong less often than these miss
)
NOISED = 5
"""One log without effects in so many has its noise described, too."""
SELDOM = 1e-6
"""Chance that a row exceeds its limit where nothing is wrong: of a suite's, far below
its rate."""
WIDER = 2.0
"""Of a variance: so much wider may bars be. Squared errors of all three were 0.8 of the
stated ones: residuals with few degrees of freedom widen and never narrow."""


class Parameters(StudyParameters):
    """One cell: the rests of a log, and how many logs."""

    poses: int = ranged(20, "Rests, spread evenly over the sphere.", 20, 60)
    trials: int = ranged(40, "Logs, half of them with effects.", 6, 10_000)

    def cost(self) -> Cost:
        """Cost of a cell: 0.3 s for a log of twenty rests."""
        return Cost(0.3 + (0.1 + 0.01 * self.poses) * self.trials, 32)


class Sensors:
    """The true IMU on its tumble, and the logs that it records."""

    def __init__(self, poses: int, *, effects: bool) -> None:
        run = simulate_cached(
            "gimbal", poses=poses, move_time=2.0, hold_time=1.6, first_hold=20.0
        )
        motion = motion_of(run, EVERY)
        self.motion = Motion(
            time=motion.time, specific_force=motion.specific_force, rate=motion.rate,
            field=motion.field / np.linalg.norm(run.magnetic),
        )  # fmt: skip
        self.g, self.effects = run.g, effects
        self.gyroscope = true_gyroscope(G=effects * FORCE)
        self.accelerometer, compass = true_sensor(0.0), true_magnetometer()
        self.imu = ImuModel(
            accelerometer=self.accelerometer,
            accelerometer_effects=Effects(noise_std_raw=STD["accelerometer"]),
            gyroscope=self.gyroscope,
            gyroscope_effects=GyroscopeEffects(noise_std_raw=STD["gyroscope"]),
            magnetometer=compass,
            magnetometer_effects=MagnetometerEffects(noise_std_raw=STD["magnetometer"]),
        )
        dip = -np.arcsin(normalize(run.magnetic)[2])
        self.compass = np.concatenate([compass.M.ravel(), compass.b, [dip]])
        along = (motion.time - motion.time[0]) / np.ptp(motion.time)
        self.warm = SWING * np.sin(2.0 * np.pi * CYCLES * along)  # about the middle, K

    def warmed(self, sensor: str) -> Array:
        """Slope of a sensor's bias with temperature."""
        return WARM[sensor] * self.effects

    def log(self, rng: np.random.Generator) -> tuple[Log, dict[str, Array]]:
        """Draw a log; return it with its noise relative to the stated one."""
        read, time = read_imu(self.imu, self.motion, rng), self.motion.time
        assert read.gyroscope is not None
        assert read.magnetometer is not None
        force, rate = (
            sensor.raw + np.multiply.outer(self.warm, self.warmed(name))
            for sensor, name in zip(
                (read.accelerometer, read.gyroscope), WARM, strict=True
            )
        )
        log = Log(
            path="log", time=time, accelerometer=force, gyro=rate,
            magnetometer=read.magnetometer.raw,
            rate=(len(time) - 1) / float(np.ptp(time)),
            temperature=MIDDLE + self.warm if self.effects else None,
        )  # fmt: skip
        readings = read.accelerometer, read.gyroscope, read.magnetometer
        noise = {
            name: each.noise_raw / std
            for (name, std), each in zip(STD.items(), readings, strict=True)
        }
        return log, noise

    def truth(self, found: LogCalibration) -> Array:
        """The 34 true parameters, biases at the fit's reference temperatures."""
        bias = {"accelerometer": self.accelerometer.B, "gyroscope": self.gyroscope.B}
        for name, thermal in found.taken.thermal.items():
            if name in bias:
                away = thermal.reference - MIDDLE
                bias[name] = bias[name] + self.warmed(name) * away
        own = self.accelerometer.parameters[:6], bias["accelerometer"]
        return np.concatenate(
            [*own, self.gyroscope.M.ravel(), bias["gyroscope"], self.compass]
        )


class Judged:
    """Results of a cell's logs: squared errors, and choices made by evidence."""

    def __init__(self) -> None:
        # normalised squares of p errors, with the degrees of freedom of their bars
        self.errors: dict[str, list[tuple[float, int, float]]] = {}
        self.wrong: dict[str, list[bool]] = {}
        self.missed: list[bool] = []  # effects
        self.outside: list[bool] = []  # intervals of N

    def add(self, name: str, error: Array, covariance: Array, dof: float) -> None:
        """Add errors, with the stated covariance and its degrees of freedom."""
        square = float(normalised_squares(error, covariance))
        self.errors.setdefault(name, []).append((square, error.size, dof))

    def calibration(self, sensors: Sensors, log: Log) -> None:
        """Calibrate a log."""
        try:
            alone = calibrate_log(log, g=sensors.g)
            found = calibrate_sensors(log, alone)
        except RefusedError:
            found = None
        whole = None if found is None else found.together
        self.wrong.setdefault("refused", []).append(whole is None)
        if found is None or whole is None:
            return
        truth, own = sensors.truth(found), alone.fit
        if not found.taken.thermal:
            off, dof = own.parameters - truth[:9], len(alone.intervals) - PARAMETERS
            self.add("accelerometer alone", off, own.covariance, dof)
        error, P = whole.parameters - truth, whole.covariance
        for name, part in PARTS.items():
            self.add(name, error[part], P[part, part], KNOWN)
        self.choices(sensors, found)

    def choices(self, sensors: Sensors, found: LogCalibration) -> None:
        """Add which terms were chosen, and the errors of those rightly chosen."""
        seen = {name: each.terms for name, each in found.taken.thermal.items()}
        if found.taken.G.any():
            seen["force"] = LINE
        there = (*WARM, "force") if sensors.effects else ()
        self.missed += [name not in seen for name in there]
        kind = "effects" if sensors.effects else "none"
        for name in (*WARM, "magnetometer", "force") if sensors.effects else ("force",):
            more = seen.get(name, LINE) != LINE if name in there else name in seen
            self.wrong.setdefault(f"{name}, {kind}", []).append(more)
        assert found.gyroscope is not None
        walks = found.gyroscope.bias != "constant"
        self.wrong.setdefault(f"bias walks, {kind}", []).append(walks)
        if not sensors.effects:
            return
        for name, slope in WARM.items():
            own = found.taken.thermal.get(name)
            # with a square that only chance added, the remaining scatter is too small
            if own is not None and own.terms == LINE:
                self.terms(name, own, slope)
        off = found.taken.G - FORCE
        for row, sd in zip(off, found.taken.G_sd, strict=True):
            if sd.all():
                self.add("force", row, np.diag(sd**2), KNOWN)

    def terms(self, name: str, found: Term, slope: Array) -> None:
        """Add the errors of three axes' coefficients."""
        off, sd = found.coefficients[0] - slope, found.sd[0]
        self.add(f"{name} in temperature", off, np.diag(sd**2), found.dof)

    def noise(self, log: Log) -> None:
        """Add the errors of a log's noise."""
        found = log_noise(log)
        for axes, std in zip(
            (found.accelerometer, found.gyro, found.magnetometer),
            STD.values(),
            strict=True,
        ):
            N = std / np.sqrt(log.rate)
            self.outside += [
                not each.low <= N <= each.high
                for axis in axes for each in axis.coefficients if each.kind == "N"
            ]  # fmt: skip

    def rows(self) -> Iterator[Row]:
        """Rows that compare each result with chance."""
        for name, errors in self.errors.items():
            square, p, dof = np.array(errors).T
            most = scipy.special.gammaincinv(len(p), 1.0 - SELDOM) / len(p)
            for side, u in (
                ("great", scipy.special.fdtrc(p, dof, square / p)),
                ("small", scipy.special.fdtr(p, dof, WIDER * square / p)),
            ):
                X = -np.mean(np.log(np.maximum(u, np.finfo(float).tiny)))
                yield from limit(
                    stat.CHANCE_OF_ERRORS(name, side), X, most, stat.CHI_SQUARE, len(p)
                )
        yield from limit(
            stat.MISJUDGED("missed"), np.mean(self.missed), 0.0, stat.TRUTH
        )
        wrong = {**self.wrong, "interval of N": self.outside}
        for name, some in wrong.items():
            n, rate = len(some), 1.0 - LEVEL
            most = scipy.special.bdtrik(1.0 - SELDOM, n, rate) / n
            yield from limit(
                stat.MISJUDGED(name),
                np.mean(some),
                np.ceil(n * most) / n,
                stat.BINOMIAL,
                n,
            )


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Calibrate the logs of one cell."""
    kinds = [Sensors(parameters.poses, effects=effects) for effects in (False, True)]
    judged, blocks = Judged(), []
    for number in range(parameters.trials):
        sensors = kinds[number % 2]
        log, noise = sensors.log(streams.block(number))
        blocks.append({name: Drawn.of(each) for name, each in noise.items()})
        judged.calibration(sensors, log)
        if number % (2 * NOISED) == 0:
            judged.noise(log)
    return Outcome(rows=(*judged.rows(), *drawn_rows(blocks)))
