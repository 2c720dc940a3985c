"""A calibrator in any language: a command that is given data and answers with JSON.

Its words say by placeholders where its data go (`simval.plugins.placeholders`): those
of one trial for a process of its own, or those of all trials for one process. A file of
poses has one pose to a line, the mean reading ``x,y,z``; a log is recorded at 100 Hz,
``t,x,y,z``, and rests ten seconds in each pose; a line of trials is a JSON object with
``trial``, its number, ``poses``, ``g`` and ``noise_std``. It prints for each trial one
JSON object with ``matrix`` (3 x 3; or ``T`` and ``K``) and ``B``, so that the specific
force is ``matrix @ (raw - B)``, and ends with exit code 0. Where one process has all
trials, each object has a line of its own and repeats the ``trial``, or the name of
the ``file`` of its folder. No shell is involved.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.errors import CrashedPluginError, UnusablePluginError
from simval.plugins.batch import answers
from simval.plugins.log import log_of
from simval.plugins.placeholders import Invocation, invocation_of
from simval.plugins.program import (
    ANSWER_LIMIT,
    OUTPUT,
    failure,
    filled,
    json_object,
    run,
)
from simval.plugins.protocol import BatchCalibrator, Calibrator, Estimator
from simval.shapes import Float

CALL_LIMIT = 60.0
"""Seconds that one call may take; the cell has its own limit beside it."""

VECTORS = ("b1", "b2", "r1", "r2")


def command_calibrator(words: str, **declared: Any) -> Calibrator:
    """Build the calibrator that runs a command.

    Parameters
    ----------
    words : str
        The program and its words, with the placeholders of
        `simval.plugins.placeholders`.
    **declared
        What else `Calibrator` declares: ``name``, ``form``, ``estimates``.

    Returns
    -------
    Calibrator
        As any other; it is run where it is measured.

    Raises
    ------
    UnusablePluginError
        If the words cannot be split, or do not say where the data go.
    """
    command = invocation_of(words)
    given = {"name": Path(command.words[0]).name, "noise_std": True, **declared}

    def calibrate(poses: Float[Array, "n 3"], g: float, noise_std: float) -> Any:
        if command.batch:
            return calibrate_all(poses[None], g, noise_std, CALL_LIMIT)[0]
        return _answer(command, poses, g, noise_std)

    def calibrate_all(
        sets: Float[Array, "t n 3"], g: float, noise_std: float, seconds: float
    ) -> list[Any]:
        return _answers(command, sets, g, noise_std, seconds)

    if not command.batch:
        return Calibrator(calibrate=calibrate, **given)
    return BatchCalibrator(calibrate=calibrate, calibrate_all=calibrate_all, **given)


def command_estimator(words: str, **declared: Any) -> Estimator:
    """Build the estimator that runs a command, once for each batch of vectors.

    A line of its trials is an object with ``trial``, its number, and ``b1``, ``b2``,
    ``r1``, ``r2``; it answers each with ``trial`` and the quaternion ``q``.

    Parameters
    ----------
    words : str
        The program and its words, with ``{trials}`` or ``< {trials}``.
    **declared
        What else `Estimator` declares: ``components``, ``matrix``, ``name`` and the
        like.

    Returns
    -------
    Estimator
        As any other; it is run where it is measured.

    Raises
    ------
    UnusablePluginError
        If the words cannot be split, or do not say where the trials go.
    """
    command = invocation_of(words)
    if command.batch != "trials" or command.uses("g"):
        msg = (
            f"`{words}` must say where its vectors go: `PROGRAM < {{trials}}` or "
            "`PROGRAM {trials}`; an estimator has neither poses nor g"
        )
        raise UnusablePluginError(msg)

    def estimate(*vectors: Float[Array, "n 3"]) -> list[Any]:
        rows = zip(*(each.tolist() for each in vectors), strict=True)
        lines = [dict(zip(VECTORS, row, strict=True)) for row in rows]
        found = _lines_answered(command, lines, {}, CALL_LIMIT)
        return [answer.get("q") for answer in found]

    name = Path(command.words[0]).name
    return Estimator(**{"name": name, **declared, "estimate": estimate})


def _answer(
    command: Invocation, poses: Float[Array, "n 3"], g: float, noise_std: float
) -> Any:
    """Run a process for one trial."""
    with TemporaryDirectory(
        prefix="simval-command-", ignore_cleanup_errors=True
    ) as name:
        folder, program = Path(name), command.words[0]
        files = {"poses": f"{name}/poses.csv", "log": f"{name}/log.csv"}
        if command.uses("poses"):
            _save(files["poses"], poses)
        if command.uses("log"):
            _save(files["log"], log_of(poses, noise_std))
        code = run(_filled(command, {**files, "g": repr(g)}), folder, CALL_LIMIT)
        if code != 0:
            msg = failure(program, code, folder)
            raise CrashedPluginError(msg)
        with (folder / OUTPUT).open("rb") as content:
            printed = content.read(ANSWER_LIMIT + 1)
        return json_object(f"`{program}`", printed)


def _answers(
    command: Invocation,
    sets: Float[Array, "t n 3"],
    g: float,
    noise_std: float,
    seconds: float,
) -> list[Any]:
    """Run one process for all trials."""
    if command.batch == "trials":
        same = {"g": g, "noise_std": noise_std}
        lines = [{"poses": poses, **same} for poses in sets.tolist()]
        return _lines_answered(command, lines, {"g": repr(g)}, seconds)
    with TemporaryDirectory(
        prefix="simval-command-", ignore_cleanup_errors=True
    ) as name:
        data = Path(name, "poses")
        data.mkdir()
        files = [f"{number:06d}.csv" for number in range(len(sets))]
        for file, poses in zip(files, sets, strict=True):
            _save(data / file, poses)
        words = _filled(command, {"poses_folder": str(data), "g": repr(g)})
        return answers(words, Path(name), seconds, "file", files)


def _lines_answered(
    command: Invocation,
    lines: Sequence[dict[str, Any]],
    values: dict[str, str],
    seconds: float,
) -> list[Any]:
    """Run one process for some trials, a line each."""
    with TemporaryDirectory(
        prefix="simval-command-", ignore_cleanup_errors=True
    ) as name:
        file = Path(name, "trials.jsonl")
        with file.open("w", encoding="utf-8") as content:
            for trial, line in enumerate(lines):
                content.write(json.dumps({"trial": trial, **line}) + "\n")
        words = _filled(command, {"trials": str(file), **values})
        given = file if command.standard_input else None
        names = list(range(len(lines)))
        return answers(words, Path(name), seconds, "trial", names, given)


def _filled(command: Invocation, values: dict[str, str]) -> Sequence[str]:
    return [filled(word, values) for word in command.words]


def _save(file: str | Path, rows: Float[Array, "n k"]) -> None:
    np.savetxt(file, rows, delimiter=",", fmt="%.17g")
