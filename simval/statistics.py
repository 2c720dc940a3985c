"""The vocabulary: statistics that are measured, and theories to compare them with.

A statistic is a member of a family: ``BIAS("K_x")`` is the bias of one entry,
``NEES()`` stands alone, and `controlled` says that it was sampled with control
variates. Studies name what they measure with it; gate, comparison and report ask it
instead of reading a name. `str` spells it as ``results.csv`` does:
``control covariance[x,y]``.

A new statistic is a new line above `FAMILIES`, which collects them.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, PlainSerializer

from simval.errors import InputError

Scale = Literal["value", "variances", "sample"]
Better = Literal["less", "more", "zero", "prediction"]


@dataclass(frozen=True, slots=True)
class Family:
    """A kind of statistic, such as a bias, with its name and unit."""

    name: str  # as ``results.csv`` spells it
    words: str  # what a person calls it
    unit: str = "1"  # unit of its members, where they do not say another
    # change that is no change where the noise is another: a share of `scale`
    margin: float = 0.01
    # what the margin is a share of: the value itself; of an off-diagonal
    # covariance the root of its two variances; or the standard deviation of one
    # sample
    scale: Scale = "value"
    # what its values can be
    least: float = -inf
    most: float = inf
    # which way is better: less of it, as of most (errors, times, costs); more of
    # it; nearer to zero; nearer to what theory predicts; or None where neither is
    better: Better | None = "less"
    # whether the last entry is a number along which it is measured: an instant, a
    # noise level, an averaging length
    along: bool = False
    # whether it is of one draw of the noise and says nothing of its spread: another
    # seed is another value
    one_draw: bool = False

    def __hash__(self) -> int:
        return hash(self.name)  # of a dozen fields it alone tells two apart

    def __call__(self, *entries: str, unit: str | None = None) -> "Statistic":
        """Return the statistic of the family without entries."""
        return Statistic(
            family=self, entries=entries, unit=self.unit if unit is None else unit
        )

    def each(self, entries: Iterable[str], units: Iterable[str] | None = None) -> Any:
        """Return a statistic for each entry, each in its own unit if given."""
        if units is None:
            return tuple(self(entry) for entry in entries)
        pairs = zip(entries, units, strict=True)
        return tuple(self(entry, unit=unit) for entry, unit in pairs)


# a size is 0 or more and better small; a share is 1 at most, too; a ratio is of what is
# measured over what theory says; an offset is better near zero
_size = partial(Family, least=0.0)
_share = partial(_size, most=1.0)
_ratio = partial(_size, better="prediction")
_offset = partial(Family, better="zero")

# An equivalence margin of 2 % of a covariance is 1 % of a standard deviation; that of a
# bias is 2 % of one sample's own spread, which adds 0.02 % to its RMS.
BIAS = _offset("bias", "bias", margin=0.02, scale="sample")
SD = _size("sd", "standard deviation")
COVARIANCE = Family("covariance", "covariance", margin=0.02, scale="variances")
BIAS_ALONG = _offset(
    "bias_along", "bias along the predicted one", margin=0.02, scale="sample"
)
COVARIANCE_ALONG = Family(
    "covariance_along", "covariance along the predicted one", margin=0.02
)
SPREAD = _size("spread", "RMS of the standard deviations")
RMS = _size("rms", "RMS error")
RMS_OVER_NOISE = _size("rms_over_noise", "RMS error over the noise")
RMS_DIFFERENCE = Family(
    "rms_difference", "RMS less least squares'", unit="rad", margin=0.02, scale="sample"
)
EFFICIENCY = _size("efficiency", "efficiency", better="more")
NEES = _ratio("nees", "normalised squared error", margin=0.02)
POOLED_NEES = _ratio("nees, pooled", "normalised squared error, pooled", margin=0.02)
COVERAGE = _share("coverage", "coverage of the stated intervals", better="prediction")
MISJUDGED = _share("misjudged", "share of signals that are misjudged")
CHANCE_OF_ERRORS = _size(
    "chance_of_errors", "surprise of the errors, by their stated error bars"
)
COVERAGE_NORMAL = _share(
    "coverage_normal", "coverage of 1.96 standard deviations", better="prediction"
)

VARIANCE_OVER_BOUND = _size(
    "variance_over_bound", "variance over the Cramer-Rao bound", margin=0.02
)
CHI_SQUARE_OF_FREEDOM = _ratio(
    "chi_square_of_freedom", "chi-square of the residuals by degree of freedom"
)

RECOVERY = _size("recovery", "error of a noise-free recovery")
NOISE_SQUARE = _ratio(
    "noise_square", "mean square of the noise drawn over the stated one", margin=0.02
)
STRONGEST_CORRELATION = _share(
    "strongest_correlation", "strongest correlation of two streams of noise"
)
COVARIANCE_OFF = _size(
    "covariance_off", "greatest error of a covariance, in deviations"
)
BIAS_OFF = _size("bias_off", "greatest error of a bias, in deviations")
MEAN_RATIO = Family(  # of squares that are estimated without asking for their sign
    "mean_ratio", "mean estimate over the truth", margin=0.02, better="prediction"
)
STATED_VARIANCE = _ratio(
    "stated_variance", "stated variance over the predicted one", margin=0.02
)
UNBIASED_VARIANCE = _ratio(
    "unbiased_variance", "mean variance of all samples over the true one"
)
KNOWN_RESTS = Family("known_rests", "rests found of known ones", better="prediction")
EDGE_OFF = _size(
    "edge_off", "distance of a rest's edges from the known ones", unit="samples"
)
COUNT_OFF = _size(
    "count_off", "samples of a rest less the known number", unit="samples"
)
MEAN_OFF = _size("mean_off", "mean of a rest less the known one")
NOISE_OF_MEAN = _size("noise_of_mean", "noise of a pose mean", unit="m/s²")
SCALE_BIAS = _offset("scale_bias", "mean relative bias of the scales", unit="σ²/g²")
STEPS = _size("steps", "steps of the solver", one_draw=True)
APART = _size("apart", "distance from the first solver's answer", one_draw=True)
STEP_LEAVES = _size(
    "step_leaves", "share of the distance that a step leaves", one_draw=True
)
STEP_OFF = _size(
    "step_off", "share that a step leaves, less the predicted 1 - α", one_draw=True
)
BUDGET = _size("budget", "contribution to the attitude error", unit="rad")

NORM = _size("norm", "|q̄|", better=None)
NORM_OVER_NOISE = _size("norm_over_noise", "|q̄| / σ", better=None)
BIAS_ORDER = Family(
    "bias_order", "order of what a formula of the bias leaves out", better="more"
)
COVARIANCE_ORDER = Family(
    "covariance_order",
    "order of what a formula of the covariance leaves out",
    better="more",
)
TURN_ORDER = Family(
    "turn_order", "order in the step of what a filter's turns leave out", better="more"
)
BIAS_ERROR = _size("bias_error", "what a formula of the bias leaves out", along=True)
COVARIANCE_ERROR = _size(
    "covariance_error", "what a formula of the covariance leaves out", along=True
)
LIMIT_RATIO = _size("limit_ratio", "least |q̄| / σ at which a formula holds")
FLIP_RATE = _share("flip_rate", "share of flipped signs")
OTHER_SELECTION_RATE = _share(
    "other_selection_rate", "share of other frames selected", better=None
)
STEP = _size("step", "step of the answer across a border", unit="rad", better=None)
LENGTH_OFF = Family(
    "length_off",
    "mean of the true over the estimated |q̄|, less 1",
    margin=0.02,
    scale="sample",
    better="prediction",
)
RMS_RATIO = _size("rms_ratio", "predicted RMS error over the q-method's")
SIMULATED_RMS_RATIO = _size(
    "simulated_rms_ratio", "simulated RMS error over the q-method's"
)
SQUARED_ERROR = _ratio(
    "squared_error_over_predicted", "mean square error over the predicted one"
)
RMS_OVER_BOUND = _size("rms_over_bound", "RMS error over the Cramer-Rao bound")
ALLAN_ERROR = _ratio(
    "allan_square_error_over_predicted",
    "mean square error of an Allan variance over the predicted one",
    margin=0.02,
    along=True,
)
NIS = _ratio("nis", "normalised squared innovation", margin=0.02)
WORST_INSTANT = _size(
    "worst_instant", "greatest excess of an instant, in standard deviations"
)
INNOVATION_PAIRS = _ratio(
    "innovation_pairs",
    "variance of two neighbouring innovations' sum over white ones'",
    margin=0.02,
)
SYSTEMATIC = _share("systematic", "share of the squared error that all trials have")
RMS_BELOW_BOUND = _share(
    "rms_below_bound", "share by which the RMS error is below the bound"
)
CONSTANT = _offset("constant", "error that all trials have")
PART_OVER_STATED = _ratio(
    "part_over_stated", "squared error of a part over its stated variance"
)
STATED_OVER_BOUND = _ratio(
    "stated_over_bound", "stated standard deviation of a part over the Cramer-Rao bound"
)
PART_OF_INNOVATION = _ratio(
    "part_of_innovation", "squared innovation of a reading over its stated variance"
)
DIAGNOSES = (CONSTANT, PART_OVER_STATED, STATED_OVER_BOUND, PART_OF_INNOVATION)
"""Families that say why a filter fails, and not that it does."""
DIVERGED = _share("diverged", "share of trials that diverge")
SETTLING_TRIALS = _share(
    "settling_trials", "share of trials that settle", better="more"
)
SETTLING = _size("settling", "time to settle", unit="s")
NOISE_FACTOR = _size("noise_factor", "factor on the noise setting", better=None)
RMS_AT = _size("rms_at", "RMS error at an instant", unit="rad", along=True)
RMS_OVER_BOUND_AT = _size(
    "rms_over_bound_at", "RMS error over the bound at an instant", along=True
)
BOUND_AT = _size("bound_at", "bound at an instant", unit="rad", better=None, along=True)
BUDGET_AT = _size(
    "budget_at", "part of the predicted error at an instant", unit="rad", along=True
)
NEES_AT = _ratio("nees_at", "normalised squared error at an instant", along=True)
AT_AN_INSTANT = (RMS_AT, RMS_OVER_BOUND_AT, BOUND_AT, NEES_AT, BUDGET_AT)
"""Families along time, for a figure and not for a table of a few lines."""
INCONSISTENT_RATE = _share(
    "inconsistent_rate", "share of samples called inconsistent", better="prediction"
)

LEADING_ERROR_RATIO = _size(
    "leading_error_ratio",
    "leading error of a formula of the covariance over the linear one's",
)
LEADING_TERM_OFF = _size("leading_term_off", "relative error of the leading term")
NEARER = _share(
    "nearer", "share of geometries nearer than the linear one", better="more"
)
NEARER_AT = _share(
    "nearer_at",
    "share of geometries nearer to the exact covariance than the second order",
    better="more",
    along=True,
)
NEXT_ORDER = _size(
    "next_order",
    "next order over the second, where a formula reaches a limit",
    better=None,
)
LEFT_OUT = _size("left_out", "relative distance of a formula from the exact theory")
OPERATIONS = _size("operations", "operations of one attitude")
LENGTH_TURN = _size(
    "length_turn", "turn by a body vector that is 2 % too long", unit="rad"
)
ROUNDING_AT = _size(
    "rounding_at", "greatest error without noise at a sine", unit="rad", along=True
)
UNIT_LENGTH = _size(
    "unit_length", "relative defect of tr C + |m|² = 2 q'm, unit quaternions"
)

LEFT = _size("left", "specific-force error that the calibration leaves", unit="m/s²")

SETTLED = _size("settled", "distance of the noise-free answer from those of its class")

PROBE = _offset("probe", "error of the noise-free probe")
FAILURES = _share("failures", "share of exact cases that fail")
CUBATURE_BIAS = _offset("cubature_bias", "bias by cubature", unit="rad")
CUBATURE_BIAS_SMALL = _offset(
    "cubature_bias_at_small_noise", "bias by cubature at small noise", unit="rad"
)
FIRST_ORDER_BIAS = _offset(
    "first_order_bias", "bias of first order over one standard deviation"
)
BELOW_BOUND = Family(
    "below_bound", "share by which a leading variance is below the bound", better=None
)
OVER_EQUAL_WEIGHTS = _size(
    "variance_over_equal_weights", "leading variance over that with equal weights"
)
GREATEST_ERROR = _size(
    "greatest_error", "greatest error of a trial, in deviations of most"
)
CLASS_BIAS = _offset("class_bias", "error of the leading bias")
CLASS_COVARIANCE = _offset("class_covariance", "error of the leading covariance")
CLAIM_OFF = _offset("claim_off", "error of a covariance that is claimed exact")
CLAIM_OFF_FULL = _offset(
    "claim_off_at_the_noise", "error of a claimed covariance at the noise"
)
CLAIM_OFF_HALF = _offset(
    "claim_off_at_half_noise", "error of a claimed covariance at half the noise"
)

PRECISION = _share("precision", "share of the rows found that are still", better="more")
RECALL = _share("recall", "share of the rests' rows that are found", better="more")
RESTS_FOUND = _share("rests_found", "share of the rests that are found", better="more")
INTERVALS = _size("intervals", "intervals found", better=None)
IMPURE = _size("impure", "intervals with a moving row")
OUTSIDE = _size("outside", "intervals outside every rest")
FITTED = _share("fitted", "share of trials with a fit", better="more")

ACCUSED = _share("accused", "share of sound logs called faulty")
ASKED = _share("asked", "share of sound logs that misfit")
ODDS_ABOVE = _share("odds_above", "share of scattered logs with odds above this")
MEAN_CHANCE = _share(
    "mean_chance", "mean chance of the residuals of sound logs", better="prediction"
)
MISSED = _share("missed", "share of faults missed")
MISNAMED = _share("misnamed", "share of faults misnamed")
MISSED_AT = _share("missed_at", "missed", along=True)
NAMED_AT = _share("named_at", "named", better="more", along=True)
PARTLY_NAMED_AT = _share("partly_named_at", "partly named", better=None, along=True)
UNNAMED_AT = _share("unnamed_at", "unnamed", along=True)
MISNAMED_AT = _share("misnamed_at", "misnamed", along=True)
CALLED_WRONG = _share("called_wrong", "share of right simulators called wrong")
NOT_JUDGED = _share("not_judged", "share of them not judged whole", better=None)
LEAST_SIZE = _size("least_size", "size of an error that can be told", better=None)
SAID = _share("said", "share of logs of which this is said", better=None)

REST_FORCE = _size("rest_force", "worst residual force at rest", unit="m/s²")
REST_RATE = _size("rest_rate", "worst rate at rest", unit="rad/s")
RANK = _size("rank", "rank of the poses", better="more")
CONDITION = _size("condition", "condition of the poses")
RESTS = _size("rests", "rests", better=None)
FIELD_MISMATCH = _size("field_mismatch", "field against the attitude of its row")
RATE_LAG = _offset("rate_lag", "lag of the rate", unit="steps")
RATE_SCALE = Family("rate_scale", "rate over the attitude's own", better="prediction")

FAMILIES: Mapping[str, Family] = MappingProxyType(
    {value.name: value for value in tuple(globals().values()) if type(value) is Family}
)
"""Every family by its name."""


def family(name: Any) -> Family:
    """Find a family by its name; a family is returned as it is."""
    if isinstance(name, Family):
        return name
    if name not in FAMILIES:
        msg = (
            f"this version of simval has no statistic {str(name)[:60]!r}; use "
            "the version that wrote it"
        )
        raise InputError(msg)
    return FAMILIES[name]


AXES = ("x", "y", "z")
PARAMETERS = {
    f"{kind}_{which}": kind
    for kind in ("S", "T", "K", "B", "M")
    for which in (*AXES, *(row + column for row in AXES for column in AXES))
}
"""Each entry of a matrix or vector of parameters, and which one it belongs to."""
PRINTED = {"S_yx": "T[1][0]", "S_zx": "-T[2][0]", "S_zy": "T[2][1]"}
"""Entries of a matrix that are printed by their place in it."""

QUANTILES = ("least", "5%", "median", "95%", "most", "worst", "1%", "10%")
RATES = ("50 Hz", "100 Hz", "250 Hz", "500 Hz")
ONE_OF_MANY = frozenset((*AXES, "s", *QUANTILES, *RATES))
"""Entries that say which one and not of what: axes, quantiles, shares, rates."""


@dataclass(frozen=True, slots=True)
class Statistic:
    """A statistic of a row: its family, its entries, and how it was sampled."""

    # the kind
    family: Annotated[
        Family, BeforeValidator(family), PlainSerializer(lambda value: value.name)
    ]
    # which member: a parameter, two axes, a noise level; none where there is one
    entries: tuple[str, ...] = ()
    controlled: bool = False  # whether it was sampled with control variates
    # unit of the value; two statistics that differ in it alone are equal
    unit: str = field(default="1", compare=False)

    def __post_init__(self) -> None:
        if not all(text.isprintable() for text in (*self.entries, self.unit)):
            msg = f"entries {self.entries} in {self.unit!r} cannot be printed"
            raise ValueError(msg)

    def __hash__(self) -> int:
        return hash((self.family.name, self.entries, self.controlled))

    def __str__(self) -> str:
        inside = f"[{','.join(self.entries)}]" if self.entries else ""
        return f"{'control ' if self.controlled else ''}{self.family.name}{inside}"

    @property
    def printed(self) -> tuple[str, ...]:
        """Entries as people read them."""
        return tuple(PRINTED.get(entry, entry) for entry in self.entries)

    @property
    def words(self) -> str:
        """Name for people: the family, and the entries in brackets."""
        inside = f" ({', '.join(self.printed)})" if self.entries else ""
        return f"{self.family.words}{inside}"

    @property
    def kinds(self) -> tuple[str, ...]:
        """Entries reduced to their kind: ``K`` for the scale ``K_x``."""
        named = self.entries[:-1] if self.family.along else self.entries
        return tuple(PARAMETERS.get(e, e) for e in named if e not in ONE_OF_MANY)

    @property
    def better(self) -> Better | None:
        """Which direction is an improvement; neither for a covariance of two axes."""
        two_axes = self.family.scale == "variances" and len(set(self.entries)) > 1
        return None if two_axes else self.family.better

    @property
    def control(self) -> "Statistic":
        """The same statistic, sampled with control variates."""
        return replace(self, controlled=True)


# predictors: the theory that a value is compared with
EXACT = "exact"
ORDER_2 = "order 2"
FIRST_POWER = "order 2, of its own power"
ORDER_4_SOURCE = "order 4, source"
ORDER_4 = "order 4, complete"
ORDER_2_PRINTED = "eq. (63), as printed"
FIRST_ORDER = "first order"
SECOND_ORDER = "second order"
CARRIED = "first order, carried through"
CRAMER_RAO = "Cramer-Rao"
MANY_POSES = "many poses"
TRUTH = "truth"
CUBATURE = "cubature"
CUBATURE_ERROR = "cubature's own error"
NO_BIAS = "no bias"
CLAIM = "claim"
STUDENT = "Student t"
NORMAL = "normal"
CHI_SQUARE = "chi-square"
CHI_SQUARE_3 = "chi-square, 3"
CHI_SQUARE_9 = "chi-square, 9"
F_LAW = "F"
SCENE_BOUND = "scene's bound"
OBSERVABILITY = "observability"
ROUNDING = "rounding"
SAME_ROW = "same row"
ATTITUDE = "attitude"
FIRST_SOLVER = "lm"
PSEUDO_TRUE = "what its class converges to"
NOISE_FREE = "its noise-free answer"
BEST_OF_CLASS = "best of its class"
LEAST_SQUARES = "generalised least squares"
EQUAL_WEIGHTS = "equal weights"
CLOSED_FORM = "closed form"
WHITE = "white"
INDEPENDENT = "independence"
BINOMIAL = "binomial"
RESPONSE = "its own response"
ENUMERATED = "all samples"
INTEGRATOR = "what its steps leave out"
KNOWN_SCENE = "known scene"
MARKOV = "Markov's bound"
COUNTED = "as counted once"
NINE_PARAMETERS = "Cramer-Rao, nine parameters"


def class_of(kind: str) -> str:
    """Name of the theory for estimators of a declared class."""
    return f"class: {kind}"


def claim_of(order: int | str) -> str:
    """Name of the prediction that an algorithm's own covariance makes."""
    return f"claim: {order}"


def order(number: int) -> str:
    """Name of the theory that an error falls with this order in the noise."""
    return f"order {number}"
