"""Plug-ins that another process runs: each is measured as any other, from here.

What such a plug-in declares is what its process says, and is checked as where it is
declared; its functions are the process's answers, whose shapes must be those that were
asked for, and which are then judged like those of a function that we hold.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.plugins.filter_protocol import Filter
from simval.plugins.filter_signals import FilterInput, FilterOutput, Told
from simval.plugins.messages import MOST_NUMBERS, Message
from simval.plugins.noise import VectorNoise
from simval.plugins.protocol import Calibrator, Estimator, Plugin
from simval.plugins.reference_frames import WORLDS
from simval.plugins.rotations import tail
from simval.plugins.session import Session
from simval.shapes import Float

Kind = TypeVar("Kind", bound=Plugin)

PER_ROW = 512
"""Numbers that a filter may answer at a row, by which its answer is bounded."""


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
        answer = self.session.ask("calibrations", words, {"sets": sets})
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RemoteFilter(Filter):
    """A filter that another process runs."""

    session: Session

    def found_world(
        self, told: Told, rate: float
    ) -> tuple[str, tuple[str, ...], float]:
        """Its world, others in which it stays, and how far it strays, rad."""
        words, field = _told(told)
        answer = self.session.ask("world", {"told": words, "rate": rate}, field).words
        world, alike = answer.get("world"), answer.get("alike")
        known = (self.world,) if self.world else WORLDS
        stray = answer.get("stray")
        if (
            world not in known
            or not isinstance(alike, list)
            or not all(each in WORLDS for each in alike)
            or not isinstance(stray, float)
        ):
            msg = "it names no world"
            raise self.session.unreadable(msg)
        return str(world), tuple(alike), stray

    def output(
        self, given: FilterInput, keep: NDArray[np.intp], world: str
    ) -> FilterOutput:
        """Its answers to the readings of some trials, at the rows that are kept."""
        told, arrays = _told(given.told)
        arrays |= {
            each.name: getattr(given, each.name)
            for each in fields(FilterInput)
            if each.name != "told"
        }
        n, k = len(given.start), len(keep)
        answer = self.session.ask(
            "filtered",
            {"told": told, "world": world},
            {**arrays, "keep": keep.astype(float)},
            most=max(MOST_NUMBERS, 8 * n * k * PER_ROW),
        )
        sizes = {name: a.shape[2:] for name, a in answer.arrays.items()}
        shapes = {
            name: (n, k, *sizes[name])
            for name, axes in (
                ("covariance", 2),
                ("innovation", 1),
                ("innovation_covariance", 2),
            )
            if len(sizes.get(name, ())) == axes
        }
        if "bias" in answer.arrays:
            shapes["bias"] = (n, k, 3)
        seconds = answer.arrays.get("seconds", np.empty(0)).shape[:1]
        found = taken(
            self.session, answer, **shapes, attitude=(n, k, 4), seconds=seconds
        )
        if not all(np.isfinite(a).all() for a in found.values()):
            msg = "entries that are not finite"
            raise self.session.unreadable(msg)
        parts = {each.name: found.get(each.name) for each in fields(FilterOutput)}
        whole: dict[str, Any] = parts | {"kept": keep}
        return FilterOutput(**whole)


REMOTE: dict[type[Plugin], Any] = {
    Estimator: RemoteEstimator,
    Calibrator: RemoteCalibrator,
    Filter: RemoteFilter,
}


def remote(session: Session, word: str, kind: type[Kind]) -> Kind:
    """Find a plug-in in another process, by its word.

    Raises
    ------
    PluginError
        If it cannot be used.
    """
    answer = session.ask("find", {"word": word, "kind": kind.taken_by})
    known = {each.name for each in fields(kind)}  # type: ignore[arg-type]
    declared, gives = answer.words.get("declared"), answer.words.get("gives")
    if not isinstance(declared, dict) or not isinstance(gives, list):
        msg = "it declares nothing"
        raise session.unreadable(msg)
    values = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in declared.items()
    }
    values |= {str(name): _elsewhere for name in gives}
    if not values.keys() <= known:
        msg = "it declares what there is not"
        raise session.unreadable(msg)
    try:
        found: Kind = REMOTE[kind](**values, session=session)
    except TypeError as error:
        raise session.unreadable(error) from None
    return found


def taken(
    session: Session, answer: Message, **shapes: tuple[int, ...]
) -> Mapping[str, Array]:
    """Arrays of an answer, which must have these names and shapes."""
    found = {name: a.shape for name, a in answer.arrays.items()}
    if found != shapes:
        msg = f"arrays {found or 'of nothing'} instead of {shapes}"
        raise session.unreadable(msg)
    return answer.arrays


def _elsewhere(*_: Any, **__: Any) -> Any:
    msg = "this function is in another process"
    raise AssertionError(msg)


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


def _told(told: Told) -> tuple[dict[str, float], dict[str, Array]]:
    words = {
        each.name: float(getattr(told, each.name))
        for each in fields(Told)
        if each.name != "field"
    }
    return words, {"field": told.field}
