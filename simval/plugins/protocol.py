r"""Protocol of users' algorithms: estimators, calibrators and filters.

Quaternions are declared by two words. ``components`` is the order: ``xyzs`` with the
scalar last or ``sxyz`` with the scalar first. ``matrix`` is the direction: with
:math:`R(q) v = q v q^*` the rotation matrix of Hamilton's product (SciPy's
``as_matrix``), an ``active`` quaternion gives :math:`b = R(q) r` and a ``passive`` one,
which is the package's own, :math:`b = R(q)^T r`.

A covariance is of the rotation vector of the error: on the ``body`` side
:math:`\hat q = q * \delta q`, on the ``reference`` side :math:`\hat q = \delta q * q`
(passive quaternions). ``claim`` says how good it is: ``"exact"``, or the highest order
of the noise that it keeps.

With ``components="matrix"`` the answer is the matrix M itself, ``active`` if
:math:`b = M r` and ``passive`` if :math:`b = M^T r`.

`make` is called anew for each trial with what the filter `reads`, by name, and makes an
object that is stepped through the readings, one row after the other:

    made.update(dt, gyroscope, accelerometer, magnetometer) -> answer

``dt`` is the time since the row before, s; the rate is the average over it, rad/s; the
specific force, m/s^2, and the field, T, are of its end, and so is the attitude that is
answered. The answer is the attitude, or a pair of attitude and covariance, or a mapping
with some of the words of `ANSWERS`. A covariance is of the rotation vector of the
error, rad^2, or larger with that first and the bias of the gyroscope, rad/s, next, both
estimate minus truth. What is made may have a `close`, which is called after its run.

Attitudes of a filter are declared likewise, from its world frame
(`simval.plugins.attitudes`) to the body.
"""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from itertools import product
from pathlib import Path
from types import MappingProxyType, NoneType
from typing import Any, ClassVar, Final, Literal, TypeVar, get_args, get_origin

from simval.arrays import Array
from simval.errors import PluginError
from simval.geometry import Frame
from simval.imu.sensor.models import ALL, CLASSES
from simval.plugins.attitudes import (
    GREATEST_DIP,
    MAY_FAIL,
    FixedReferences,
    Observed,
    Vertical,
    World,
)
from simval.plugins.noise import READABLE
from simval.text import one_line
from simval.vocabulary import Model


def _require(field: str, value: Any, kind: Any, known: tuple[str, ...]) -> None:
    """Refuse a declaration whose value does not fit its annotation."""
    if NoneType in get_args(kind):
        if value is None:
            return
        (kind,) = (each for each in get_args(kind) if each is not NoneType)
    allowed = get_args(kind) if get_origin(kind) is Literal else ()
    allowed = (True, False) if kind is bool else allowed
    # of the very type: 2 == 2.0, 1 == True, and an array is equal to nothing at all
    fits = [type(value) is type(word) and value == word for word in allowed]
    wanted = ""
    if field == "name" and not _is_name(value):
        wanted = (
            "give a printable word of at most 60 characters, with no comma in it and "
            "no space around it: it is written in lists of names"
        )
    elif allowed and not any(fits):
        wanted = f"it must be declared as one of {', '.join(map(repr, allowed))}"
    elif known and not _are_names(value, known):
        wanted = f"it must be a tuple of names out of {', '.join(map(repr, known))}"
    elif get_origin(kind) is Callable and not callable(value):
        wanted = "it must be a function"
    if wanted:
        msg = f"`{field}` is {value!r}; {wanted}"
        raise PluginError(msg)


def _is_name(value: Any) -> bool:
    return (
        isinstance(value, str)
        and value.isprintable()
        and value == value.strip()
        and "," not in value
        and 0 < len(value) <= 60
    )


def _are_names(values: Any, known: tuple[str, ...]) -> bool:
    return isinstance(values, tuple) and all(
        type(value) is str and value in known for value in values
    )


def declarations(plugin: Any) -> dict[str, str]:
    """Spell each declaration except the name, and except those left open."""
    if not is_dataclass(plugin):
        return {}
    values = {each: getattr(plugin, each.name) for each in fields(plugin)}
    return {
        each.name: one_line(_spelled(value))
        for each, value in values.items()
        # a function without a default is the algorithm itself
        if not (each.default is MISSING and callable(value))
        if each.name != "name" and value is not None
    }


def _spelled(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return ", ".join(map(_spelled, value)) or "none"
    if isinstance(value, Path):
        return value.name
    return "given" if callable(value) else str(value)


Claim = Literal["exact", 2, 4]
Components = Literal["xyzs", "sxyz", "matrix"]
Kind = Literal["wahba", "weighted wahba", "triad", "closed form", "combined"]

Own = TypeVar("Own", bound="Algorithm")

SCENE = "custom_scene.scene"
"""Field of a study that takes a `simval.scene.Scene`."""


class Plugin:
    """Something that a user brings: a name, and a function for a study to run."""

    __slots__ = ()
    name: str
    taken_by: ClassVar[str]
    runs: ClassVar[str]


class Algorithm(Plugin):
    """A plug-in that is measured; its annotations say what it may declare."""

    __slots__ = ()
    conventions: ClassVar[tuple[str, ...]] = ()
    """Fields that a probe may find to be others than they are declared."""
    known: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({})
    """What tuples of names may hold, by field."""

    def __post_init__(self) -> None:
        every: Any = type(self)
        for each in fields(every):
            known = self.known.get(each.name, ())
            _require(each.name, getattr(self, each.name), each.type, known)

    def spelled(self, than: "Algorithm | None" = None) -> str:
        """Spell its conventions, or only those in which it differs from another."""
        return ", ".join(
            f'{name}="{value}"'
            for name in self.conventions
            if (value := getattr(self, name)) is not None
            and (than is None or value != getattr(than, name))
        )


def alternatives(algorithm: Own) -> list[Own]:
    """The algorithm in every combination of conventions."""
    own: Any = algorithm
    kinds = {each.name: each.type for each in fields(own)}
    names = algorithm.conventions
    return [
        replace(own, **dict(zip(names, chosen, strict=True)))
        for chosen in product(*(_literals(kinds[name]) for name in names))
    ]


def _literals(kind: Any) -> tuple[Any, ...]:
    """Values that a literal type allows, optional or not."""
    args = get_args(kind)
    return get_args(args[0]) if NoneType in args else args


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimator(Algorithm):
    """An attitude estimator from vector observations.

    Attributes
    ----------
    name : str
        Short name.
    estimate : callable
        ``estimate(b1, b2, r1, r2)``: takes (n, 3) each and returns attitudes, as
        quaternions (n, 4) of unit length or rotation matrices (n, 3, 3).
    components : {"xyzs", "sxyz", "matrix"}
        Order of the quaternion, or a matrix.
    matrix : {"active", "passive"}
        Direction of the attitude.
    covariance : callable, optional
        ``covariance(b1, b2, r1, r2, noise_std)``: covariance of the rotation vector of
        the error, rad^2, (n, 3, 3) or (3, 3).
    side : {"body", "reference"}, default "body"
        Side of the error that `covariance` describes.
    claim : {"exact", 2, 4}, default 2
        Order in the noise to which `covariance` is claimed to be right, or exact.
    fails_at : tuple of str, default ()
        Classes of attitudes (`simval.plugins.attitudes`) at which it is known to fail.
        There it is measured but not judged.
    kind : {"wahba", "weighted wahba", "triad", "closed form", "combined"}, optional
        Class of estimators (`simval.theory.estimators`) whose leading bias and
        covariance it must have.
    takes : {"pairs", "vectors"}, default "pairs"
        ``"vectors"`` calls ``estimate(body, references)`` with (n, k, 3) each, k >= 2.
    batch : bool, default True
        False calls `estimate` and `covariance` row by row, without the axis n.
    reference : {"NED", "ENU", "NWU"}, optional
        Frame in which the references are fixed. The first is the vertical, the second
        the Earth's field.
    vertical : {"up", "down"}, default "up"
        Direction of the first reference of such a frame.
    dip : float, optional
        Dip of the field that the estimator was written for, rad; by default any.
    reads : tuple of {"noise_std", "weights", "covariances"}, default ()
        Further arguments that `estimate` and `covariance` get, by these names.
    series : bool, default False
        Whether `estimate` uses only ``+ - * / **``, `abs`, comparisons and
        `numpy.sqrt`, so that it works with power series (`simval.theory.series`).
    arithmetic : callable, optional
        The method of `estimate` for one sample of unit vectors, and weights whose sum
        is 1. It must accept numbers of any class, because its operations are counted.
    """

    taken_by: ClassVar[str] = "estimator.algorithm"
    runs: ClassVar[str] = "estimate"
    conventions: ClassVar[tuple[str, ...]] = ("components", "matrix")
    known: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType(
        {"fails_at": MAY_FAIL, "reads": READABLE}
    )

    name: str
    estimate: Callable[..., Any]
    components: Components
    matrix: Literal["active", "passive"]
    covariance: Callable[..., Any] | None = None
    side: Literal["body", "reference"] = "body"
    claim: Claim = 2
    fails_at: tuple[str, ...] = ()
    kind: Kind | None = None
    takes: Literal["pairs", "vectors"] = "pairs"
    batch: bool = True
    reference: Frame | None = None
    vertical: Vertical = "up"
    dip: float | None = None
    reads: tuple[str, ...] = ()
    series: bool = False
    arithmetic: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        Algorithm.__post_init__(self)
        _check_frame(self)

    @property
    def fixed(self) -> FixedReferences | None:
        """The references that it was written for; None if it is given them."""
        if self.reference is None:
            return None
        return FixedReferences(
            frame=self.reference, vertical=self.vertical, dip=self.dip
        )

    def observed(self, vectors: int = 2) -> Observed:
        """The vectors that it observes.

        Parameters
        ----------
        vectors : int, default 2
            Body vectors, and as many references.

        Returns
        -------
        Observed
            How its exact cases are drawn.
        """
        return Observed(vectors=vectors, fixed=self.fixed)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibrator(Algorithm):
    """A calibrator from readings at rest.

    Attributes
    ----------
    name : str
        Short name.
    calibrate : callable
        ``calibrate(poses, g)``, one set at a time.
    form : {"triangular", "upper", "symmetric"}, default "triangular"
        Form of the parameters whose covariance it returns, see
        `simval.imu.sensor.forms`.
    noise_std : bool, default False
        Whether `calibrate` takes ``noise_std``, the noise of a pose mean, as well.
    estimates : tuple of str, default ("misalignment", "scale", "bias")
        What it estimates; ``("scale", "bias")`` and ``("bias",)`` are also allowed.
    """

    taken_by: ClassVar[str] = "calibrator.algorithm"
    runs: ClassVar[str] = "calibrate"

    name: str
    calibrate: Callable[..., Any]
    form: Model = "triangular"
    noise_std: bool = False
    estimates: tuple[str, ...] = ALL

    def __post_init__(self) -> None:
        Algorithm.__post_init__(self)
        object.__setattr__(self, "estimates", _estimates(self.estimates, self.form))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BatchCalibrator(Calibrator):
    """A calibrator that takes many sets of poses at once.

    ``calibrate_all(sets, g, noise_std, seconds)`` answers each of ``sets``, (t, n, 3),
    in their order, and raises if that takes longer than ``seconds``.
    """

    calibrate_all: Callable[[Array, float, float, float], list[Any]]


def _check_frame(estimator: Estimator) -> None:
    dip = estimator.dip
    if estimator.reference is None and (estimator.vertical != "up" or dip is not None):
        msg = (
            f"`vertical` is {estimator.vertical!r} and `dip` is {dip!r}; both "
            "describe the vectors of a fixed frame, so declare its `reference` "
            "as well"
        )
        raise PluginError(msg)
    number = isinstance(dip, int | float) and not isinstance(dip, bool)
    if dip is not None and not (number and -GREATEST_DIP <= dip <= GREATEST_DIP):
        msg = (
            f"`dip` is {dip!r}; it must be a number of {GREATEST_DIP} or less either "
            "way, rad, positive where the field points down"
        )
        raise PluginError(msg)


def _estimates(names: Any, form: str) -> tuple[str, ...]:
    """Parameters that a calibrator estimates, in their order."""
    words = tuple(names) if isinstance(names, tuple | list) else ()
    plain = all(type(word) is str for word in words)
    known = tuple(word for word in ALL if plain and word in words)
    if known not in CLASSES or len(words) != len(known):
        allowed = " or ".join(repr(each) for each in CLASSES)
        msg = f"`estimates` is {names!r}; it must be declared as {allowed}"
        raise PluginError(msg)
    if known != ALL and form != "triangular":
        msg = (
            f"`form` is {form!r}, but a calibrator of {' and '.join(known)} has no "
            "misalignment to write in another form; leave it out"
        )
        raise PluginError(msg)
    return known


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
class Filter(Algorithm):
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
        Its reference frame, by the letters of x, y and z; found by itself if not given.
    accelerometer : {"specific force", "gravity"}, default "specific force"
        What it expects as the accelerometer's reading: at rest up, or down.
    magnetometer : bool, default True
        Whether `update` takes the magnetometer's reading as well.
    side : {"body", "reference"}, default "body"
        Side of the attitude error that the covariance describes.
    reads : tuple of str, default ()
        Names of the arguments that `make` gets, out of `READS`.
    batch : bool, default False
        True steps all trials at once: each argument except ``dt``, each answer and the
        start have a leading axis n.
    """

    taken_by: ClassVar[str] = "filter.algorithm"
    runs: ClassVar[str] = "make"
    conventions: ClassVar[tuple[str, ...]] = (
        "world",
        "components",
        "matrix",
        "accelerometer",
    )
    known: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({"reads": READS})

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
