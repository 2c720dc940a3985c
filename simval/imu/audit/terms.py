"""What may be wrong with a simulated sensor: a table of terms and their words."""

from typing import Final, NamedTuple

import numpy as np

from simval.units import G0

Saying = tuple[float, float, str, str]
"""Limits of the value, what is said of it between them, and what would make that."""
INF: Final = np.inf
NEAR: Final = 0.02  # of a value that has a name
_TURN: Final = "turn about two axes, fast and unevenly"
_MOVE: Final = "accelerate to and fro while it turns"
_MIXES: Final = (
    "mixes two instants: acceleration is {one} steps late against attitude and rate"
)
_STAGES: Final = "rate and attitude are of different stages of a step"
_ADDED: Final = "a term of turning axes is added to an acceleration that has it"
_MEANS: Final = "at rest it is g upwards"
_UNITS: Final = {
    180.0 / np.pi: "in deg/s", 1.0 / G0: "in g", 1e3 / G0: "in mg", 1e3: "in 1/1000",
    np.pi / 180.0: "turned into radians twice", G0: "multiplied by g twice",
}  # fmt: skip


class Flaw(NamedTuple):
    """A possible error, or a quantity that is fitted because it is not declared.

    Attributes
    ----------
    name, title, unit : str
        What it is called, and by people.
    question : str
        Of `QUESTIONS`, which it belongs to.
    needs : str
        Motion that tells it; empty where a pass does not ask for it.
    right : float
        Value of a right reading, to which its parameter is added.
    vector : bool
        Whether its value is how many times the vector that is right; NaN where another
        one is added to that.
    whole : float
        Size of one that is wholly wrong; 0 for that of the lever arm.
    held : float
        Steps within which a time is no finding: a force held over a step has no finer
        instant, and a rate may be the mean over the step before, as a gyroscope's.
    says : tuple of Saying
        The first whose limits hold the value; the last is of all that are left.
    sd : float
        Prior of a parameter that is fitted; infinite for what may be wrong.
    """

    name: str
    title: str = ""
    unit: str = ""
    question: str = ""
    needs: str = ""
    right: float = 0.0
    whole: float = 1.0
    held: float = 0.0
    says: tuple[Saying, ...] = ()
    vector: bool = False
    sd: float = INF

    @property
    def wrong(self) -> bool:
        """True for an error, false for a quantity that is only fitted."""
        return self.sd == INF


def _arm(name: str, title: str, of: str, missing: str) -> Flaw:
    return Flaw(
        name, title, "m", "lever", _TURN, whole=0.0, vector=True, says=(
            (-NEAR, NEAR, f"lacks the {of}lever arm {{right}} m", missing),
            (-INF, INF, f"has the {of}lever arm {{place}} m, and {{right}} is {{by}}",
             "another place, or a sign"),
        ),
    )  # fmt: skip


TERMS: Final = (
    Flaw("bias"),
    _arm("lever", "lever arm", "", "it is of the body's origin"),
    Flaw("g", sd=2.2e-3),  # over the Earth
    Flaw("scale", "scale", "", "scale", "turn and accelerate", right=1.0, says=(
        (-1e-6, 1e-6, "reads zero", "the sensor is not computed"),
        *((x - NEAR * x, x + NEAR * x, f"is {unit} (factor {{x:.4g}})", "the unit")
          for x, unit in _UNITS.items()),
        (-INF, 0.0, "has the opposite sign (scale {x:.4g})", _MEANS),
        (0.0, INF, "has the scale {one}", "a unit, or a gain"),
    )),
    Flaw("mount", sd=1.0),
    Flaw("axes", "axes", "rad", "axes", "turn about all three axes", whole=0.5, says=(
        (-INF, INF, "has axes that are off by up to {angle:.3g} deg",
         "a mount, or shear"),
    )),
    Flaw("linear", "linear term", "", "linear", _MOVE, right=1.0, says=(
        (-NEAR, NEAR, "lacks the linear acceleration", "gravity alone is turned"),
        *((k - NEAR, k + NEAR, "has {x:.4g} times the linear acceleration",
           "a difference over several steps divided by the time of one")
          for k in range(2, 100)),
        (-INF, INF, "has {x:.4g} times the linear acceleration",
         "a difference divided by another time"),
    )),
    Flaw("gravity", "gravity", "", "gravity", "turn to attitudes far from each other",
         vector=True, says=(
        (-NEAR, NEAR, "lacks gravity", "it is an acceleration, no specific force"),
        (-INF, 0.0, "has gravity of the wrong sign (factor {x:.4g})", _MEANS),
        (0.0, INF, "has {x:.4g} times gravity", "another g, or a unit"),
        (-INF, INF, "has gravity along {down} of the world", "another world's axes"),
    )),
    _arm("Euler", "Euler term", "Euler term of the ", "left out"),
    _arm("centripetal", "centripetal term", "centripetal term of the ", "left out"),
    Flaw("transport", "transport term", "", "lever", _MOVE, says=(
        (-INF, 0.0, "has {x:+.3g} times the term w x v",
         "the velocity in body axes was differentiated"),
        (0.0, INF, "has {x:+.3g} times the term w x v", _ADDED),
    )),
    Flaw("delay", "delay", "steps", "delay", "turn and accelerate unevenly", held=0.1,
         says=(
        (0.9, 1.1, "is {one} steps late",
         "the reading is of before a step, the pose of after it"),
        (0.0, INF, "is {one} steps late", "a buffer, or stamps of another clock"),
        (-INF, 0.0, "is {size} steps early", "a buffer, or stamps of another clock"),
    )),
    Flaw("instants", "one instant", "steps", "instants", _MOVE, held=0.1, says=(
        (0.8, 1.2, _MIXES, "acceleration is of the step before, attitude of this one"),
        (-INF, INF, _MIXES, _STAGES),
    )),
    Flaw("difference", "no difference", "steps", "instants", held=0.1, says=(
        (-INF, INF, "has acceleration {one} steps late against the attitude, as a "
         "backward difference of velocity over {steps:.2g} steps",
         "a difference of the past beside the attitude of now"),
    )),
    Flaw("rate", "rate of that instant", "steps", "instants", whole=2.0, held=0.6,
         says=((-INF, INF, "has a centripetal term {one} steps late", _STAGES),)),
    Flaw("constant", "no constant", "", "constant", says=(
        (-INF, INF, "has a constant of {place}", "it is added in sensor axes"),
    )),
)  # fmt: skip
"""In the order in which they are stated."""
FRAMES: Final = {
    "world": ("is in world axes", "it is not turned into the sensor's axes"),
    "body": ("is in body axes", "the mount is not applied"),
    "inverse": ("is turned by the inverse of the mount", "the mount is transposed"),
    "reversed": ("has left-handed axes", "one axis, or all, have the wrong sign"),
    "exchanged": ("has exchanged or reversed axes", "axes of another convention"),
}
"""Axes of readings that are not the sensor's."""
