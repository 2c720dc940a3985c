"""A calibrator in any language: a command that is given a file and answers with JSON.

In its words ``{poses}`` stands for a file with one pose to a line, the mean reading
``x,y,z``; ``{log}`` for a recorded log at 100 Hz, ``t,x,y,z``, in which the sensor
rests ten seconds and then two in each pose; ``{g}`` for gravity in m/s^2. It prints one
JSON object with ``matrix`` (3 x 3; or ``T`` and ``K``) and ``B``, so that the specific
force is ``matrix @ (raw - B)``, and ends with exit code 0. No shell is involved.
"""

import json
import shlex
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from simval.arrays import Array
from simval.plugins.errors import PluginError
from simval.plugins.protocol import Calibrator

COMMAND = "command:"
PLACES = ("{poses}", "{log}")
CALL_LIMIT = 60.0
"""Seconds that one call may take; the cell has its own limit beside it."""

RATE = 100.0
FIRST_REST, REST, MOVE = 10.0, 2.0, 1.0


def command_calibrator(algorithm: str) -> Calibrator:
    """Build the calibrator that runs a command.

    Parameters
    ----------
    algorithm : str
        ``command: PROGRAM WORDS...`` with ``{poses}`` or ``{log}`` among them.

    Returns
    -------
    Calibrator
        Named by its program.

    Raises
    ------
    PluginError
        If the words cannot be split, or no file is asked for.
    """
    try:
        words = shlex.split(algorithm.removeprefix(COMMAND))
    except ValueError as error:
        msg = f"`{algorithm}` cannot be split into words: {error}"
        raise PluginError(msg) from None
    text = " ".join(words)
    if not words or not any(place in text for place in PLACES):
        msg = (
            f"`{algorithm}` must name a program and where its file goes: "
            f"`{COMMAND} PROGRAM {{poses}}` or `{COMMAND} PROGRAM {{log}}`"
        )
        raise PluginError(msg)

    def calibrate(poses: Array, g: float, noise_std: float) -> Any:
        return _answer(words, poses, g, noise_std)

    return Calibrator(name=Path(words[0]).name, calibrate=calibrate, noise_std=True)


def _answer(words: list[str], poses: Array, g: float, noise_std: float) -> Any:
    with TemporaryDirectory(prefix="simval-command-") as folder:
        files = {"{poses}": f"{folder}/poses.csv", "{log}": f"{folder}/log.csv"}
        text = " ".join(words)
        if "{poses}" in text:
            np.savetxt(files["{poses}"], poses, delimiter=",", fmt="%.17g")
        if "{log}" in text:
            samples = recorded(poses, noise_std)
            np.savetxt(files["{log}"], samples, delimiter=",", fmt="%.17g")
        filled = [_filled(word, {**files, "{g}": repr(g)}) for word in words]
        try:
            done = subprocess.run(
                filled,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=CALL_LIMIT,
                check=False,
            )
        except subprocess.TimeoutExpired:
            msg = f"`{words[0]}` did not answer within {CALL_LIMIT:g} s"
            raise PluginError(msg) from None
        except OSError as error:
            msg = f"`{words[0]}` cannot be run: {error}"
            raise PluginError(msg) from None
    return _parsed(words[0], done)


def recorded(poses: Array, noise_std: float) -> Array:
    """Log of a sensor that is turned from pose to pose.

    Parameters
    ----------
    poses : Array
        Reading of each pose, raw units, (n, 3).
    noise_std : float
        Noise of a pose mean; the samples' noise is as much greater as the root of
        their number, and alternates in sign so that each rest keeps its mean.

    Returns
    -------
    Array
        Time in s and reading, (m, 4).
    """
    rows = []
    for number, (pose, following) in enumerate(
        zip(poses, [*poses[1:], poses[-1]], strict=True)
    ):
        rest = round((FIRST_REST if number == 0 else REST) * RATE)
        sign = np.where(np.arange(rest) % 2 == 0, 1.0, -1.0)
        amplitude = max(noise_std * np.sqrt(REST * RATE), 1e-9 * np.abs(poses).max())
        rows.append(pose + amplitude * sign[:, None])
        s = np.linspace(0.0, 1.0, round(MOVE * RATE))[:, None]
        # out of the straight line too, so that no part of a turn is at rest
        swing = 0.5 * np.sin(np.pi * s) * np.linalg.norm(pose) * np.sin(9.0 * np.pi * s)
        rows.append(pose + (following - pose) * s + swing)
    samples = np.concatenate(rows)
    return np.column_stack([np.arange(len(samples)) / RATE, samples])


def _filled(word: str, values: dict[str, str]) -> str:
    for place, value in values.items():
        word = word.replace(place, value)
    return word


def _parsed(program: str, done: subprocess.CompletedProcess[bytes]) -> Any:
    if done.returncode != 0:
        tail = done.stderr.decode(errors="replace").strip()[-300:]
        msg = f"`{program}` ended with exit code {done.returncode}: {tail or 'silent'}"
        raise PluginError(msg)
    try:
        answer = json.loads(done.stdout)
    except (ValueError, RecursionError) as error:
        head = done.stdout[:80].decode(errors="replace")
        msg = f"`{program}` did not print one JSON object ({error}): {head!r}"
        raise PluginError(msg) from None
    if not isinstance(answer, dict):
        msg = f"`{program}` printed {type(answer).__name__}; print one JSON object"
        raise PluginError(msg)
    return answer
