"""What a finding is called, what would make it, and which motion would tell."""

from typing import Final

import numpy as np

from simval.arrays import Array
from simval.imu.audit.fewest import Item, SensorAudit
from simval.spelling import measured
from simval.text import number
from simval.units import G0

TITLES: Final = {
    "lever": "lever arm", "scale": "scale", "axes": "axes", "linear": "linear term",
    "gravity": "gravity", "Euler": "Euler term", "centripetal": "centripetal term",
    "transport": "transport term", "delay": "delay", "instants": "one instant",
    "difference": "no difference", "rate": "rate of that instant",
    "constant": "no constant",
}  # fmt: skip
UNITS: Final = {
    "lever": "m", "Euler": "m", "centripetal": "m", "delay": "steps",
    "instants": "steps", "difference": "steps", "rate": "steps", "axes": "rad",
}  # fmt: skip
ASKED: Final = {
    "gyroscope": ("scale", "axes", "delay"),
    "accelerometer": ("scale", "axes", "linear", "gravity", "lever", "Euler",
                      "centripetal", "transport", "delay", "instants"),
}  # fmt: skip
"""What a pass needs the motion to tell."""
_TURN = "turn about two axes, fast and unevenly"
_MOVE = "accelerate to and fro while it turns"
TOLD_BY: Final = {
    "lever": _TURN, "Euler": _TURN, "centripetal": _TURN, "rate": _TURN,
    "linear": _MOVE, "instants": _MOVE, "difference": _MOVE, "transport": _MOVE,
    "gravity": "turn to attitudes far from each other",
    "scale": "turn and accelerate", "axes": "turn about all three axes",
    "delay": "turn and accelerate unevenly",
}  # fmt: skip
"""Motion that would tell a term."""
_FACTORS: Final = {
    180.0 / np.pi: "in deg/s", 1.0 / G0: "in g", 1e3 / G0: "in mg", 1e3: "in 1/1000",
    np.pi / 180.0: "turned into radians twice", G0: "multiplied by g twice",
}  # fmt: skip
_NEAR: Final = 0.1  # of a step, or of a number of steps
_SHARE: Final = 0.02


def vector(v: Array) -> str:
    """Three numbers."""
    return f"({', '.join(number(float(x), 3) for x in np.round(v, 6) + 0.0)})"


def rows_of(instant: float) -> str:
    """What a row is."""
    if not instant:
        return "of its instant"
    return f"the mean over the step {'before' if instant > 0.0 else 'after'} it"


def frame_words(found: SensorAudit) -> tuple[str, str]:
    """Which axes the readings have, and what makes that."""
    frame = found.frame
    if frame == "world":
        return "is in world axes", "it is not turned into the sensor's axes"
    if frame == "body":
        return "is in body axes", "the mount is not applied"
    if frame == "inverse":
        return "is turned by the inverse of the mount", "the mount is transposed"
    if frame == "reversed":
        return "has left-handed axes", "one axis, or all, have the wrong sign"
    return "has exchanged or reversed axes", "axes of another convention"


def sentence(item: Item, found: SensorAudit, lever: Array) -> tuple[str, str]:
    """What is wrong, and what would make that."""
    v, sd = item.value, item.sd
    one = measured(float(v[0]), float(sd[0]))
    if item.name == "scale":
        return _scale(float(v[0]), float(sd[0]))
    if item.name in ("lever", "Euler", "centripetal"):
        return _arm(item, lever)
    if item.name in ("linear", "transport"):
        return _motion(item)
    if item.name == "delay":
        return _delay(found.delay - found.instant, float(sd[0]))
    off, steps = np.degrees(np.abs(v).max()), 2.0 * float(v[0])
    stages = "rate and attitude are of different stages of a step"
    if item.name == "instants" and abs(v[0] - 1.0) < 2.0 * _NEAR:
        stages = "acceleration is of the step before, attitude of this one"
    return {
        "axes": (f"has axes that are off by up to {off:.3g} deg", "a mount, or shear"),
        "constant": (f"has a constant of {vector(v)}", "it is added in sensor axes"),
        "instants": (
            f"mixes two instants: acceleration is {one} steps late against attitude "
            "and rate", stages,
        ),
        "difference": (
            f"has acceleration {one} steps late against the attitude, as a backward "
            f"difference of velocity over {steps:.2g} steps",
            "a difference of the past beside the attitude of now",
        ),
        "rate": (f"has a centripetal term {one} steps late", stages),
    }[item.name]  # fmt: skip


def _delay(late: float, sd: float) -> tuple[str, str]:
    side = "late" if late > 0.0 else "early"
    words = f"is {measured(abs(late), sd)} steps {side}"
    if abs(late - 1.0) < _NEAR:
        return words, "the reading is of before a step, the pose of after it"
    return words, "a buffer, or stamps of another clock"


def _scale(off: float, sd: float) -> tuple[str, str]:
    factor = 1.0 + off
    if abs(factor) < 1e-6:
        return "reads zero", "the sensor is not computed"
    for known, words in _FACTORS.items():
        if abs(factor / known - 1.0) < _SHARE:
            return f"is {words} (factor {factor:.4g})", "the unit"
    if factor < 0.0:
        return f"has the opposite sign (scale {factor:.4g})", "at rest it is g upwards"
    return f"has the scale {measured(factor, sd)}", "a unit, or a gain"


def _arm(item: Item, lever: Array) -> tuple[str, str]:
    place, size = lever + item.value, float(np.linalg.norm(lever))
    what = "" if item.name == "lever" else f"{item.name} term of the "
    if size and np.linalg.norm(place) < _SHARE * size:
        made = "it is of the body's origin" if item.name == "lever" else "left out"
        return f"lacks the {what}lever arm {vector(lever)} m", made
    by = "declared" if item.name == "lever" else "the sensor's"
    return (
        f"has the {what}lever arm {vector(place)} m, and {vector(lever)} is {by}",
        "another place, or a sign",
    )


def _motion(item: Item) -> tuple[str, str]:
    off = float(item.value[0])
    if item.name == "transport":
        made = "the velocity in body axes was differentiated"
        if off > 0.0:
            made = "a term of turning axes is added to an acceleration that has it"
        return f"has {off:+.3g} times the term w x v", made
    factor = 1.0 + off
    if abs(factor) < _SHARE:
        return "lacks the linear acceleration", "gravity alone is turned"
    made = "a difference divided by another time"
    if abs(factor - round(factor)) < _SHARE and abs(factor) > 1.5:
        made = "a difference over several steps divided by the time of one"
    return f"has {factor:.4g} times the linear acceleration", made


def gravity_words(item: Item, up: Array, constant: Array, g: float) -> tuple[str, str]:
    """What gravity is, with a constant that stands for it."""
    share = up + item.value
    size = float(np.linalg.norm(share))
    if size < _SHARE:
        if abs(float(np.linalg.norm(constant)) / g - 1.0) < _SHARE:
            axis = "xyz"[int(np.abs(constant).argmax())]
            return (
                f"has gravity fixed to the sensor's {axis} axis",
                "gravity is added without turning it",
            )
        return "lacks gravity", "it is an acceleration, no specific force"
    cosine = float(share @ up) / size
    if cosine < -1.0 + _SHARE:
        return f"has gravity of the wrong sign (factor {-size:.4g})", (
            "at rest it is g upwards"
        )
    if cosine > 1.0 - _SHARE:
        return f"has {size:.4g} times gravity", "another g, or a unit"
    return f"has gravity along {vector(-share)} of the world", "another world's axes"
