"""Why a new baseline differs from the one that it replaces, kind by kind.

What only the paired comparison sees is hidden by a new baseline in the same change. So
each kind of statistic that moved by more than its error needs a reason of its own,
which is kept in the file, where a reviewer reads it.
"""

from collections.abc import Sequence

from simval.errors import InputError
from simval.gate.groups import Group, groups
from simval.gate.judgement import GateResult
from simval.text import did_you_mean


def moved_kinds(result: GateResult) -> dict[str, list[Group]]:
    """What failed beside the old baseline, by study and kind of statistic."""
    kinds: dict[str, list[Group]] = {}
    for group in groups(result):
        if group.worst.tier == "baseline" and group.worst.answer == "fail":
            kinds.setdefault(group.what or "the run", []).append(group)
    return kinds


def reasons_given(
    kinds: Sequence[str], stated: Sequence[str], reason: str
) -> dict[str, str]:
    """Reasons by kind: those stated as KIND=WORDS, KIND being one or a whole study.

    If one kind moved, the reason of the update is its reason.

    Raises
    ------
    InputError
        If one is not of that form or names nothing that moved.
    """
    given = dict.fromkeys(kinds, reason) if len(kinds) == 1 else {}
    for each in stated:
        name, equals, words = each.partition("=")
        own = [kind for kind in kinds if name.strip() in (kind, study_of(kind))]
        if not (equals and words.strip()):
            msg = f"--reason {each!r} is not of the form KIND=WORDS; say why, after ="
            raise InputError(msg)
        if not own:
            known = sorted({*kinds, *map(study_of, kinds)})
            meant = did_you_mean(name, known)
            msg = (
                f"nothing that is called {name.strip()!r} moved{meant}; take the kinds "
                "that the command prints"
            )
            raise InputError(msg)
        given |= dict.fromkeys(own, words.strip())
    return given


def study_of(kind: str) -> str:
    """The study of a kind."""
    return kind.partition(",")[0]
