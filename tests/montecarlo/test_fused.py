"""Trials in one compiled pass: equal bits, right normals, the formula's own errors."""

import importlib.util
import shutil
import subprocess
import sysconfig
from itertools import pairwise
from pathlib import Path

import mpmath
import numpy as np
import pytest
from places import ROOT
from scipy import stats

from simval.errors import InputError
from simval.geometry import attitude_matrix
from simval.imu.attitude.kernel import FRAMES, normalize_columns, raw_quaternion
from simval.montecarlo import compiled, fused, moments_of, simulate_closed_form
from simval.montecarlo.plain import batch_means, sums_of
from simval.streams import Streams, cell_key
from simval.studies import attitude
from simval.studies.attitude import random_geometry
from simval.theory import attitude_moments

STREAMS = Streams(7, cell_key("test"))
needs_block = pytest.mark.skipif(
    not compiled(),
    reason="the compiled block is not there: no compiler at installation",
)


def words(batches, block=0, streams=STREAMS):
    return fused.draws(fused.lanes(streams, block), batches)


def numpy_form(block, batches, mean, noise, q):
    x = fused.normals(words(batches, block))
    return fused.averages(x, mean, noise, q)


def test_the_block_is_there_where_a_compiler_is():
    if shutil.which("cc") is None:
        pytest.skip("no compiler here")
    assert compiled(), "install again: make .venv/installed"


class Other:
    """A compiled block with the bits of another source in some of its batches."""

    def __init__(self, factor, *batches):
        self.factor, self.batches_off = factor, slice(*batches)

    def batches(self, state, mean, noise, q, out):
        out[:] = fused.in_numpy(state, len(out), mean, noise, q)
        out[self.batches_off] *= self.factor


def test_a_block_with_other_bits_is_not_used(monkeypatch):
    assert fused.TRIED * fused.BATCH >= attitude.BLOCK
    assert fused.reproduces(Other(1.0, None))
    for batches in [(None,), (1,), (200, None), (-1, None), (fused.TRIED // 2, -1)]:
        assert not fused.reproduces(Other(1.0 + 2.0**-52, *batches)), batches
    assert not fused.reproduces(object())
    monkeypatch.setattr(fused, "import_module", lambda name: Other(1.1, None))
    with pytest.warns(RuntimeWarning, match="install simval again"):
        assert fused._compiled.__wrapped__() is None


def test_without_the_block_all_numbers_are_the_same(monkeypatch):
    known = (np.arange(12.0)[:, None], "z", np.ones(4), 0.1, STREAMS)
    here = simulate_closed_form(*known, samples=40 * 256, block=512)
    monkeypatch.setattr(fused, "_compiled", lambda: None)
    there = simulate_closed_form(*known, samples=40 * 256, block=512)
    assert np.array_equal(here.mean, there.mean)
    assert np.array_equal(here.scatter, there.scatter)


FLAGS = ["-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
ONE_WIDTH = "-DANY_WIDTH="


def built(folder, *flags):
    """The block compiled in another way."""
    library = folder / "_simval_fused.so"
    source = ROOT / "simval" / "montecarlo" / "fused.c"
    include = "-I" + sysconfig.get_path("include")
    words = ["cc", *flags, include, "-shared", "-fPIC", source, "-o", library, "-lm"]
    subprocess.run(words, check=True)
    spec = importlib.util.spec_from_file_location("_simval_fused", library)
    block = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(block)
    return block


@pytest.mark.ci
@needs_block
@pytest.mark.parametrize(
    "flags",
    [["-O0"], ["-O3", ONE_WIDTH, "-mavx2"],
     ["-O3", ONE_WIDTH, "-march=native"], ["-O3", "-funroll-loops"]],
    ids=" ".join,
)  # fmt: skip
def test_no_width_of_registers_and_no_level_changes_a_bit(tmp_path, flags):
    assert fused.reproduces(built(tmp_path, *flags, *FLAGS))


@pytest.mark.ci
@needs_block
@pytest.mark.skipif(
    not Path("/proc/cpuinfo").exists()
    or " fma " not in Path("/proc/cpuinfo").read_text(),
    reason="this processor contracts nothing",
)
def test_contraction_would_change_bits_and_is_found(tmp_path):
    contracted = ["-O3", ONE_WIDTH, "-march=native", "-ffp-contract=fast"]
    assert not fused.reproduces(built(tmp_path, *contracted))


@needs_block
@pytest.mark.parametrize("block", range(6))
def test_both_forms_have_the_same_bits(block):
    rng = np.random.default_rng(block)
    mean, q = rng.standard_normal(9), rng.standard_normal(4)
    noise = 10.0 ** rng.uniform(-3, 2)
    batches = [1, 2, 15, 16, 17, fused.TRIED][block]  # those of a real block, too
    known = {"mean": mean, "noise": noise, "q": q}
    found = fused.batch_means_of(STREAMS, block, batches, **known)
    assert np.array_equal(found, numpy_form(block, batches, mean, noise, q))
    # power: one normal in 2304 that is off by 1e-9 is another mean
    x = fused.normals(words(batches, block))
    x[:, 5] *= 1.0 + 1e-9
    assert not np.array_equal(found, fused.averages(x, mean, noise, q))


def test_the_words_are_those_of_numpys_own_generator():
    # the state machine written out: what the compiled block does, step by step
    state = fused.lanes(STREAMS, 3)
    a, b, c, count = (list(map(int, row)) for row in state)
    mask, first = 2**64 - 1, []
    for step in range(fused.WARM + 4):
        out = [(x + y + n) & mask for x, y, n in zip(a, b, count, strict=True)]
        count = [n + 1 for n in count]
        a = [y ^ (y >> 11) for y in b]
        b = [(z + (z << 3)) & mask for z in c]
        turned = [((z << 24) | (z >> 40)) & mask for z in c]
        c = [(z + x) & mask for z, x in zip(turned, out, strict=True)]
        if step >= fused.WARM:
            first += out
    assert fused.draws(state, 1).ravel()[: len(first)].tolist() == first


def test_the_normals_are_box_and_mullers():
    raw = words(8)
    half = raw.shape[1] // 2
    u = 1.0 - (raw[:, :half] >> np.uint64(12)) * 2.0**-52
    angle = raw[:, half:]
    within = ((angle << np.uint64(3)) >> np.uint64(12)) * 2.0**-52
    octant = (angle >> np.uint64(61)).astype(int)
    # cosine and sine of the angle in its octant: swapped, then each with its sign
    t = within * np.pi / 4
    c, s = np.cos(t), np.sin(t)
    swap = octant // 4 == 1
    c, s = np.where(swap, s, c), np.where(swap, c, s)
    c, s = np.where(octant // 2 % 2, -c, c), np.where(octant % 2, -s, s)
    radius = np.sqrt(-2.0 * np.log(u))
    expected = np.hstack([radius * c, radius * s])
    # some ten roundings of 2^-53 in each factor; t near 0 or u near 1 is as exact
    np.testing.assert_allclose(fused.normals(raw), expected, rtol=2e-15, atol=0)


def test_the_ends_of_the_words():
    ends = np.array([0, 2**64 - 1, 2**63, 2**12 - 1, 2**12], dtype=np.uint64)
    radii, angles = np.meshgrid(ends, ends)
    x = fused.normals(np.hstack([radii.ravel(), angles.ravel()])[None])
    assert np.isfinite(x).all()
    # u of 2^-52 gives the greatest normal, u of 1 gives zero
    assert np.abs(x).max() == pytest.approx(np.sqrt(104 * np.log(2)), rel=1e-14)
    assert np.abs(x[0, radii.ravel().size :][radii.ravel() < 2**12]).max() == 0.0


@pytest.mark.parametrize("frame", FRAMES)
def test_the_trials_are_those_of_the_closed_form(frame):
    rng = np.random.default_rng(2)
    vectors, q = rng.standard_normal((12, 1)), rng.standard_normal(4)
    noise, batches = 0.3, 4
    sums = simulate_closed_form(
        vectors, frame, q, noise, STREAMS, samples=1, block=256 * batches
    )
    # vectors whose sums and differences have this noise: that of r is minus or plus b's
    x = fused.normals(words(batches)).reshape(batches, 9, 256)
    d1, s1, d2 = x.transpose(1, 0, 2).reshape(3, 3, -1) * np.sqrt(2) * noise
    turn = np.array([1.0 if frame in ("plain", k) else -1.0 for k in "xyz"])[:, None]
    drawn = vectors + np.concatenate(
        [(s1 + d1) / 2, d2 / 2, turn * (s1 - d1) / 2, -turn * d2 / 2]
    )
    errors = q[:, None] - normalize_columns(raw_quaternion(drawn, frame))
    expected = sums_of(batch_means(errors, 256), 256)
    # rounding: a hundred operations of 2^-53 on errors of length 1
    np.testing.assert_allclose(sums.mean, expected.mean, rtol=0, atol=1e-14)
    np.testing.assert_allclose(sums.scatter, expected.scatter, rtol=0, atol=1e-13)


@pytest.mark.ci
def test_moments_of_the_normals_to_the_eighth():
    x = np.concatenate([fused.normals(words(64, k)).ravel() for k in range(8)])
    limit = stats.norm.isf(1e-4 / (2 * 8))
    moments = {1: 0, 2: 1, 3: 0, 4: 3, 5: 0, 6: 15, 7: 0, 8: 105}

    def apart(x):
        return [
            (np.mean(x**k) - expected) / (np.std(x**k) / np.sqrt(len(x)))
            for k, expected in moments.items()
        ]

    assert np.abs(apart(x)).max() < limit
    assert np.abs(apart(1.005 * x)).max() > limit  # power: half a per cent too wide
    # and the whole law: a Kolmogorov test at 1e-4, which a shift of 0.01 fails
    assert stats.kstest(x, "norm").pvalue > 1e-4
    assert stats.kstest(x + 0.01, "norm").pvalue < 1e-4


def test_the_steps_of_the_radius_are_not_felt():
    def missing(k, h):
        # what eq. (-2 ln u)^k loses by its sum at most: a step, and the integral to it
        f = lambda u: (-2 * mpmath.log(u)) ** k  # noqa: E731
        return h * f(h) + mpmath.quad(f, [0, h / 1000, h / 10, h])

    # at coarse steps the loss is counted, and is below what it may be
    h = mpmath.mpf(2) ** -10
    for k in (1, 2, 3, 4):
        whole = 2**k * mpmath.factorial(k)
        total = h * mpmath.fsum((-2 * mpmath.log(j * h)) ** k for j in range(1, 1025))
        assert 0 < whole - total < missing(k, h)
        assert missing(k, mpmath.mpf(2) ** -52) / whole < 4e-11


def test_the_bits_of_the_words_are_fair_and_apart():
    """Each bit of each lane, and the distance of neighbours in lane, time and block."""
    raw = np.stack([words(48, k).reshape(-1, fused.LANES) for k in range(4)])
    limit = stats.norm.isf(
        1e-4 / (2 * 64 * 64)
    )  # one false alarm in 1e4 seeds, as below
    law = stats.binom(64, 0.5)
    classes = np.arange(22, 43)  # each with 2e3 pairs or more; the tails in its ends
    chances = law.pmf(classes)
    chances[0], chances[-1] = law.cdf(22), law.sf(41)

    def lopsided(raw):
        bits = np.unpackbits(raw.view(np.uint8), axis=-1).reshape(-1, 64 * 64)
        return np.abs((bits.mean(axis=0) - 0.5) * 2 * np.sqrt(len(bits))).max()

    def chances_of(raw):
        apart = [raw[:, :, 1:] ^ raw[:, :, :-1], raw[:, 1:] ^ raw[:, :-1]]
        apart += [raw[1:] ^ raw[:-1]]
        for words in apart:
            distance = np.clip(np.bitwise_count(words).ravel(), 22, 42)
            counts = np.bincount(distance, minlength=43)[22:]
            yield stats.chisquare(counts, chances * counts.sum()).pvalue

    assert lopsided(raw) < limit
    assert min(chances_of(raw)) > 1e-4 / 3
    # power: a lane with a bit set in one word more of eight; a lane that shares the
    # upper half of every fourth word with its neighbour
    tilted = raw.copy()
    tilted[:, ::8, 7] |= np.uint64(1)
    assert lopsided(tilted) > limit
    tied = raw.copy()
    low = np.uint64(0xFFFFFFFF)
    tied[:, ::4, 7] = (raw[:, ::4, 6] & ~low) | (raw[:, ::4, 7] & low)
    assert min(chances_of(tied)) < 1e-4 / 3


@pytest.mark.ci
@pytest.mark.parametrize(("geometry", "sigma"), [(3, 0.05), (7, 0.3), (11, 0.01)])
def test_eight_million_trials_have_the_exact_moments(geometry, sigma):
    q, r1, r2 = random_geometry(geometry)
    exact = attitude_moments(q, r1, r2, sigma, order="exact")
    A = attitude_matrix(q)
    truth = np.stack([A @ r1, A @ r2, r1, r2]).reshape(12, 1)
    found = moments_of(
        simulate_closed_form(
            truth, str(exact.frame), exact.q_true, sigma, STREAMS,
            samples=2**23, block=2**14,
        )
    )  # fmt: skip
    limit = stats.norm.isf(1e-4 / (2 * 14))
    upper = np.triu_indices(4)

    def apart(covariance):
        error = (found.covariance - covariance) / found.covariance_error
        return np.append((found.bias - exact.bias) / found.bias_error, error[upper])

    assert np.abs(apart(exact.covariance)).max() < limit
    assert (
        np.abs(apart(1.005 * exact.covariance)).max() > limit
    )  # power: 0.25 % of noise


def test_lanes_blocks_and_pairs_are_independent():
    blocks = [fused.normals(words(16, k)) for k in range(16)]
    raw = [words(16, k).reshape(-1, fused.LANES).T.astype(float) for k in range(16)]
    n = blocks[0].size

    def correlation(a, b):
        return np.corrcoef(a, b)[0, 1] * np.sqrt(len(a))

    half = blocks[0].shape[1] // 2
    found = [correlation(a.ravel(), b.ravel()) for a, b in pairwise(blocks)]
    found += [correlation(a.ravel()[:-1], a.ravel()[1:]) for a in blocks]
    found += [correlation(a[:, :half].ravel(), a[:, half:].ravel()) for a in blocks]
    squares = [b**2 for b in blocks]
    found += [correlation(a[:, :half].ravel(), a[:, half:].ravel()) for a in squares]
    for each in raw:
        lanes = np.corrcoef(each)[np.triu_indices(fused.LANES, 1)]
        found += list(lanes * np.sqrt(each.shape[1]))
    limit = stats.norm.isf(1e-4 / (2 * len(found)))
    assert np.abs(found).max() < limit
    mixed = blocks[0].ravel() + 0.05 * blocks[1].ravel()
    assert abs(correlation(mixed, blocks[1].ravel())) > limit, n  # power


RIGHT = {
    "vectors": np.arange(12.0)[:, None], "frame": "x", "q": np.ones(4),
    "noise_std": 0.1, "streams": STREAMS, "samples": 512, "block": 256, "threads": 1,
}  # fmt: skip


@pytest.mark.parametrize("form", ["compiled", "NumPy"])
def test_a_block_of_part_batches_and_no_attitude_are_refused(form, monkeypatch):
    if form == "NumPy":
        monkeypatch.setattr(fused, "_compiled", lambda: None)
    simulate_closed_form(**RIGHT)
    no_attitude = {"vectors": np.zeros((12, 1)), "noise_std": 0.0}
    for wrong, words in (({"block": 255}, "block"), (no_attitude, "vectors")):
        with pytest.raises(InputError, match=words):
            simulate_closed_form(**RIGHT | wrong)


def test_samples_are_rounded_up_to_whole_blocks():
    # one trial, a trial more than a block, and no multiple of lanes, batch or block
    for samples, blocks in ((1, 1), (512, 1), (513, 2), (1537, 4)):
        given = {**RIGHT, "samples": samples, "block": 512}
        assert simulate_closed_form(**given).samples == 512 * blocks


@needs_block
def test_the_block_refuses_what_is_no_argument():
    rng = np.random.default_rng(1)
    state = fused.lanes(STREAMS, 0)
    right = [state, np.ones(9), 0.1, np.ones(4), np.empty((3, 14))]
    fused._compiled().batches(*right)
    for _ in range(300):  # of any shape and kind at random
        given = list(right)
        for place in rng.integers(0, 5, size=rng.integers(1, 4)):
            shape = tuple(rng.integers(0, 20, size=rng.integers(0, 4)))
            kind = rng.choice(["f8", "f4", "u8", "i8", "u1", "c16", ">f8"])
            given[place] = np.zeros(shape, dtype=kind)
        try:
            fused._compiled().batches(*given)
        except (ValueError, TypeError, BufferError):
            continue
        assert given[0].nbytes == 4 * 8 * fused.LANES
        assert given[4].nbytes % (14 * 8) == 0
