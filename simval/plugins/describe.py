"""What a file or an installed package offers, asked in a child process.

It is code of a user's, and loading it runs it.
"""

import json
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory

from simval.errors import SimvalError
from simval.plugins.command import COMMAND, command_calibrator
from simval.plugins.errors import UnusablePluginError, told
from simval.plugins.loading import GROUP, plugins_of
from simval.plugins.process import ending, run_group
from simval.plugins.protocol import Calibrator, Estimator
from simval.scene import Scene

TIME_LIMIT = 60.0
STUDIES = {
    "estimator": "estimator.algorithm",
    "calibrator": "calibrator.algorithm",
    "scene": "custom_scene.scene",
}


def overrides_of(plugins: tuple[str, ...]) -> list[str]:
    """Overrides that put some plug-ins into a suite.

    Raises
    ------
    UnusablePluginError
        If one cannot be used, or holds no plug-in.
    """
    values: dict[str, list[str]] = {}
    for plugin in plugins:
        if "," in plugin:
            msg = f"`{plugin}` has a comma, which separates values; rename it"
            raise UnusablePluginError(msg)
        command = plugin.startswith(COMMAND)
        if command:
            command_calibrator(plugin)  # its words can be split and ask for a file
        held = [("calibrator", plugin)] if command else _held(plugin)
        for kind, word in held:
            values.setdefault(STUDIES[kind], []).append(word)
    return [f"{key}={','.join(words)}" for key, words in values.items()]


def installed() -> list[tuple[str, str]]:
    """Plug-ins that installed packages offer; none is loaded."""
    points = metadata.entry_points(group=GROUP)
    return sorted(
        (point.name, f"{point.dist.name} {point.dist.version}" if point.dist else "")
        for point in points
    )


def _held(plugin: str) -> list[tuple[str, str]]:
    """Kind of each plug-in that is meant, and the word that a suite has for it."""
    path, _, name = plugin.partition(".py:")
    if not name and not plugin.endswith(".py"):
        if plugin in (known for known, _ in installed()):
            return [(kind, plugin) for kind, _ in _asked(plugin)]
        names = ", ".join(known for known, _ in installed()) or "none"
        msg = (
            f"there is no plug-in `{plugin}`: a file must end in .py (FILE.py or "
            "FILE.py:NAME), and no installed package offers one of that name "
            f"(installed: {names})"
        )
        raise UnusablePluginError(msg)
    file = f"{path}.py" if name else plugin
    offered = _asked(file)
    held = [(kind, own) for kind, own in offered if not name or own == name]
    if not held:
        names = ", ".join(own for _, own in offered)
        msg = f"{file} holds no plug-in named {name}; it has: {names}"
        raise UnusablePluginError(msg)
    return [(kind, file if kind == "scene" else f"{file}:{own}") for kind, own in held]


def _asked(file: str) -> list[tuple[str, str]]:
    with TemporaryDirectory(prefix="simval-plugin-") as folder:
        answer = Path(folder, "answer.json")
        words = [sys.executable, "-P", "-m", __name__, file, str(answer)]
        try:
            code = run_group(words, subprocess.DEVNULL, TIME_LIMIT)
            found = json.loads(answer.read_text(encoding="utf-8"))
        except subprocess.TimeoutExpired:
            msg = f"{file} was not read within {TIME_LIMIT:g} s"
            raise UnusablePluginError(msg) from None
        except (OSError, ValueError):
            msg = f"the process that read {file} {ending(code)}"
            raise UnusablePluginError(msg) from None
    if "error" in found:
        error = str(found["error"])
        raise UnusablePluginError(error)
    return [(str(kind), str(name)) for kind, name in found["held"]]


def _main(plugin: str, answer: Path) -> None:
    try:
        values = plugins_of(Path(plugin), Scene) if _is_file(plugin) else _load(plugin)
        held = [(_kind(value), value.name) for value in values]
        found: dict[str, object] = {"held": held}
        if not held:
            found = {
                "error": f"{plugin} holds no Estimator, Calibrator or Scene at its top "
                "level; see docs/plugins.md"
            }
    except SimvalError as error:
        found = {"error": str(error)}
    except SystemExit as error:
        what = "file" if _is_file(plugin) else "package"
        found = {"error": f"the plug-in {what} {plugin} calls exit({error.code})"}
    answer.write_text(json.dumps(found), encoding="utf-8")
    sys.stdout.flush()
    os._exit(0)


def _is_file(plugin: str) -> bool:
    return plugin.endswith(".py")


def _load(name: str) -> list[Estimator | Calibrator | Scene]:
    points = metadata.entry_points(group=GROUP, name=name)
    try:
        values = [point.load() for point in points]
    except Exception as error:  # whatever an installed package may raise
        msg = f"the entry point `{name}` fails with {told(error)}"
        raise UnusablePluginError(msg) from error
    return [v for v in values if isinstance(v, (Estimator, Calibrator, Scene))]


def _kind(value: Estimator | Calibrator | Scene) -> str:
    if isinstance(value, Scene):
        return "scene"
    return "calibrator" if isinstance(value, Calibrator) else "estimator"


if __name__ == "__main__":
    _main(sys.argv[1], Path(sys.argv[2]))
