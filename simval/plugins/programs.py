r"""Algorithms in any language: programs that read data and print answers.

What a program is given and prints, placeholder by placeholder, is on the page of
programs (docs/plugins/command.md). A command is read where it is given, so that a
misspelt one is refused before anything is computed; no shell is involved. A calibrator
or an estimator gets all of its trials before it starts, may print its answers when it
likes and in any order, and prints into files: so neither a buffer that is not flushed
nor a pipe that fills can block, and an answer that is missing, given twice or put in
another's place is seen. Filters are in `filter_programs`.

A study's poses are means whose noise is known, and a log must be what a sensor would
have recorded whose rests have those means. With white noise :math:`w_i` of standard
deviation :math:`\sigma\sqrt n` per sample, the samples of a rest of n are

.. math:: x_i = y + w_i - \bar w,  \tag{R1}

where :math:`y`, the given pose, is off by noise of :math:`\sigma`. The mean of white
noise is independent of the deviations from it, so :math:`x_i` is the true reading plus
white noise and nothing else: whatever part of a rest a detector keeps is as wrong as
the scatter of its samples says. All rests are equally long, for a longer one would be
less wrong than its pose is; and turns begin and end with a knock, so that detectors
agree where the rests are.
"""

import json
import os
import re
import shlex
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, Any

import numpy as np

from simval.arrays import Array
from simval.errors import (
    CrashedPluginError,
    PluginError,
    SlowPluginError,
    UnusablePluginError,
)
from simval.plugins.child import ending, tail_of
from simval.plugins.names import COMMAND
from simval.plugins.protocol import (
    BatchCalibrator,
    Calibrator,
    Estimator,
)
from simval.shapes import Float

ANSWER_LIMIT = 1 << 20
"""Bytes that one answer may have: a calibration has some thousand."""


def json_object(who: str, printed: bytes) -> dict[str, Any]:
    """Read one JSON object, which `who` has printed."""
    if len(printed) > ANSWER_LIMIT:
        msg = f"{who} printed more than {ANSWER_LIMIT} bytes; print one object"
        raise PluginError(msg)
    try:
        answer = json.loads(printed, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        head = printed[:80].decode(errors="replace")
        msg = f"{who} did not print a JSON object ({error}): {head!r}"
        raise PluginError(msg) from None
    if not isinstance(answer, dict):
        msg = f"{who} printed {type(answer).__name__}; print one JSON object"
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


BATCH = "trials"
"""Data of all trials: one process."""

DATA = ("poses", "log", BATCH)
"""Data of one trial, with a process for each, or of all."""

PLACES = (*DATA, "g")

_PLACE = re.compile(r"(?:[^{}]*[=:])?\{([A-Za-z_]\w*)\}")
"""A word that is a placeholder, or ends with one after ``=`` or ``:``."""

GIVEN = re.compile(r"\{(\w+)\}")


@dataclass(frozen=True, slots=True)
class Invocation:
    """A command, parsed."""

    words: tuple[str, ...]  # the program and its words, with their placeholders
    batch: bool  # whether one process has all trials
    standard_input: bool  # whether the trials are on standard input

    def uses(self, place: str) -> bool:
        """True if a placeholder is among the words."""
        return any(f"{{{place}}}" in word for word in self.words)

    def filled(self, values: Mapping[str, str]) -> list[str]:
        """The words with the placeholders replaced by values."""
        words = list(self.words)
        for place, value in values.items():
            words = [word.replace(f"{{{place}}}", value) for word in words]
        return words


def invocation_of(algorithm: str) -> Invocation:
    """Read a command.

    Raises
    ------
    UnusablePluginError
        If the words cannot be split, a placeholder is unknown, or none says where the
        data go, or two say it differently.
    """
    words = split_words(algorithm)
    for word in words:
        found = _PLACE.fullmatch(word)
        if found is not None and found[1] not in PLACES:
            near = get_close_matches(found[1].lower(), PLACES, 1)
            meant = f"did you mean {{{near[0]}}}? " if near else ""
            known = ", ".join(f"{{{place}}}" for place in PLACES)
            msg = (
                f"`{algorithm}` has the placeholder {{{found[1]}}}, which does not "
                f"exist; {meant}There are {known}. Braces that are no placeholder need "
                f"a space inside: `{{ {found[1]} }}`"
            )
            raise UnusablePluginError(msg)
    kept, standard_input = _without_redirection(algorithm, words)
    text = " ".join(words)
    given = [place for place in DATA if f"{{{place}}}" in text]
    if not kept or not given:
        msg = (
            f"`{algorithm}` must name a program and where its file goes: "
            f"`{COMMAND} PROGRAM {{poses}}` or `{COMMAND} PROGRAM {{log}}` for a "
            f"process for each trial, `{COMMAND} PROGRAM < {{trials}}` for one process "
            "for all trials"
        )
        raise UnusablePluginError(msg)
    if BATCH in given and len(given) > 1:
        both = " and ".join(f"{{{place}}}" for place in given)
        msg = (
            f"`{algorithm}` has {both}; {{{BATCH}}} holds all trials, so it must be "
            "the only one"
        )
        raise UnusablePluginError(msg)
    return Invocation(
        words=tuple(kept),
        batch=BATCH in given,
        standard_input=standard_input,
    )


def split_words(command: str) -> list[str]:
    """Split a command into words."""
    try:
        return shlex.split(command.removeprefix(COMMAND))
    except ValueError as error:
        msg = f"`{command}` cannot be split into words: {error}"
        raise UnusablePluginError(msg) from None


def fault_of(algorithm: str) -> str:
    """Say why a command cannot be used; empty if it can."""
    try:
        invocation_of(algorithm)
    except UnusablePluginError as error:
        return str(error)
    return ""


def in_batch(algorithm: str) -> bool:
    """True for a command that takes all trials in one process."""
    command = algorithm.startswith(COMMAND) and not fault_of(algorithm)
    return command and invocation_of(algorithm).batch


def _without_redirection(algorithm: str, words: list[str]) -> tuple[list[str], bool]:
    """Remove ``< {trials}`` from the words, and say whether it was there."""
    kept: list[str] = []
    redirected: list[str] = []
    for word in words:
        if kept and kept[-1] == "<" and GIVEN.fullmatch(word):
            kept.pop()
            redirected.append(word)
        elif word.startswith("<") and GIVEN.fullmatch(word[1:]):
            redirected.append(word[1:])
        else:
            kept.append(word)
    if redirected not in ([], ["{trials}"]):
        msg = (
            f"`{algorithm}` asks for `< {redirected[-1]}`; no shell is involved, and "
            "only `< {trials}`, once, can be given on standard input"
        )
        raise UnusablePluginError(msg)
    return kept, bool(redirected)


Write = Callable[[Path], Mapping[str, str]]
"""Writes to a folder what a program is given; gives the value of each placeholder."""

MISSING = 3
"""Trials without an answer that a message names."""


@contextmanager
def run(
    command: Invocation, write: Write, seconds: float, trials: int = 0
) -> Iterator[IO[bytes]]:
    """Run a program on files in a folder of its own, and yield what it printed.

    It alone is waited for, not what it leaves behind. How many of some trials it had
    answered is said where it fails.
    """
    temporary = TemporaryDirectory(prefix="simval-command-", ignore_cleanup_errors=True)
    with temporary as given, TemporaryFile() as output, TemporaryFile() as errors:
        values = write(Path(given))
        words = command.filled(values)
        kind: type[PluginError] = CrashedPluginError
        read = values["trials"] if command.standard_input else os.devnull
        try:
            with open(read, "rb") as content:
                code = subprocess.run(
                    words,
                    stdin=content,
                    stdout=output,
                    stderr=errors,
                    timeout=seconds,
                    check=False,
                ).returncode
            said = f"{ending(code)}: {tail_of(errors) or 'silent'}" if code else ""
        except subprocess.TimeoutExpired:
            own = " (`time_limit`)" * (seconds != CALL_LIMIT)
            said, kind = f"did not answer within {seconds:g} s{own}", SlowPluginError
        except OSError as error:
            said = f"cannot be run: {error}"
        output.seek(0)
        if said:
            lines = sum(1 for line in output if line.strip())
            progress = f"; it had printed {lines} of {trials} lines" * bool(trials)
            msg = f"`{words[0]}` {said}{progress}"
            raise kind(msg)
        yield output


def answers(
    command: Invocation,
    lines: Sequence[Mapping[str, Any]],
    seconds: float,
    **values: str,
) -> list[dict[str, Any]]:
    """Run a program on one line for each trial, and sort its answers by trial.

    Raises
    ------
    CrashedPluginError
        If it cannot be run, or fails.
    SlowPluginError
        If it does not end in time.
    PluginError
        If there is not exactly one answer of each trial.
    """
    program, count = command.words[0], len(lines)

    def write(folder: Path) -> dict[str, str]:
        given = (json.dumps({"trial": k, **line}) for k, line in enumerate(lines))
        (folder / "trials.jsonl").write_text("\n".join(given) + "\n", encoding="utf-8")
        return {BATCH: str(folder / "trials.jsonl"), **values}

    found: dict[int, dict[str, Any]] = {}
    with run(command, write, seconds, count) as printed:
        for number, line in enumerate(printed, 1):
            if not line.strip():
                continue
            who = f"line {number} of `{program}`:"
            answer = json_object(who, line)
            trial = answer.pop("trial", None)
            if type(trial) is not int or not 0 <= trial < count:
                msg = (
                    f"{who} `trial` is {json.dumps(trial)}; each answer must repeat "
                    f"the `trial` of its line, 0 to {count - 1}"
                )
                raise PluginError(msg)
            if trial in found:
                msg = f"{who} `trial` {trial} is answered twice"
                raise PluginError(msg)
            found[trial] = answer
    if left := [str(trial) for trial in range(count) if trial not in found]:
        more = ", ..." if len(left) > MISSING else ""
        msg = (
            f"`{program}` answered {len(found)} of {count} trials and ended with "
            f"exit code 0; no answer for `trial` {', '.join(left[:MISSING])}{more}; "
            "print one JSON object for each trial, each in a line of its own"
        )
        raise PluginError(msg)
    return [found[trial] for trial in range(count)]


RATE = 100.0  # Hz
REST, MOVE = 10.0, 1.0  # s
QUIET = 1e-9
"""Least noise of a sample, of the greatest reading: a log without any has no rests."""


def log_of(poses: Float[Array, "n 3"], noise_std: float) -> Float[Array, "m 4"]:
    """Made-up log of a sensor that is turned from pose to pose."""
    seed = np.ascontiguousarray(poses, dtype=np.float32).view(np.uint32)
    rng = np.random.default_rng(seed.ravel())
    rest, move = round(REST * RATE), round(MOVE * RATE)
    sigma = max(noise_std * np.sqrt(rest), QUIET * np.abs(poses).max())
    s = np.linspace(0.0, 1.0, move)[:, None]
    rows = []
    for pose, following in zip(poses, [*poses[1:], poses[-1]], strict=True):
        noise = sigma * rng.standard_normal((rest, 3))
        rows.append(pose + noise - noise.mean(axis=0))
        # a turn begins and ends with a knock, and no part of it is at rest
        swing = np.linalg.norm(pose) * np.cos(9.0 * np.pi * s)
        turn = pose + (following - pose) * s + swing
        rows.append(turn + sigma * rng.standard_normal((move, 3)))
    samples = np.concatenate(rows)
    return np.column_stack([np.arange(len(samples)) / RATE, samples])


CALL_LIMIT = 60.0
"""Seconds that one call may take; the cell has its own limit beside it."""

VECTORS = ("b1", "b2", "r1", "r2")


def command_calibrator(words: str, **declared: Any) -> Calibrator:
    """Build a calibrator that runs a command.

    Parameters
    ----------
    words : str
        The program and its words, with the placeholders of docs/plugins/command.md.
    **declared
        Other declarations of `Calibrator`, as its ``form``.

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
        same = {"g": g, "noise_std": noise_std}
        lines = [{"poses": poses, **same} for poses in sets.tolist()]
        return answers(command, lines, seconds, g=repr(g))

    if not command.batch:
        return Calibrator(calibrate=calibrate, **given)
    return BatchCalibrator(calibrate=calibrate, calibrate_all=calibrate_all, **given)


def command_estimator(words: str, **declared: Any) -> Estimator:
    """Build an estimator that runs a command once for each batch.

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
    if not command.batch or command.uses("g"):
        msg = (
            f"`{words}` must say where its vectors go: `PROGRAM < {{trials}}` or "
            "`PROGRAM {trials}`; an estimator has neither poses nor g"
        )
        raise UnusablePluginError(msg)

    def estimate(*vectors: Float[Array, "n 3"]) -> list[Any]:
        rows = zip(*(each.tolist() for each in vectors), strict=True)
        lines = [dict(zip(VECTORS, row, strict=True)) for row in rows]
        return [each.get("q") for each in answers(command, lines, CALL_LIMIT)]

    name = Path(command.words[0]).name
    return Estimator(**{"name": name, **declared, "estimate": estimate})


def _answer(
    command: Invocation, poses: Float[Array, "n 3"], g: float, noise_std: float
) -> Any:
    """Run a process for one trial, and read its answer."""

    def write(folder: Path) -> dict[str, str]:
        files = {"poses": f"{folder}/poses.csv", "log": f"{folder}/log.csv"}
        if command.uses("poses"):
            _save(files["poses"], poses)
        if command.uses("log"):
            _save(files["log"], log_of(poses, noise_std))
        return {**files, "g": repr(g)}

    with run(command, write, CALL_LIMIT) as printed:
        return json_object(f"`{command.words[0]}`", printed.read(ANSWER_LIMIT + 1))


def _save(file: str | Path, rows: Float[Array, "n k"]) -> None:
    np.savetxt(file, rows, delimiter=",", fmt="%.17g")
