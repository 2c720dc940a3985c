r"""What a user's attitude filter must look like.

`make` is called anew for each trial with what the filter `reads`, by name, and makes an
object that is stepped through the readings, one row after the other:

    made.update(dt, gyroscope, accelerometer, magnetometer) -> answer

``dt`` is the time since the row before, s; the rate is the average over it, rad/s; the
specific force, m/s^2, and the field, T, are of its end, and so is the attitude that is
answered. The answer is the attitude, or a pair of attitude and covariance, or a mapping
with some of the words of `ANSWERS`. A covariance is of the rotation vector of the
error, rad^2, or larger with that first and the bias of the gyroscope, rad/s, next, both
estimate minus truth. What is made may have a `close`, which is called after its run.

Attitudes are declared as those of `simval.plugins.protocol`, from the filter's world
frame (`simval.plugins.reference_frames`) to the body.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, get_args

from simval.plugins.protocol import (
    Components,
    Plugin,
)
from simval.plugins.reference_frames import WORLDS, World
from simval.plugins.requirements import (
    require_function,
    require_name,
    require_one_of,
    require_words,
)

Force = Literal["specific force", "gravity"]

ANSWERS: Final = (
    "attitude",
    "covariance",
    "bias",
    "innovation",
    "innovation_covariance",
)
"""Words of an answer; all but the attitude may be left out."""

READS: Final = (
    "start",
    "start_std",
    "bias_std",
    "rate",
    "gravity",
    "field",
    "gyroscope_noise",
    "gyroscope_walk",
    "accelerometer_noise",
    "magnetometer_noise",
)
"""What `make` may be handed, by name: the attitude before the first row, as the filter
writes one, and its standard deviation per axis, rad; that of the bias, rad/s, which is
0 then; rows per second, Hz; gravity, m/s^2; the field in the filter's world, T, (3,);
angle random walk, rad/s/sqrt(Hz), and rate random walk, rad/s^2/sqrt(Hz), of the
gyroscope; noise per axis and row of the others, m/s^2 and T."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Filter(Plugin):
    """An attitude filter over gyroscope, accelerometer and magnetometer.

    Attributes
    ----------
    name : str
        Short name.
    make : callable
        ``make(**reads)``: an object with ``update``, or ``update`` itself.
    components : {"xyzs", "sxyz", "matrix"}
        Order of the quaternion, or a matrix.
    matrix : {"active", "passive"}
        Direction of the attitude.
    world : {"NED", "ENU", "NWU", "SEU", "WSU", "ESD", "SWD", "WND"}, optional
        Its reference frame, x, y and z by their letters; default the one found.
    accelerometer : {"specific force", "gravity"}, default "specific force"
        What it calls the accelerometer's reading: at rest up, or down.
    magnetometer : bool, default True
        Whether `update` takes the magnetometer's reading as well.
    side : {"body", "reference"}, default "body"
        Side of the attitude error that the covariance is of.
    reads : tuple of str, default ()
        What `make` is handed, out of `READS`.
    batch : bool, default False
        True steps all trials at once: each argument but ``dt`` and each answer has a
        leading axis n, and so has the start.
    """

    taken_by: ClassVar[str] = "filter.algorithm"
    runs: ClassVar[str] = "make"

    name: str
    make: Callable[..., Any]
    components: Components
    matrix: Literal["active", "passive"]
    world: World | None = None
    accelerometer: Force = "specific force"
    magnetometer: bool = True
    side: Literal["body", "reference"] = "body"
    reads: tuple[str, ...] = ()
    batch: bool = False

    def __post_init__(self) -> None:
        require_name(self.name)
        require_function("make", self.make)
        require_one_of("components", self.components, get_args(Components))
        require_one_of("matrix", self.matrix, ("active", "passive"))
        require_one_of("accelerometer", self.accelerometer, get_args(Force))
        require_one_of("magnetometer", self.magnetometer, (True, False))
        require_one_of("side", self.side, ("body", "reference"))
        require_one_of("batch", self.batch, (True, False))
        require_words("reads", self.reads, READS)
        if self.world is not None:
            require_one_of("world", self.world, WORLDS)
