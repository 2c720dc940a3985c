"""Logs of broken sensors, cables and loggers: found and named, no good one lost."""

import itertools
import json
import re
from dataclasses import replace

import made_logs
import numpy as np
import pytest
from made_logs import FAULTS, RATE, far, good

from simval.cli import calibrate, noise
from simval.errors import RefusedError, SimvalError
from simval.imu.multiposition import calibrate_log
from simval.imu.noise import NoiseFile, noise_of
from simval.poses import fibonacci_sphere, random_directions

# what the refusal says, of the faults that nothing else could be taken for
WORDS = {
    "stuck_axis": "shows .* in every row .* not connected or stuck; check",
    "dead_axis": "check its wire|check the wiring|every row",
    "same_channel": "two columns are one channel, or .*; check the wiring",
    "wrap": "wraps around a range of .*: read the counts",
    "frozen": "froze; cut that stretch out",
    "repeated_block": "again, bit for bit: .* cut the second out",
    "units": "times the gravity of the others, .* one unit",
    "sign_flip": "the sign of .* changed between .*: turn it back .* or cut",
    "swapped_axes": "changed places between .* or cut the log there",
    "zero_rows": "all exactly 0 in .* lost data",
    "clipped": "saturated at",
}


def recording(name, seed):
    rng = np.random.default_rng([71, len(name), sum(map(ord, name)), seed])
    rec = good(rng)
    return rec if name == "good" else FAULTS[name](rec, rng)


OPTIONS = {o for p in calibrate.command.params for o in p.opts}
OF_NOISE = {o for p in noise.command.params for o in p.opts}


def outcome(rec):
    """The result, or the words of the refusal, whose options the command has."""
    try:
        return calibrate_log(rec.log), ""
    except SimvalError as error:
        words = str(error)
    without_noise = re.sub(r"simval noise [^)]*\)", "", words)
    assert set(re.findall(r"--[a-z][a-z-]*", without_noise)) <= OPTIONS, words
    assert set(re.findall(r"--[a-z][a-z-]*", words)) <= OPTIONS | OF_NOISE, words
    assert not re.findall(r"`[a-z_]+(?:=[^`]*)?`", words), words
    return None, words


def misled(rec):
    """Whether an answer is accepted that is wrong beyond its error bars."""
    result, _ = outcome(rec)
    return result is not None and made_logs.wrong(rec, result.fit)


@pytest.mark.ci
@pytest.mark.parametrize("name", WORDS)
def test_a_fault_is_refused_and_named(name):
    """In three logs it is refused or harmless, and in most named with the time."""
    named = 0
    for seed in range(3):
        rec = recording(name, seed)
        result, words = outcome(rec)
        assert result is None or not made_logs.wrong(rec, result.fit)
        named += bool(re.search(WORDS[name], words)) and bool(
            re.search(r"from \d|between \d|at \d", words)
        )
    assert named >= 1


def written(rec, path):
    rows = np.column_stack([rec.log.time, rec.samples])
    np.savetxt(path, rows, delimiter=",", header="t [s],ax,ay,az", comments="")
    return path


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "seed"),
    [("sign_flip", 3), ("swapped_axes", 3), ("gain_change", 3), ("bias_jump", 2),
     ("pushed", 3)],
)  # fmt: skip
def test_the_option_that_is_advised_helps(name, seed, simval, tmp_path):
    """The log is accepted then, and nothing is wrong with it."""
    rec = recording(name, seed)
    path = written(rec, tmp_path / "log.csv")
    _, out, err = simval("calibrate", path)
    option, value = re.search(r"\((--[a-z-]+) ([\d.,]+)\)", err or out).groups()
    code, out, err = simval("calibrate", path, option, value, "--json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["intervals"] >= len(rec.holds) // 2 - 1  # the longer part
    if option != "--from":  # what is kept is of the sensor before the fault
        off = np.abs(found["K"] - rec.sensor.K) / found["sd"][3:6]
        assert np.all(off < 6.0)  # nine values of t with a dozen degrees of freedom
    said = simval("calibrate", path, option, value)[1]
    assert "✓ Can the error bars be trusted?" in said


@pytest.mark.ci
def test_the_runners_up_are_listed_where_asked_for(simval, tmp_path):
    """One sentence without, and with it what else was tried, less likely each."""
    rec = recording("sign_flip", 1)
    path = written(rec, tmp_path / "log.csv")
    code, out, err = simval("calibrate", path)
    assert (code, out, err.count("error: "), err.count("10^")) == (3, "", 1, 0)
    code, out, more = simval("calibrate", path, "--verbose")
    assert (code, out, more[: len(err)]) == (3, "", err)
    odds = [float(tens) for tens in re.findall(r"10\^(-?[\d.]+) ", more)]
    assert len(odds) == 4
    assert odds == sorted(odds, reverse=True)
    assert odds[0] > 15.0 > odds[1]  # 10^22.8 was seen, and 10^3.3
    assert re.search(r"100.0 %  the sign of y changed", more)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_no_bad_log_is_accepted_with_a_wrong_answer(name):
    """60 of each of 17 kinds, 1020 in all: at most one of a kind, whatever it says."""
    assert sum(misled(recording(name, seed)) for seed in range(60)) <= 1


@pytest.mark.parametrize("logs", [2, pytest.param(300, marks=pytest.mark.slow)])
def test_no_good_log_is_lost(logs):
    """In counts or m/s^2, coarse or fine: not one refused or wrong."""
    for seed in range(logs):
        rec = recording("good", seed)
        result, words = outcome(rec)
        assert result is not None, words
        assert not made_logs.wrong(rec, result.fit)


def test_a_log_without_noise_is_refused_in_words():
    """Rests of one value each: nothing tells a rest from a stuck sensor."""
    for seed in range(2):
        result, words = outcome(good(np.random.default_rng([83, seed]), sigma=0.02))
        assert result is None
        assert re.search("do(es)? not vary at all.* (finer|coarse)", words)


FEW = [  # rests, a fault in them, and what is said of it
    (18, "bias_jump", "the bias of .* changed between the rest"),
    (18, "gain_change", "the scale of .* changed between the rest"),
    (12, "bias_jump", "changed between the rest"),
    (11, "bias_jump", "So few rests cannot show"),
]


@pytest.mark.ci
@pytest.mark.parametrize(("count", "name", "said"), FEW)
def test_a_step_in_few_rests_is_refused(count, name, said):
    """Fewer than 22 rests, no part of which can be judged by itself: 4 of 150 logs with
    a jump of a bias were accepted with a wrong answer. One or two degrees of freedom
    say that something moved and not what. The same rests without it are accepted."""
    words = []
    for seed in range(3):
        rng = np.random.default_rng([87, count, seed])
        rec = good(rng, up=rng.permutation(fibonacci_sphere(count)))
        assert count > 12 or outcome(rec)[0] is not None
        result, refusal = outcome(FAULTS[name](rec, rng))
        assert result is None or not made_logs.wrong(rec, result.fit)
        words.append(refusal)
    assert any(re.search(said, each) for each in words), words


@pytest.mark.ci
def test_a_spike_is_no_wrap_and_a_flip_no_fault():
    """A jump of the whole range that no rest takes part in, and a log that skips the
    turns between its rests, are what they are."""
    rec = recording("good", 4)
    x = rec.samples.copy()
    x[rec.holds[3, 0] - 20, 0] += 4 * np.ptp(x[:, 0])
    keep = np.concatenate([np.arange(*hold) for hold in rec.holds])
    for samples in (x, rec.samples[keep]):
        assert calibrate_log(replace(rec, samples=samples).log).fit.converged


# what is advised


def of_few(count, seed):
    """A log of so many rests in random directions, and its sensor's measured noise."""
    rng = np.random.default_rng([91, count, seed])
    rec = good(rng, up=random_directions(count, rng))
    rest = rec.samples[50] + rec.sigma * rng.standard_normal((20_000, 3))
    gravity = float(np.linalg.norm(rest.mean(axis=0)))
    known = NoiseFile(
        accelerometer=noise_of(rest, RATE), si_per_raw=None, gravity_raw=gravity
    )
    return rec, known


@pytest.mark.ci
def test_few_rests_are_told_what_to_do_and_it_works():
    """Nine or ten rests were refused with an argument that no command has."""
    told = helped = 0
    for count, seed in itertools.product((9, 10), range(3)):
        rec, known = of_few(count, seed)
        _, words = outcome(rec)
        if "say too little of the noise" not in words:
            continue
        assert "--noise noise.json" in words
        told += 1
        try:
            fit = calibrate_log(rec.log, noise=known).fit
        except RefusedError:
            continue  # the geometry of these poses is no matter of noise
        helped += 1
        assert fit.covariance_kind == "known sigma"
        # 27 to 54 normal numbers: one seed in 1e4
        assert far(fit, rec.sensor.parameters) < 5.5
    assert helped >= told / 2 >= 1
