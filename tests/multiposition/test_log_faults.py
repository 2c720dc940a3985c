"""Logs of broken sensors, cables and loggers: found and named, no good one lost."""

import itertools
import re

import bad_logs
import numpy as np
import pytest

from simval.cli import calibrate, noise
from simval.errors import RefusedError, SimvalError
from simval.multiposition import calibrate_log
from simval.noise import NoiseFile, noise_of
from simval.poses import fibonacci_sphere, random_directions

# what the refusal says, of the faults that nothing else could be taken for
WORDS = {
    "stuck_axis": "shows .* in every row .* not connected or stuck; check",
    "dead_axis": "check its wire|check the wiring|every row",
    "same_channel": "two columns are one channel, or .*; check the wiring",
    "wrap": "wrap around a range of .* unwrap them",
    "frozen_sensor": "froze; cut that stretch out",
    "repeated_block": "again, bit for bit: .* cut the second out",
    "units": "times the gravity of the others, .* one unit",
    "sign_flip": "changed sign between the rest .* turn it back, or cut",
    "swapped_axes": "do not lie on one ellipsoid; .* cut the log there",
}

STEPS = {"bias_jump": (33, 35), "gain_change": (66, 67)}  # of fewer than 22 rests


def recording(name, seed):
    rng = np.random.default_rng([71, len(name), sum(map(ord, name)), seed])
    rec = bad_logs.good(rng)
    return rec if name == "good" else bad_logs.FAULTS[name](rec, rng)


def outcome(rec):
    """The result, or the words of the refusal."""
    try:
        return calibrate_log(rec.log), ""
    except SimvalError as error:
        return None, str(error)


@pytest.mark.ci
@pytest.mark.parametrize("name", WORDS)
def test_a_fault_is_refused_and_named(name):
    rec = recording(name, 4)
    with pytest.raises(RefusedError) as caught:
        calibrate_log(rec.log)
    assert re.search(WORDS[name], str(caught.value)), str(caught.value)
    assert re.search(r"from \d|between \d", str(caught.value))  # the time
    assert caught.value.exit_code == 3


@pytest.mark.ci
def test_good_logs_are_kept():
    for seed in range(2):
        rec = recording("good", seed)
        result, words = outcome(rec)
        assert result is not None, words
        assert not bad_logs.wrong(rec, result.fit)


def misled(rec):
    """Whether an answer is accepted that is wrong beyond six of its error bars."""
    result, _ = outcome(rec)
    return result is not None and bad_logs.wrong(rec, result.fit)


def require_flip_told(seed):
    """However small the bias and the misalignment, by which alone a flip is told."""
    rng = np.random.default_rng([57, seed])
    rec = bad_logs.good(rng, size=10 ** rng.uniform(-2.0, 0.0))
    flipped = bad_logs.FAULTS["sign_flip"](rec, rng)
    result, words = outcome(flipped)
    if result is not None:  # near the noise, and so is what it does
        assert not bad_logs.wrong(rec, result.fit), seed
    assert outcome(rec)[0] is not None, seed
    return "changed sign between the rest" in words


@pytest.mark.ci
def test_a_flipped_sign_is_told():
    assert sum(require_flip_told(seed) for seed in range(5)) >= 4


@pytest.mark.slow
def test_200_flipped_signs_are_told():
    assert sum(require_flip_told(seed) for seed in range(200)) >= 190


@pytest.mark.slow
@pytest.mark.parametrize("name", bad_logs.FAULTS)
def test_no_bad_log_is_accepted_with_a_wrong_answer(name):
    """60 of each of 19 kinds, 1140 in all: at most one of a kind, whatever it says."""
    assert sum(misled(recording(name, seed)) for seed in range(60)) <= 1


@pytest.mark.slow
def test_no_good_log_is_lost():
    """300 good logs, in counts or m/s^2, coarse or fine: not one refused or wrong."""
    lost = [seed for seed in range(300) if outcome(recording("good", seed))[0] is None]
    assert lost == []


def test_a_log_without_noise_is_refused_in_words():
    """Rests of one value each: nothing tells a rest from a stuck sensor."""
    for seed in range(3):
        rec = bad_logs.coarse(np.random.default_rng([83, seed]), 0.0, 0.05)
        result, words = outcome(rec)
        assert result is None
        assert re.search("do(es)? not vary at all.* (finer|coarse)", words)


@pytest.mark.slow
def test_coarse_logs_are_right_or_refused():
    """Noise of 0.05 to 0.3 counts: 150 logs, not one wrong beyond its error bars."""
    rngs = [np.random.default_rng([85, seed]) for seed in range(150)]
    assert not any(misled(bad_logs.coarse(rng, 0.05, 0.3)) for rng in rngs)


@pytest.mark.parametrize(
    ("name", "what"), [("bias_jump", "the bias of"), ("gain_change", "the scale of")]
)
def test_a_step_in_few_rests_is_named(name, what):
    """Fewer than 22 rests, no part of which can be judged by itself: 4 of 150 logs
    with a jump of a bias were accepted with a wrong answer."""
    said = []
    for seed in range(*STEPS[name]):
        rng = np.random.default_rng([900, len(name), sum(map(ord, name)), seed])
        rec = bad_logs.FAULTS[name](bad_logs.good(rng), rng)
        assert len(rec.holds) < 22
        said.append(outcome(rec)[1])
    assert all(re.search(f"{what} .* changed between the rest", s) for s in said), said


@pytest.mark.ci
@pytest.mark.parametrize(
    ("count", "said"),
    [(11, "so few rests do not tell"), (12, "changed between the rest")],
)
def test_a_jump_in_a_dozen_rests_is_refused(count, said):
    """One or two degrees of freedom say that something moved and not what; from three
    on a step is named. The same rests without a jump are accepted."""
    directions = fibonacci_sphere(count)
    words = []
    for seed in range(4):
        rng = np.random.default_rng([87, count, seed])
        rec = bad_logs.good(rng, poses=lambda rng: rng.permutation(directions))
        assert outcome(rec)[0] is not None
        result, refusal = outcome(bad_logs.FAULTS["bias_jump"](rec, rng))
        assert result is None
        words.append(refusal)
    assert any(said in refusal for refusal in words), words


@pytest.mark.ci
def test_a_spike_is_no_wrap_and_a_flip_no_fault():
    """A jump of the whole range that no rest takes part in, and a log that skips the
    turns between its rests, are what they are."""
    rec = recording("good", 4)
    x = rec.samples.copy()
    x[rec.holds[3, 0] - 20, 0] += 4 * np.ptp(x[:, 0])
    assert calibrate_log(bad_logs.with_rows(rec, x).log).fit.converged
    keep = np.concatenate([np.arange(*hold) for hold in rec.holds])
    assert calibrate_log(bad_logs.with_rows(rec, rec.samples[keep]).log).fit.converged


def of_few(count, seed):
    """A log of so many rests in random directions, and its sensor's measured noise."""
    rng = np.random.default_rng([91, count, seed])
    rec = bad_logs.good(rng, poses=lambda rng: random_directions(count, rng))
    rest = rec.samples[50] + rec.sigma * rng.standard_normal((20_000, 3))
    gravity = float(np.linalg.norm(rest.mean(axis=0)))
    known = NoiseFile(
        accelerometer=noise_of(rest, bad_logs.RATE), si_per_raw=None,
        gravity_raw=gravity,
    )  # fmt: skip
    return rec, known


@pytest.mark.ci
def test_few_rests_are_told_what_to_do_and_it_works():
    """Nine to twelve rests were refused with an argument that no command has."""
    told = helped = 0
    for count, seed in itertools.product(range(9, 13), range(3)):
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
        # 27 to 100 normal numbers: one seed in 1e4
        assert np.all(np.abs(fit.parameters - rec.sensor.parameters) < 5.5 * fit.sd)
    assert helped >= told / 2 >= 1


def test_advice_names_what_the_command_has():
    """Options and names in backticks that a refusal of a log gives exist."""
    options = {
        name: {o for p in command.params for o in p.opts}
        for name, command in (
            ("calibrate", calibrate.command),
            ("noise", noise.command),
        )
    }
    logs = [recording(name, 4) for name in bad_logs.FAULTS]
    logs += [of_few(count, 0)[0] for count in (9, 10)]
    said = [words for words in (outcome(rec)[1] for rec in logs) if words]
    assert len(said) > len(logs) / 2
    for words in said:
        with_noise = re.sub(r"simval noise [^)]*\)", "", words)
        assert set(re.findall(r"--[a-z][a-z-]*", with_noise)) <= options["calibrate"]
        others = set(re.findall(r"--[a-z][a-z-]*", words))
        assert others <= options["calibrate"] | options["noise"]
        assert not re.findall(r"`[a-z_]+(?:=[^`]*)?`", words), words
