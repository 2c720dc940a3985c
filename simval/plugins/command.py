"""A calibrator in any language: a command that is given a file and answers with JSON.

In its words ``{poses}`` stands for a file with one pose to a line, the mean reading
``x,y,z``; ``{log}`` for a log at 100 Hz, ``t,x,y,z``, in which the sensor
rests ten seconds in each pose; ``{g}`` for gravity in m/s^2. It prints one
JSON object with ``matrix`` (3 x 3; or ``T`` and ``K``) and ``B``, so that the specific
force is ``matrix @ (raw - B)``, and ends with exit code 0. No shell is involved.
"""

import json
import os
import shlex
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float

from simval.arrays import Array
from simval.errors import CrashedPluginError, PluginError, UnusablePluginError
from simval.plugins.child import ending
from simval.plugins.log import log_of
from simval.plugins.names import COMMAND
from simval.plugins.protocol import Calibrator

PLACES = ("{poses}", "{log}")
CALL_LIMIT = 60.0
"""Seconds that one call may take; the cell has its own limit beside it."""

ANSWER_LIMIT = 1 << 20
"""Bytes that a command may answer with: a calibration has some thousand."""


def command_calibrator(algorithm: str) -> Calibrator:
    """Build the calibrator that runs a command.

    Raises
    ------
    UnusablePluginError
        If the words cannot be split, or no file is asked for.
    """
    try:
        words = shlex.split(algorithm.removeprefix(COMMAND))
    except ValueError as error:
        msg = f"`{algorithm}` cannot be split into words: {error}"
        raise UnusablePluginError(msg) from None
    text = " ".join(words)
    if not words or not any(place in text for place in PLACES):
        msg = (
            f"`{algorithm}` must name a program and where its file goes: "
            f"`{COMMAND} PROGRAM {{poses}}` or `{COMMAND} PROGRAM {{log}}`"
        )
        raise UnusablePluginError(msg)

    def calibrate(poses: Float[Array, "n 3"], g: float, noise_std: float) -> Any:
        return _answer(words, poses, g, noise_std)

    return Calibrator(name=Path(words[0]).name, calibrate=calibrate, noise_std=True)


def _answer(
    words: list[str], poses: Float[Array, "n 3"], g: float, noise_std: float
) -> Any:
    with TemporaryDirectory(
        prefix="simval-command-", ignore_cleanup_errors=True
    ) as name:
        folder = Path(name)
        files = {"{poses}": f"{name}/poses.csv", "{log}": f"{name}/log.csv"}
        text = " ".join(words)
        if "{poses}" in text:
            np.savetxt(files["{poses}"], poses, delimiter=",", fmt="%.17g")
        if "{log}" in text:
            samples = log_of(poses, noise_std)
            np.savetxt(files["{log}"], samples, delimiter=",", fmt="%.17g")
        filled = [_filled(word, {**files, "{g}": repr(g)}) for word in words]
        code = _run(filled, folder)
        if code != 0:
            tail = _last(folder / "stderr", 300)
            msg = f"`{words[0]}` {ending(code)}: {tail or 'silent'}"
            raise CrashedPluginError(msg)
        return _parsed(words[0], folder / "stdout")


def _run(words: list[str], folder: Path) -> int:
    """Run a command that prints into files of a folder, and wait for it alone.

    Pipes would grow without bound in our memory, and would be held open by whatever
    process the command leaves behind. Files stop at the limit of the cell's process,
    in whose group the command stays, so that it and all it leaves end with the cell.
    """
    with (
        (folder / "stdout").open("wb") as output,
        (folder / "stderr").open("wb") as errors,
    ):
        try:
            return subprocess.run(
                words,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors,
                timeout=CALL_LIMIT,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            msg = f"`{words[0]}` did not answer within {CALL_LIMIT:g} s"
            raise CrashedPluginError(msg) from None
        except OSError as error:
            msg = f"`{words[0]}` cannot be run: {error}"
            raise CrashedPluginError(msg) from None


def _filled(word: str, values: dict[str, str]) -> str:
    for place, value in values.items():
        word = word.replace(place, value)
    return word


def _last(file: Path, count: int) -> str:
    with file.open("rb") as content:
        content.seek(max(0, content.seek(0, os.SEEK_END) - count))
        return content.read().decode(errors="replace").strip()


def _parsed(program: str, file: Path) -> Any:
    with file.open("rb") as content:
        printed = content.read(ANSWER_LIMIT + 1)
    if len(printed) > ANSWER_LIMIT:
        msg = f"`{program}` printed more than {ANSWER_LIMIT} bytes; print one object"
        raise PluginError(msg)
    try:
        answer = json.loads(printed, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        head = printed[:80].decode(errors="replace")
        msg = f"`{program}` did not print one JSON object ({error}): {head!r}"
        raise PluginError(msg) from None
    if not isinstance(answer, dict):
        msg = f"`{program}` printed {type(answer).__name__}; print one JSON object"
        raise PluginError(msg)
    return answer


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        msg = f"the key `{twice}` is given twice"
        raise ValueError(msg)
    return values
