"""Estimators and calibrators that another process runs, measured as any other here.

What such a plug-in declares is what its process says, and is checked as where it is
declared; its functions are the process's answers, whose shapes must be those that were
asked for, and which are then judged like those of a function that we hold.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.plugins.messages import Message
from simval.plugins.noise import VectorNoise
from simval.plugins.protocol import Calibrator, Estimator
from simval.plugins.rotations import tail
from simval.plugins.session import Session
from simval.shapes import Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RemoteEstimator(Estimator):
    """An estimator that another process runs."""

    session: Session

    def attitudes(
        self, vectors: list[Float[Array, "n 3"]], noise: VectorNoise | None
    ) -> Float[Array, "n ..."]:
        """Answers in its own convention; rows need not be attitudes."""
        shape = (len(vectors[0]), *tail(self.components))
        return self._asked("attitudes", vectors, noise, shape)

    def covariances(
        self, vectors: list[Float[Array, "n 3"]], noise: VectorNoise
    ) -> Float[Array, "n 3 3"]:
        """Its covariances, not checked yet."""
        return self._asked("covariances", vectors, noise, (len(vectors[0]), 3, 3))

    def _asked(
        self,
        question: str,
        vectors: list[Float[Array, "n 3"]],
        noise: VectorNoise | None,
        shape: tuple[int, ...],
    ) -> Array:
        # arrays that are one to the caller are one to the estimator
        places = {id(v): str(i) for i, v in enumerate(vectors)}
        arrays = {places[id(v)]: v for v in vectors}
        words: dict[str, Any] = {
            "vectors": [places[id(v)] for v in vectors],
            "declared": {"components": self.components, "batch": self.batch},
        }
        if noise is not None:
            words["noise"] = {"tangent": noise.tangent, "noise_std": noise.noise_std}
            arrays["unit"] = noise.unit
        answer = self.session.ask(question, words, arrays)
        return taken(self.session, answer, **{question: shape})[question]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RemoteCalibrator(Calibrator):
    """A calibrator that another process runs."""

    session: Session

    def calibrations(
        self,
        sets: Float[Array, "t n 3"],
        g: float,
        noise_std: float,
        seconds: float | None = None,
    ) -> list[dict[str, Any]]:
        """Its answers, not checked yet; without a time one set, which is no trial."""
        words = {"g": g, "noise_std": noise_std, "seconds": seconds}
        answer = self.session.ask("calibrations", words, {"sets": sets}, ("of",))
        forms = _forms(self.session, answer, len(sets))
        count = sum(has for has, _ in forms)
        own = answer.arrays.get("covariance", np.empty((0, 0, 0)))
        shapes = {"matrix": (len(sets), 3, 3), "bias": (len(sets), 3)}
        if count:
            shapes["covariance"] = (count, *own.shape[1:])
        found = taken(self.session, answer, **shapes)
        covariances = iter(found.get("covariance", ()))
        answers = []
        for matrix, bias, (has, dof) in zip(
            found["matrix"], found["bias"], forms, strict=True
        ):
            one: dict[str, Any] = {"matrix": matrix, "B": bias}
            if has:
                one["covariance"] = next(covariances)
            if dof:
                one |= {"covariance_kind": "type A", "dof": dof}
            answers.append(one)
        return answers


def taken(
    session: Session, answer: Message, **shapes: tuple[int, ...]
) -> Mapping[str, Array]:
    """Arrays of an answer, which must have these names and shapes."""
    found = {name: a.shape for name, a in answer.arrays.items()}
    if found != shapes:
        msg = f"arrays {found or 'of nothing'} instead of {shapes}"
        raise session.unreadable(msg)
    return answer.arrays


def _forms(session: Session, answer: Message, count: int) -> list[tuple[int, int]]:
    """For each calibration whether it has a covariance, and its degrees of freedom."""
    of = answer.words.get("of")
    each_of = of if isinstance(of, list) else []
    whole = all(
        isinstance(each, list) and len(each) == 2 and {type(k) for k in each} == {int}
        for each in each_of
    )
    if not whole or len(each_of) != count or any(e[0] not in (0, 1) for e in each_of):
        msg = "it does not say what its answers are"
        raise session.unreadable(msg)
    return [(has, dof) for has, dof in each_of]
