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
from jaxtyping import Float

from simval.arrays import Array
from simval.errors import CrashedPluginError
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
from simval.plugins.protocol import BatchCalibrator, Calibrator

CALL_LIMIT = 60.0
"""Seconds that one call may take; the cell has its own limit beside it."""


def command_calibrator(algorithm: str) -> Calibrator:
    """Build the calibrator that runs a command.

    Raises
    ------
    UnusablePluginError
        If the words cannot be split, or do not say where the data go.
    """
    command = invocation_of(algorithm)
    name = Path(command.words[0]).name

    def calibrate(poses: Float[Array, "n 3"], g: float, noise_std: float) -> Any:
        if command.batch:
            return calibrate_all(poses[None], g, noise_std, CALL_LIMIT)[0]
        return _answer(command, poses, g, noise_std)

    def calibrate_all(
        sets: Float[Array, "t n 3"], g: float, noise_std: float, seconds: float
    ) -> list[Any]:
        return _answers(command, sets, g, noise_std, seconds)

    if not command.batch:
        return Calibrator(name=name, calibrate=calibrate, noise_std=True)
    return BatchCalibrator(
        name=name, calibrate=calibrate, noise_std=True, calibrate_all=calibrate_all
    )


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
        code = run(_filled(command, files, g), folder, CALL_LIMIT)
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
    with TemporaryDirectory(
        prefix="simval-command-", ignore_cleanup_errors=True
    ) as name:
        folder, trials = Path(name), Path(name, "trials.jsonl")
        data = Path(name, "poses")
        words = _filled(command, {"trials": str(trials), "poses_folder": str(data)}, g)
        if command.batch == "trials":
            _save_lines(trials, sets, g, noise_std)
            given = trials if command.standard_input else None
            names = list(range(len(sets)))
            return answers(words, folder, seconds, "trial", names, given)
        data.mkdir()
        files = [f"{number:06d}.csv" for number in range(len(sets))]
        for file, poses in zip(files, sets, strict=True):
            _save(data / file, poses)
        return answers(words, folder, seconds, "file", files)


def _filled(command: Invocation, files: dict[str, str], g: float) -> Sequence[str]:
    return [filled(word, {**files, "g": repr(g)}) for word in command.words]


def _save(file: str | Path, rows: Float[Array, "n k"]) -> None:
    np.savetxt(file, rows, delimiter=",", fmt="%.17g")


def _save_lines(
    file: Path, sets: Float[Array, "t n 3"], g: float, noise_std: float
) -> None:
    with file.open("w", encoding="utf-8") as lines:
        for trial, poses in enumerate(sets.tolist()):
            line = {"trial": trial, "poses": poses, "g": g, "noise_std": noise_std}
            lines.write(json.dumps(line) + "\n")
