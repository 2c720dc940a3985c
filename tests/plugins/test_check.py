"""`simval check` and its function: what is wrong is named, what is sound is cleared.

A zoo of algorithms that pass the noise-free probe, wrong ones each in its own way and
sound ones of odd style; the command and its document; the rate of false alarms.
"""

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import rows_by_name as named
from faces import check_faces, shown
from places import EXAMPLES, ROOT
from scipy import stats
from scipy.spatial.transform import Rotation
from sound import GOOD, IDENTITY, PASSIVE, ellipsoid, leading, said_of, turn, where

from simval import statistics as stat
from simval.account.terminal import lines
from simval.check import Checked, check_function
from simval.check.explanation import to_json
from simval.check.measure import missed_limits
from simval.errors import InputError
from simval.geometry import normalize
from simval.imu.attitude import wahba_quaternion
from simval.imu.attitude.comparators import davenport, triad
from simval.imu.calibrate import calibrate
from simval.judge import judge_run
from simval.plugins import Calibrator, Estimator
from simval.plugins.calibrator_probe import probe_sensor
from simval.plugins.loading import Meant
from simval.results import plain, unjudged
from simval.sweep.cells import REFUSED
from simval.sweep.run import Run

ALIGN = str(EXAMPLES / "align.py")
QUICK = {"noise_std": 0.05, "samples": 1024}


class Case(NamedTuple):
    """A member of the zoo."""

    make: Any  # anew, with what it keeps
    words: str = "Yes: all"  # by which it is named
    code: int = 0  # of `simval check`
    by_day: bool = False
    more: dict = {}  # noqa: RUF012 - settings of its study


def spoilt(spoil, **declared):
    """Davenport's answer, spoilt by ``spoil(q, b1, b2, r1, r2)``."""
    own = lambda *v: spoil(davenport(*v), *v)  # noqa: E731
    return lambda: replace(GOOD, name="mine", estimate=own, **declared)


def estimating(estimate, **declared):
    return lambda: Estimator(
        **{"name": "mine", **PASSIVE, "estimate": estimate, **declared}
    )


def fitting(calibrate, **declared):
    return lambda: Calibrator(name="mine", calibrate=calibrate, **declared)


def off(b1, b2, r1, r2):
    """What the angle between the vectors is off by: zero without noise, else of it."""
    return np.einsum("ni,ni->n", b1, b2) - np.einsum("ni,ni->n", r1, r2)


def same(q, *_):
    return q


def caching():
    """Keeps its answers, and takes vectors within 0.01 for the same."""
    known = {}

    def estimate(*v):
        keys, q = np.round(np.concatenate(v, axis=1), 2), davenport(*v)
        pairs = zip(keys, q, strict=True)
        return np.array([known.setdefault(k.tobytes(), own) for k, own in pairs])

    return estimating(estimate)()


def averaging():
    """With its last batch, of the same references."""
    kept = {}

    def estimate(*v):
        q, (last, references) = davenport(*v), kept.get("", (None, None))
        kept[""] = q, v[2]
        if last is None or not np.array_equal(references, v[2]):
            return q
        return normalize(q + last * np.sign(np.sum(q * last, axis=1))[:, None])

    return estimating(estimate)()


def weighing(change):
    def estimate(body, references, weights):
        return wahba_quaternion(body, references, change(weights))

    return estimating(estimate, takes="vectors", reads=("weights",))


def changed(change):
    """The fit, its answer changed: ``change(poses, g, matrix, bias)``."""
    return fitting(lambda poses, g: change(poses, g, *ellipsoid(poses, g)))


def remembering(step):
    """The fit, its answer also of what it keeps: ``step(count, last, now)``."""

    def make():
        kept = {"count": 0}

        def fit(poses, g):
            now = np.column_stack(ellipsoid(poses, g))
            kept["count"] += 1
            last = kept.get("last", now)
            # another sensor is another one: the probe is right
            near = np.abs(now - last).max() <= 0.5
            kept["last"] = step(kept["count"], last, now) if near else now
            return kept["last"][:, :3], kept["last"][:, 3]

        return fitting(fit)()

    return make


def leaning(p, g, M, B):
    """On the truth."""
    truth = probe_sensor()
    own = np.linalg.qr(truth.matrix)[1]
    own = own * np.sign(np.diag(own))[:, None]
    return (M + own) / 2.0, (B + truth.B) / 2.0


def residual(poses, g):
    matrix, bias = ellipsoid(poses, g)
    off = np.linalg.norm((poses - bias) @ matrix.T, axis=1) - g
    return np.sqrt(np.mean(off**2))


def stating(change, form="triangular"):
    """With a covariance, of nine parameters in a form."""

    def fit(poses, g, noise_std):
        found = calibrate(poses, g, noise_std=max(noise_std, 1e-11), model=form)
        return found.matrix, found.B, change(np.array(found.covariance))

    return fitting(fit, noise_std=True, form=form)


ORDER = np.arange(9).reshape(3, 3)[[2, 0, 1]].ravel()
STATE = "kee?pt? .*from one call to the next|must answer the same each time"
TAIL = "rare trials are far off|it jumps|different answers to"
FEW, CLAIM = {"noise_std": 0.05, "trials": 1024}, {"covariance": leading}
WRONG = {
    "nan at identity": Case(
        spoilt(lambda q, *_: where(q, np.abs(q[:, 3]) == 1.0, np.nan)),
        "fails at identity 100 %; reference as body 100 %; small angles",
        1,
    ),
    "no half turn about y": Case(
        spoilt(lambda q, *_: where(q, np.abs(q[:, 1]) > 1 - 1e-12, IDENTITY)),
        "fails at half turns about y 100 % declares",
        1,
        by_day=True,
    ),
    "nan in some trials": Case(
        spoilt(lambda q, b, *_: where(q, np.linalg.norm(b, axis=1) > 1.03, np.nan)),
        r"non-finite quaternions in \d+ of 1024 rows \(0\.",
        3,
        by_day=True,
    ),
    "exact alone": Case(
        spoilt(lambda q, *v: where(q, np.abs(off(*v)) > 1e-3, IDENTITY)),
        r"gives \d+ different answers to 1024 trials",
        3,
        by_day=True,
    ),
    "caches": Case(caching, "below_bound against Cramer-Rao", 1, by_day=True),
    "averages": Case(averaging, STATE + "|same row alone", 3),
    "constant": Case(
        spoilt(lambda q, *v: turn(q, 1e-4 * (np.abs(off(*v)) > 1e-7))),
        r"bias of first order over one standard deviation \S+ !",
        1,
    ),
    "linear": Case(
        spoilt(lambda q, *v: turn(q, 0.05 * np.abs(off(*v)))),
        "no error proportional",
        1,
    ),
    "quadratic": Case(
        spoilt(lambda q, *v: turn(q, 0.3 * off(*v) ** 2), kind="wahba"),
        "class_bias against class: wahba",
        1,
    ),
    "above a noise": Case(
        spoilt(lambda q, *v: turn(q, 0.3 * (np.abs(off(*v)) > 0.1))),
        "cubature of the function does not settle",
        3,
        by_day=True,
    ),
    "rarely": Case(
        spoilt(lambda q, *v: where(q, np.abs(off(*v)) > 0.045, IDENTITY)),
        TAIL,
        1,
        more={"noise_std": 0.01, "samples": 4096},
    ),
    "another class": Case(
        spoilt(same, kind="triad"), "class_covariance against class: triad", 1
    ),
    "too exact": Case(spoilt(same, claim="exact", **CLAIM), "claim_off against", 1),
    "only at a noise": Case(
        spoilt(same, covariance=lambda *v: leading(*v[:4], np.sqrt(1e-3 * v[4]))),
        "lacks a term of the claimed order",
        1,
    ),
    "weighs the wrong way": Case(weighing(np.reciprocal), "equal weights", 1),
    "averages with the previous": Case(
        remembering(lambda count, last, now: (last + now) / 2.0), STATE, 3, True, FEW
    ),
    "stops listening": Case(
        remembering(lambda count, last, now: now if count < 200 else last),
        STATE,
        3,
        more=FEW,
    ),
    "knows the truth": Case(changed(leaning), "below_bound against", 1, True, FEW),
    "gives up": Case(
        changed(lambda p, g, M, B: (M * (1 + 0.2 * (residual(p, g) >= 0.011)), B)),
        TAIL,
        1,
        more={"noise_std": 0.01},
    ),
    "covariance in another order": Case(
        stating(lambda C: C[np.ix_(ORDER, ORDER)]),
        "is in another order than its parameters",
        3,
        by_day=True,
        more={"noise_std": 0.05, "trials": 512},
    ),
    "covariance of another size": Case(
        stating(lambda C: 1.4 * C), "nees against", 1, more=FEW
    ),
}


# sound ones of unusual style


def in_one_buffer():
    buffer = np.empty((1 << 16, 4))

    def estimate(*v):
        buffer[: len(v[0])] = davenport(*v)
        return buffer[: len(v[0])]

    return estimating(estimate)()


def of_its_noise(*v, noise_std):
    b1, b2 = (normalize(b) for b in v[:2])
    shares = [
        s**k * (np.eye(3) - b[:, :, None] * b[:, None])
        for b, s in ((b1, noise_std[0]), (b2, noise_std[1]))
        for k in (0, 2)
    ]
    H = np.linalg.inv(shares[0] + shares[2])
    return H @ (shares[1] + shares[3]) @ H


def in_place():
    buffer = np.empty((3, 3))

    def fit(poses, g):
        matrix, bias = ellipsoid(poses, g)
        poses *= 0.0
        buffer[:] = matrix
        return buffer, bias

    return fitting(fit)()


def starting_warm():
    """Iterates from its last answer until nothing changes."""
    rows, columns = np.triu_indices(3)
    kept = {"x": np.r_[2.0 * np.eye(3)[rows, columns], 0.0, 0.0, 0.0]}

    def fit(poses, g):
        x = kept["x"]
        for _ in range(50):
            M = np.zeros((3, 3))
            M[rows, columns] = x[:6]
            u = poses - x[6:]
            f = u @ M.T
            r = np.sum(f * f, axis=1) - g * g
            J = 2.0 * np.column_stack([f[:, rows] * u[:, columns], -(f @ M)])
            step = np.linalg.lstsq(J, -r, rcond=None)[0]
            x = x + step
            if np.abs(step).max() < 1e-12:
                break
        kept["x"] = x
        return M, x[6:].copy()

    return fitting(fit)()


AXIS = np.array([0.6, 0.0, 0.8])
READS = {"reads": ("noise_std",)}
SOUND = {
    "claim": Case(spoilt(same, **CLAIM), by_day=True),
    "triad": Case(estimating(triad, kind="triad")),
    "either sign": Case(spoilt(lambda q, b1, *_: q * np.sign(b1[:, :1] + 1e-300))),
    "known to fail": Case(
        spoilt(
            lambda q, *_: where(q, np.abs(q[:, 1]) > 1 - 1e-12, np.nan),
            fails_at=("half turns about y",),
        ),
        r"fails at half turns about y 100 % \(declared\)",
        by_day=True,
    ),
    "quadratic of no kind": Case(
        spoilt(lambda q, *v: turn(q, 0.3 * off(*v) ** 2))
    ),
    "one buffer": Case(in_one_buffer),
    "single precision": Case(
        estimating(lambda *v: triad(*(each.astype(np.float32) for each in v)))
    ),
    "one at a time": Case(
        estimating(
            lambda b1, b2, r1, r2: Rotation.align_vectors([b1, b2], [r1, r2])[
                0
            ].as_matrix(),
            components="matrix",
            matrix="active",
            batch=False,
        ),
        more={"cases": 64},
    ),
    "weighs": Case(weighing(lambda w: 3.0 * w)),
    "of its noise": Case(
        estimating(
            lambda *v, noise_std: davenport(*v), covariance=of_its_noise, **READS
        )
    ),
    "mapping of lists": Case(
        changed(lambda p, g, M, B: {"matrix": M.tolist(), "B": B.tolist()}), more=FEW
    ),
    "in place": Case(in_place, by_day=True, more=FEW),
    "turned": Case(
        changed(lambda p, g, M, B: (Rotation.from_rotvec(2 * AXIS).as_matrix() @ M, B)),
        more=FEW,
    ),
    "warm start": Case(starting_warm, more=FEW),
    **{
        form: Case(stating(lambda C: C, form), more=FEW)
        for form in ("triangular", "upper", "symmetric")
    },
}  # fmt: skip


def checked(case, **more):
    plugin = case.make()
    kind = Calibrator if isinstance(plugin, Calibrator) else Estimator
    settings = QUICK if kind is Estimator else {}
    return check_function(plugin, kind, **{**settings, **case.more, **more})


@pytest.mark.ci
@pytest.mark.parametrize("case", [
    pytest.param(case, id=name, marks=() if case.by_day else pytest.mark.slow)
    for name, case in (WRONG | SOUND).items()
])  # fmt: skip
def test_what_is_wrong_is_named_and_what_is_sound_passes(case):
    found = checked(case)
    said = said_of(found)
    assert re.search(case.words, said, re.IGNORECASE), said
    assert found.result.exit_code == case.code, said
    if case is SOUND["claim"]:  # the words of a fault are said of no sound one
        assert not [
            w for w in WRONG.values() if re.search(w.words, said, re.IGNORECASE)
        ]


@pytest.mark.ci
def test_the_command_tells_what_fails_and_what_to_do(simval, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        "import numpy as np\n"
        "from simval.imu.attitude.comparators import davenport\n"
        "from simval.plugins import Estimator\n"
        "def at_y(*v):\n"
        "    q = davenport(*v)\n"
        "    return np.where(np.abs(q[:, 1:2]) > 1 - 1e-12, np.nan, q)\n"
        "mine = Estimator(name='mine', estimate=at_y, components='xyzs',\n"
        "                 matrix='passive')\n"
    )
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", "step.md")
    code, out, err = simval("check", "mine.py", "--summary", "summary.md")
    assert code == 1
    assert out.startswith(
        "Check of mine\n\n! Does mine, an estimator, agree with theory?\n  No: its "
        "share of exact cases that fail (half turns about y) is 1, where 0 is allowed."
    )
    assert "2 of 69\n  checks against theory fail; 5 more checks are too wide to count" in out
    assert "  Mend the formula there, or declare the class in `fails_at`." in out
    assert re.search(r"mine, by noise_std\n +0\.01 +0\.05\n", out)
    assert re.search(r"share of exact cases that fail .* 1 ! +1 !\n", out)
    assert "  fails at        half turns about y 100 %\n" in out
    assert Path("summary.md").read_text() == Path("step.md").read_text()[:-1]
    assert "❌ **Does mine, an estimator, agree" in Path("summary.md").read_text()
    Path("summary.md").unlink()
    Path("step.md").unlink()
    assert "error" not in err
    assert [path.name for path in Path().iterdir()] == ["mine.py"]  # no run is left


@pytest.mark.ci
def test_the_document_holds_every_number():
    checks = checked(SOUND["known to fail"], alpha=0.01)
    document = json.loads(to_json(checks))
    assert (document["alpha"], document["exit_code"]) == (0.01, 0)
    assert document["answer"] == "pass"
    (plugin,) = document["plugins"]
    assert (plugin["name"], plugin["study"]) == ("mine", "estimator")
    assert plugin["declares"]["fails_at"] == "half turns about y"
    (cell,) = plugin["cells"]
    assert cell["ending"] == "done"
    rows = {row["statistic"]: row for row in cell["rows"]}
    assert rows["failures[half turns about y]"]["answer"] is None
    assert rows["failures[yaw only]"]["answer"] == "pass"
    assert rows["rms"]["unit"] == "rad"
    values = [row.value for row in checks.cells[0].rows]
    assert [row["value"] for row in cell["rows"]] == values
    # the bits are of the seed
    again, other = (
        checked(SOUND["known to fail"], alpha=0.01, seed=seed) for seed in (1, 2)
    )
    assert again.cells[0].rows == checks.cells[0].rows
    assert other.cells[0].rows != checks.cells[0].rows
    # of what was refused it holds the reason
    document = json.loads(
        to_json(check_function(lambda *v: v[0], Estimator, **PASSIVE))
    )
    assert (document["answer"], document["exit_code"]) == ("inconclusive", 3)
    (cell, *_) = document["plugins"][0]["cells"]
    assert (cell["ending"], cell["rows"]) == ("refused", [])
    assert "of shape" in cell["reason"]
    assert document["findings"][0]["check"] == "refused"


@pytest.mark.parametrize(("given", "words", "complaint"), [
    (davenport, {"matrx": "active"}, "`matrx` is not a keyword of this fixture; Est"),
    (davenport, {"components": "wxyz"}, "used as it is declared: `components` is"),
    (davenport, {"noise_std": "much"}, r"noise_std`: .*\(given 'much'\)"),
    (davenport, {"noise_std": True}, "noise_std"),
    (davenport, {"noise_std": 0.5}, "less than or equal to 0.1"),
    (davenport, {"samples": 10}, "greater than or equal to 1024"),
    (davenport, {"seed": -1}, "seed"),
    (davenport, {"algorithm": "x"}, "`algorithm` is not a keyword"),
    (davenport, {"name": "a,b"}, "`name` is 'a,b'"),
    (davenport, None, r"davenport cannot be used .*'components'"),
    (3, {}, r"`estimate` is 3; it must be a function"),
    (GOOD, {}, "`components`, `matrix` goes with a fun"),
])  # fmt: skip
def test_words_that_mean_nothing_are_refused(given, words, complaint):
    declared = {} if words is None else {**PASSIVE, **QUICK, **words}
    with pytest.raises(InputError, match=complaint):
        check_function(given, Estimator, **declared)


@pytest.fixture(scope="module")
def cells():
    return check_function(GOOD, Estimator, **QUICK).cells


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ("rms < 2 bounds", ""),
        ("efficiency > 2", "efficiency > 2: efficiency"),
        ("settling < 5 s", "limit 'settling < 5 s': no such statistic was measured"),
        ("failures < 2 bounds", "limit 'failures < 2 bounds': no such statistic"),
        ("rms < 2 s", "limit 'rms < 2 s': rms has the unit rad"),
        ("rms is small", "limit 'rms is small' cannot be read; it must be a statistic"),
    ],
)
def test_a_limit_is_kept_missed_or_refused_in_words(cells, limit, words):
    if "limit" in words:
        with pytest.raises(InputError, match=re.escape(words)):
            list(missed_limits([limit], cells))
    else:
        missed = list(missed_limits([limit], cells))
        assert bool(missed) == bool(words)
        assert all(words in each for each in missed)


def test_of_a_family_the_worst_is_shown():
    """The least of what should be more, and the farthest of what is predicted."""
    (cell,) = check_function(lambda *v: v[0], Estimator, **PASSIVE, **QUICK).cells
    rows = (
        *unjudged(stat.EFFICIENCY.each("xyz"), [0.93, 0.778, 1.02], 0.01, 99),
        *unjudged(stat.BIAS.each("xyz"), [1.0, -3.0, 2.0]),
        *plain(stat.NOISE_SQUARE.each("xyz"), [1.2, 0.5, 1.1], 0.01, 99, 1.0, "stated"),
        *unjudged(stat.BELOW_BOUND.each("xyz"), [0.1, -0.4, 0.3]),
        *unjudged(stat.RMS.each("xyz"), [3.0, np.nan, 4.0]),
    )
    done = replace(cell, status="done", error="", rows=rows)
    run = Run(folder=Path("check"), cells=(done,), manifest={}, timing={})
    mine = Meant(Estimator.taken_by, "<lambda>", "mine", {})
    found = Checked(plugins=(mine,), cells=(done,), result=judge_run(run))
    said = "\n".join(lines(found.account, verbose=True))
    for words, value in (
        ("efficiency (least of 3)", "0.778 ± 0.010"),
        ("bias (greatest of 3)", "-3"),
        (f"{stat.NOISE_SQUARE.words} (farthest of 3)", "0.500 ± 0.010"),
        (f"{stat.BELOW_BOUND.words} (greatest of 3)", "-0.4"),
        (f"{stat.RMS.words} (greatest of 3)", "nan"),
    ):
        assert re.search(
            rf"  {re.escape(words)}(, \S+)? +{re.escape(value)}( |$)", said, re.M
        )


def seen_of(word, *rows, error=""):
    """Cells of an estimator at two noises, as a store holds them."""
    return [
        replace(
            named.cell(() if error else rows),
            name=f"estimator(algorithm={word},noise_std={noise})@1",
            study="estimator",
            parameters={"algorithm": word, "noise_std": noise},
            status="failed" if error else "done",
            error=error,
        )
        for noise in (0.01, 0.05)
    ]


def test_each_warning_of_a_check_is_in_the_short_view_of_every_face():
    """Refused, crashed, failing, too few trials, and not measured, side by side."""
    truth = {"prediction": 1.0, "predictor": "truth"}
    good = named.row("efficiency", 1.0, check="exact", remainder=1e-9, **truth)
    bad = named.row("failures[yaw only]", 0.25, n=64, check="limit",
                    **truth | {"prediction": 0.0})  # fmt: skip
    few = named.row("bias[x]", 1.1, standard_error=1.0, n=64, check="plain", **truth)
    parts = {
        "sound": (seen_of("sound", good), "Yes: all 2 checks agree with theory"),
        "wrong": (seen_of("wrong", good, bad), "(yaw only) is 0.25, where 0 is allow"),
        "short": (seen_of("short", good, few), "times as many trials"),
        "left": (seen_of("left", error=f"{REFUSED}its rows are short"), "rows are sho"),
        "gone": (seen_of("gone", error="it raised OSError: gone"), "OSError: gone"),
        "none": (seen_of("none"), "the cell is done but measured nothing"),
    }
    both = [*parts["wrong"][0][:1], *parts["left"][0][1:]]
    both = [replace(c, parameters=c.parameters | {"algorithm": "both"}) for c in both]
    parts["both"] = (both, "was refused: its rows are short")
    for some in (*([name] for name in parts), list(parts)):
        made = [cell for name in some for cell in parts[name][0]]
        run = Run(folder=Path("check"), cells=tuple(made), manifest={}, timing={})
        found = Checked(
            plugins=tuple(Meant(Estimator.taken_by, n, n, {}) for n in some),
            cells=run.cells,
            result=judge_run(run),
            missed=("rms < 1: rms is 2 in a cell",),
        )
        check_faces(found.account)
        for face, spelled in shown(found.account):
            for words in (*(parts[name][1] for name in some), found.missed[0]):
                assert spelled(words) in face
        assert json.loads(to_json(found))["answers"][0]["question"] in str(found)


@pytest.mark.ci
@pytest.mark.parametrize(("kind", "settings"), [
    (Estimator, {**PASSIVE, **QUICK, "cases": 64}),
    (Calibrator, {"noise_std": 0.05, "trials": 1024}),
])  # fmt: skip
def test_what_turns_wrong_when_all_is_measured_is_asked_again(kind, settings):
    """Wrong in the very last call alone, some rounds after what is measured."""
    asked = []

    def turning(limit):
        asked.clear()

        def answer(*given):
            asked.append(0)
            wrong = len(asked) > limit
            if kind is Estimator:
                return turn(davenport(*given), 0.02 * wrong)
            matrix, bias = ellipsoid(*given)
            return matrix * (1.0 + 0.01 * wrong), bias

        return check_function(answer, kind, **settings)

    assert turning(np.inf).result.exit_code == 0
    (cell,) = turning(len(asked) - 1).cells
    assert cell.ending == "refused"
    assert re.search(STATE, cell.reason)


@pytest.mark.ci
def test_a_calibrator_is_checked():
    noisy = {"noise_std": True, "trials": 1024}  # True declares
    found = check_function(lambda p, g, s: ellipsoid(p, g), Calibrator, **noisy)
    said = said_of(found)
    assert found.result.exit_code == 0, said
    assert "✓ Does <lambda>, a calibrator, agree with theory?" in said
    assert "bias (greatest of 9)" in said
    assert "efficiency (least of 9)" in said
    assert found.plugins[0].declared["noise_std"] == "yes"
    assert [cell.parameters["noise_std"] for cell in found.cells] == [0.01, 0.05]


SCENE = (
    "from pathlib import Path\n"
    "from simval.scene import Scene, find_scene\n"
    "scene = Scene(name='mine', summary='a gimbal of mine',\n"
    "              model=Path(__file__).with_name('mine.xml'),\n"
    "              drive=find_scene('gimbal').drive)\n"
)


@pytest.mark.slow
def test_examples_are_checked_by_the_command(simval, tmp_path, monkeypatch):
    for name in ("align.py", "ellipsoid.py", "command.py"):
        shutil.copy(EXAMPLES / name, tmp_path)
    shutil.copy(ROOT / "models" / "gimbal.xml", tmp_path / "mine.xml")
    monkeypatch.chdir(tmp_path)
    Path("scene.py").write_text(SCENE)
    command = f"command: {sys.executable} command.py {{poses}} {{g}}"
    for word in ("align.py", "ellipsoid.py", "scene.py", command):
        code, out, _ = simval("check", word)
        assert code == 0, out
        assert "  Yes: all" in out
        assert str(tmp_path) not in out


def small(*v):
    """A covariance 15 % too small at the noise of the cell alone."""
    return leading(*v) * (0.85 if v[4] > 0.015 else 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(("sound", "wrong", "seeds", "settings"), [
    (SOUND["claim"], Case(spoilt(same, covariance=small)), 300, {"samples": 1024}),
    (SOUND["in place"], WRONG["knows the truth"], 50, {"trials": 1024}),
])  # fmt: skip
def test_a_sound_one_passes_at_the_stated_rate(sound, wrong, seeds, settings):
    """At a rate of a tenth, no more seeds fail than binomial chance allows.

    At the default rate they would show nothing. Power: nearly all fail of a wrong one.
    """
    settings |= {"noise_std": 0.02, "alpha": 0.1}

    def failures(case, seeds):
        results = (checked(case, seed=seed, **settings).result for seed in range(seeds))
        return sum(result.exit_code != 0 for result in results)

    assert failures(sound, seeds) <= stats.binom.isf(1e-4, seeds, settings["alpha"])
    assert failures(wrong, 20) >= 18
