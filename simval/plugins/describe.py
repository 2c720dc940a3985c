"""What a plug-in file holds, asked in a child process: the file is code of a user's."""

import json
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from simval.errors import SimvalError
from simval.plugins.errors import PluginError
from simval.plugins.loading import plugins_of
from simval.plugins.process import ending, run_group
from simval.plugins.protocol import Calibrator
from simval.scene import Scene

TIME_LIMIT = 60.0
STUDIES = {
    "estimator": "estimator.algorithm",
    "calibrator": "calibrator.algorithm",
    "scene": "custom_scene.scene",
}


def overrides_of(files: tuple[str, ...]) -> list[str]:
    """Overrides that put the plug-ins of some files into a suite.

    Parameters
    ----------
    files : tuple of str
        Paths of Python files, or ``command: PROGRAM ...``.

    Returns
    -------
    list of str
        ``STUDY.KEY=VALUE[,VALUE...]``, as the command line's ``--set`` takes them.

    Raises
    ------
    PluginError
        If a file cannot be used, or holds no plug-in.
    """
    values: dict[str, list[str]] = {}
    for file in files:
        if "," in file:
            msg = f"`{file}` has a comma, which separates values; rename it"
            raise PluginError(msg)
        held = [("calibrator", "")] if file.startswith("command:") else _asked(file)
        for kind, name in held:
            word = f"{file}:{name}" if name else file
            values.setdefault(STUDIES[kind], []).append(word)
    return [f"{key}={','.join(words)}" for key, words in values.items()]


def _asked(file: str) -> list[tuple[str, str]]:
    with TemporaryDirectory(prefix="simval-plugin-") as folder:
        answer = Path(folder, "answer.json")
        words = [sys.executable, "-P", "-m", __name__, file, str(answer)]
        try:
            code = run_group(words, subprocess.DEVNULL, TIME_LIMIT)
            found = json.loads(answer.read_text(encoding="utf-8"))
        except subprocess.TimeoutExpired:
            msg = f"the plug-in file {file} was not read within {TIME_LIMIT:g} s"
            raise PluginError(msg) from None
        except (OSError, ValueError):
            msg = f"the process that read the plug-in file {file} {ending(code)}"
            raise PluginError(msg) from None
    if "error" in found:
        error = str(found["error"])
        raise PluginError(error)
    return [(str(kind), str(name)) for kind, name in found["held"]]


def _main(file: str, answer: Path) -> None:
    try:
        held = [
            (
                "scene"
                if isinstance(value, Scene)
                else "calibrator"
                if isinstance(value, Calibrator)
                else "estimator",
                "" if isinstance(value, Scene) else value.name,
            )
            for value in plugins_of(Path(file), Scene)
        ]
        found: dict[str, object] = {"held": held}
        if not held:
            found = {
                "error": f"{file} holds no Estimator, Calibrator or Scene at its top "
                "level; see docs/plugins.md"
            }
    except SimvalError as error:
        found = {"error": str(error)}
    except SystemExit as error:
        found = {"error": f"the plug-in file {file} calls exit({error.code})"}
    answer.write_text(json.dumps(found), encoding="utf-8")
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    _main(sys.argv[1], Path(sys.argv[2]))
