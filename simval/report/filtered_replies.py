"""How wrong filters are, whether their covariances are honest, what to do next."""

from collections.abc import Mapping, Sequence

import numpy as np

from simval.recorded import Evaluation
from simval.recorded.consistency import ALPHA, Consistency
from simval.recorded.errors import Rms
from simval.recorded.evaluation import turned_words
from simval.report.answers import rounded
from simval.report.replies import Answer, Reply
from simval.report.words import measured

PARTS = {"all": "all rows", "moving": "while moving", "rest": "at rest"}
"""Words for the parts of a log."""

WITHOUT_TRUTH = (
    "Without truth a filter can only be asked about itself: a scale error of the "
    "gyroscope, or noise told wrongly, leaves innovations as they should be; only "
    "truth shows the error. --truth takes a file, or the name of the log's columns."
)


def replies(done: Sequence[Evaluation], failed: Mapping[str, str]) -> tuple[Reply, ...]:
    """Answers to the three questions."""
    return _how_wrong(done), _honest(done), _next(done, failed)


def _how_wrong(done: Sequence[Evaluation]) -> Reply:
    title = "How wrong is each filter?"
    judged = sorted((each for each in done if each.truth is not None), key=_total)
    if not judged:
        said = "Nothing was measured" if not done else "No truth, so errors are unknown"
        lines = tuple(
            f"{each.run.name} at rest: its heading drifts {_drift(each):.2g} degrees a "
            "minute."
            for each in done
            if np.isfinite(each.at_rest.drift)
        )
        return Reply(title=title, headline=said, answer="inconclusive", lines=lines)
    best = judged[0]
    lines = tuple(
        f"{each.run.name}: {_degrees(own['total'])} in all, heading "
        f"{_degrees(own['heading'])}, inclination {_degrees(own['inclination'])}, "
        f"{PARTS.get(part, part)}."
        for each in judged
        for part, own in [_widest_part(each)]
    )
    lines += tuple(filter(None, [turned_words(done)]))
    first = "least" if len(judged) > 1 else "RMS error"
    size = _degrees(_widest_part(best)[1]["total"])
    return Reply(
        title=title,
        headline=f"{size} ({best.run.name}, {first})",
        lines=lines,
    )


def _widest_part(each: Evaluation) -> tuple[str, dict[str, Rms]]:
    """RMS of the errors over as much of the log as they are known in."""
    assert each.truth is not None
    known = each.truth.rms
    part = next((name for name in PARTS if name in known), next(iter(known)))
    return part, known[part]


def _total(each: Evaluation) -> float:
    value = _widest_part(each)[1]["total"].value
    return value if np.isfinite(value) else np.inf


def _degrees(rms: Rms) -> str:
    if not np.isfinite(rms.value):
        return "unknown"
    if not np.isfinite(rms.sd):
        return f"{np.degrees(rms.value):.3g}°"
    return f"{measured(np.degrees(rms.value), np.degrees(rms.sd))}°"


def _drift(each: Evaluation) -> float:
    return float(np.degrees(each.at_rest.drift) * 60.0)


def _honest(done: Sequence[Evaluation]) -> Reply:
    title = "Are their covariances honest?"
    stated = [(each.run.name, nees) for each in done if (nees := _nees(each))]
    told = [(name, nees) for name, nees in stated if nees.verdict != "not judged"]
    lines = [f"{name}: {_words(nees)}." for name, nees in stated]
    lines += [
        f"{each.run.name}: {_why_not(each)}." for each in done if _nees(each) is None
    ]
    good = sum(nees.verdict == "consistent" for _, nees in told)
    if not told:
        said, answer = "Cannot be judged", "inconclusive"
    else:
        said = _how_many(good, len(told))
        answer = "pass" if good == len(told) else "fail"
    if told:
        lines.append(f"False-alarm rate of each verdict: {100.0 * ALPHA:g} %.")
    return Reply(title=title, headline=said, answer=_answer(answer), lines=tuple(lines))


def _how_many(good: int, count: int) -> str:
    """How many covariances are consistent, in words."""
    if not good:
        return "The one that is stated is not" if count == 1 else f"None of {count} is"
    return f"{good} of {count} {'is' if good == 1 else 'are'} consistent"


def _answer(word: str) -> Answer:
    known: dict[str, Answer] = {"pass": "pass", "fail": "fail"}
    return known.get(word, "inconclusive")


def _nees(each: Evaluation) -> Consistency | None:
    return None if each.truth is None else each.truth.nees


def _why_not(each: Evaluation) -> str:
    if each.nis is not None:
        return (
            f"without truth only its innovations, {each.nis.verdict}, "
            f"{each.nis.mean:.3g} of {each.nis.expected:.3g}"
        )
    return "it states no covariance" if each.truth else "no truth to judge it by"


def _words(nees: Consistency) -> str:
    ratio = np.sqrt(nees.mean / nees.expected)
    return (
        f"{nees.verdict}, squared error over covariance {rounded(nees.mean, 3)} of "
        f"{nees.expected:g}, errors {ratio:.2g} times what it states"
    )


def _next(done: Sequence[Evaluation], failed: Mapping[str, str]) -> Reply:
    todo = [
        (f"Look at {name}, which was not measured", f"{name}: {why}")
        for name, why in failed.items()
    ]
    if done and not any(each.truth is not None for each in done):
        todo.append(("Give the recorded attitudes (--truth)", WITHOUT_TRUTH))
    todo += [found for each in done if (found := _advice(each))]
    if not todo:
        headline = "Nothing stands out: the covariances agree with the errors"
        return Reply(title="What to do next?", headline=headline)
    more = f", and {len(todo) - 1} more" if len(todo) > 1 else ""
    return Reply(
        title="What to do next?",
        headline=todo[0][0] + more,
        answer="fail" if failed else "pass",
        lines=tuple(words for _, words in todo),
    )


def _advice(each: Evaluation) -> tuple[str, str] | None:
    """What to do about a filter, in short and in a sentence."""
    name, nees = each.run.name, _nees(each)
    if nees is None or nees.verdict == "consistent":
        return None
    if nees.verdict == "overconfident":
        return (
            f"Tell {name} of more noise",
            f"{name} is surer than it may be: tell it of more noise, or calibrate the "
            "log first (simval calibrate LOG --out FILE, then --calibration FILE).",
        )
    if nees.verdict == "underconfident":
        return (
            f"Tell {name} of less noise",
            f"{name} is better than it says: tell it of less noise.",
        )
    if nees.blocks:
        return (
            "State the truth's world",
            f"The north of the log's magnetometer is too uncertain to judge the "
            f"covariance of {name}; state the truth's world (--truth-world).",
        )
    return (
        "Record for longer",
        f"Too few rows have truth to judge the covariance of {name}.",
    )
