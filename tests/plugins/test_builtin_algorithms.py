"""The package's own algorithms as plug-ins, beside a user's; and the time of a call."""

import numpy as np
import pytest
import rows_by_name
from click.testing import CliRunner
from places import EXAMPLES
from quick_align import ALIGN

from simval import algorithms
from simval.cli.listing import command as list_command
from simval.cli.sweep import command as sweep_command
from simval.errors import InputError, PluginError
from simval.plugins import (
    Calibrator,
    Estimator,
    find_plugin,
    probe_calibrator,
    probe_estimator,
)
from simval.plugins.loading import (
    BESIDE,
    BUILTIN,
    beside_builtin,
    chosen,
    missing,
    sources,
    spelled,
)
from simval.plugins.protocol import Filter
from simval.streams import Streams
from simval.studies import estimator
from simval.sweep import load_run, run_suite
from simval.sweep.suite import expand
from simval.verdict import judge

ESTIMATORS = (
    "simval:wahba",
    "simval:weighted-wahba",
    "simval:triad",
    "simval:closed-form",
    "simval:combined",
)

FILTERS = ("simval:mekf",)
KINDS = {name: Estimator for name in ESTIMATORS} | {name: Filter for name in FILTERS}


def test_every_name_is_an_algorithm_of_its_kind():
    for name in BUILTIN:
        kind = KINDS.get(name, Calibrator)
        found = find_plugin(name, kind)
        assert f"simval:{found.name}" == name
        assert sources(name) == {}  # the package's own version and source say it
        assert missing(name) == ""
    assert {name for own in BESIDE.values() for name in own} <= set(BUILTIN)
    with pytest.raises(PluginError, match=r"must be a simval\.plugins\.Calibrator"):
        find_plugin("simval:wahba", Calibrator)


@pytest.mark.ci
@pytest.mark.parametrize("name", ESTIMATORS)
def test_estimators_pass_the_probe_of_a_users(name):
    assert probe_estimator(find_plugin(name, Estimator)) <= 1e-9


@pytest.mark.parametrize("name", [n for n in BUILTIN if n not in KINDS])
def test_calibrators_pass_the_probe_of_a_users(name):
    assert probe_calibrator(find_plugin(name, Calibrator)) <= 1e-9


def test_a_noise_of_nothing_moves_no_parameter():
    """What stands in for no noise is below rounding."""
    poses = np.random.default_rng(0).standard_normal((24, 3))
    poses *= 9.80665 / np.linalg.norm(poses, axis=1)[:, None]
    for name in ("squared", "adjusted"):
        own = getattr(algorithms, name)
        matrix, bias, covariance = own.calibrate(poses, 9.80665, 0.0)
        np.testing.assert_allclose(matrix, np.eye(3), rtol=0, atol=1e-13)
        np.testing.assert_allclose(bias, 0.0, rtol=0, atol=1e-12)
        assert np.diagonal(covariance).max() < 1e-20


@pytest.mark.ci
@pytest.mark.parametrize("noise", ["body", "unequal", "general"])
@pytest.mark.parametrize("name", ["wahba", "weighted-wahba"])
def test_least_squares_of_three_vectors_states_a_covariance_that_is_right(name, noise):
    """A false alarm of 1e-3 for all rows together; NEES of a claim of order two."""
    parameters = estimator.Parameters(
        algorithm=f"simval:{name}", noise=noise, vectors=3, samples=4096
    )
    found = estimator.compute(parameters, Streams(1, (20_270,)))
    judged = judge(rows_by_name.named(found.rows), alpha=1e-3)
    assert {"nees", "class_bias"} <= {str(v.row.statistic) for v in judged}
    assert [v for v in judged if v.answer != "pass" and v.row.check != "record"] == []


@pytest.mark.ci
def test_a_users_algorithm_gets_its_comparison_without_being_asked():
    field = Estimator.taken_by
    for given, added in (
        (["m.py:a"], ["simval:wahba", "simval:triad"]),
        (["m.py:a", "m.py:b"], ["simval:wahba", "simval:triad"]),
        (["m.py:a", "simval:triad"], ["simval:wahba"]),
        (["theirs"], ["simval:wahba", "simval:triad"]),
    ):
        assert beside_builtin({field: given}) == {field: [*given, *added]}
    field = Calibrator.taken_by
    for given in (["m.py:a"], ["command: x {poses}"]):
        assert beside_builtin({field: given}) == {field: [*given, "simval:squared"]}
    # a built-in one alone is what was asked for, and a scene has none beside it
    assert beside_builtin(chosen(("simval:triad",))) == {
        "estimator.algorithm": ["simval:triad"]
    }
    assert beside_builtin({"custom_scene.scene": ["s.py"]}) == {
        "custom_scene.scene": ["s.py"]
    }


def invoked(*words):
    done = CliRunner().invoke(sweep_command, list(words), standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.output


@pytest.mark.ci
def test_the_command_adds_them_and_a_set_takes_them_away():
    mine = str(EXAMPLES / "align.py")
    out = invoked("smoke", "--plugin", mine, "--dry-run")
    for name in ("align.py:align", "simval:wahba", "simval:triad"):
        assert out.count(f"estimator(algorithm={name},") == 1
    words = ("--set", f"estimator.algorithm={mine}")
    out = invoked("smoke", "--plugin", mine, *words, "--dry-run")
    assert out.count("estimator(") == 1
    listed = CliRunner().invoke(list_command, standalone_mode=False).output
    assert ", ".join(BUILTIN) in listed


@pytest.mark.parametrize(
    ("word", "near"),
    [
        ("simval:", ""),
        ("simval:nope", ""),
        ("simval:Wahba", r" \(did you mean `simval:wahba`\?\)"),
        ("simval:x y", ""),
    ],
)
def test_a_name_that_is_none_is_refused_with_those_there_are(word, near, tmp_path):
    words = (
        rf"no built-in algorithm `{word}`{near}; there are simval:wahba, .*"
        "simval:adjusted"
    )
    with pytest.raises(InputError, match=words):
        spelled(chosen((word,)))
    with pytest.raises(InputError, match=words):
        find_plugin(word, Estimator)
    suite = expand("s", {"estimator": {"algorithm": word}})
    with pytest.raises(InputError, match=words):
        run_suite(suite, tmp_path / "run")
    assert not (tmp_path / "run").exists()


# the time of a call


@pytest.mark.ci
def test_a_cell_brings_its_time_and_no_row_of_it(tmp_path):
    (tmp_path / "align.py").write_text(ALIGN)
    content = {"estimator": {"algorithm": str(tmp_path / "align.py"), "samples": 1024}}
    run_suite(expand("s", content), tmp_path / "run")
    run = load_run(tmp_path / "run")
    (cell,) = run.of("estimator")
    times = run.timing["calls"][cell.name]
    assert times["items"] == estimator.BLOCK
    # Davenport's method beside itself, but for a sign
    assert 0.2 < times["ratio"] < 5.0
    assert 0.0 < times["seconds"] < 1.0
    table = (tmp_path / "run" / "results.csv").read_text()
    assert repr(times["seconds"]) not in table
    assert repr(times["ratio"]) not in table
    # they go with the run: what a resumed sweep need not compute keeps its time
    before = run.timing["calls"]
    run_suite(expand("s", content), tmp_path / "run", resume=True)
    assert load_run(tmp_path / "run").timing["calls"] == before


@pytest.mark.ci
def test_what_differs_from_least_squares_by_rounding_is_judged_by_it():
    """It was inconclusive: a remainder of its rounding, and no spread beside it."""
    own = algorithms.wahba.estimate
    single = Estimator(
        name="single",
        estimate=lambda b, r: own(b, r, None).astype(np.float32),
        components="xyzs",
        matrix="passive",
        takes="vectors",
    )
    parameters = estimator.Parameters(algorithm="any", noise_std=0.05, samples=1024)
    found = estimator.outcome(single, parameters, Streams(1, (20_271,))).rows
    answers = {str(v.row.statistic): v.answer for v in judge(rows_by_name.named(found))}
    assert answers["rms_difference"] == "pass"
    # power: it may be off by less than a thousandth of the noise
    (row,) = (r for r in found if str(r.statistic) == "rms_difference")
    assert 0.0 < row.remainder < 1e-3 * parameters.noise_std
