"""Messages for optional packages that are not installed.

simval is on no package index: whoever took its name there would be the one whose code
is installed by it. What an extra asks for is on an index, and is installed by itself,
whatever simval was installed from: a checkout, a wheel or a repository.
"""

import re
import shlex
import sys
from typing import NoReturn

from simval.errors import InputError


def refuse_without(extra: str, what: str, otherwise: str = "") -> NoReturn:
    """Refuse what needs an extra's packages; `otherwise` says how to do without."""
    msg = f"{needing(extra, what)}{otherwise}"
    raise InputError(msg) from None


def needing(extra: str, what: str) -> str:
    """Say what needs the packages of an extra, and how to install them."""
    return f"{what} needs the extra `{extra}`: {advice(extra)}"


def advice(extra: str) -> str:
    """Name the command that installs what an extra asks for, for this very Python."""
    wanted = requirements(extra)
    if not wanted:
        return "install what pyproject.toml lists for it"
    return f"{installer()} {shlex.join(wanted)}"


def installer() -> str:
    """Choose pip where this Python has it, and otherwise uv, which needs none."""
    from importlib.util import find_spec

    python = shlex.quote(sys.executable or "python")
    if find_spec("pip"):
        return f"{python} -m pip install"
    return f"uv pip install --python {python}"


def requirements(extra: str) -> list[str]:
    """Read the requirements of an extra from the metadata; empty without metadata."""
    from importlib.metadata import PackageNotFoundError, requires

    mark = re.compile(rf"(.+?)\s*;\s*extra == ['\"]{re.escape(extra)}['\"]")
    try:
        found = (mark.fullmatch(line) for line in requires("simval") or ())
    except PackageNotFoundError:  # run from a folder of sources
        return []
    return [each[1] for each in found if each]
