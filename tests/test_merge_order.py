"""Sums of blocks are merged in one order, whichever thread ends first."""

from functools import reduce
from threading import Event

import numpy as np
import pytest

from simval.montecarlo import simulate
from simval.montecarlo.plain import batch_means, merged, summed, sums_of
from simval.streams import Streams, cell_key

BLOCKS, BATCH = 70, 4  # five groups of 16 blocks, the last one short


def means(number):
    """Batch means of a block, of sizes for which the order of sums shows."""
    rng = np.random.default_rng(number)
    return batch_means(10.0 ** (number % 7) * rng.standard_normal((3, 16)), BATCH)


def of_groups(size, order=lambda groups: groups):
    groups = [range(k, min(k + size, BLOCKS)) for k in range(0, BLOCKS, size)]
    parts = [np.concatenate([means(k) for k in group]) for group in groups]
    return reduce(merged, order([sums_of(part, BATCH) for part in parts]))


def same(a, b):
    equal = np.array_equal(a.mean, b.mean) and np.array_equal(a.scatter, b.scatter)
    return equal and (a.batches, a.batch) == (b.batches, b.batch)


def test_sums_are_of_sixteen_blocks_merged_from_the_first_on():
    found = summed(means, BLOCKS, BATCH, 1)
    assert same(found, of_groups(16))
    # power: another order and other groups are told apart by their bits
    assert not same(found, of_groups(16, lambda parts: parts[::-1]))
    assert not same(
        found, of_groups(16, lambda parts: [parts[1], parts[0], *parts[2:]])
    )
    assert not same(found, of_groups(15))
    assert not same(found, of_groups(17))
    # and they are the sums: mean and scatter of all batches at once
    every = np.concatenate([means(number) for number in range(BLOCKS)])
    off = every - every.mean(axis=0)
    # a few hundred sums of numbers up to the greatest
    size = np.abs(every).max(axis=0)
    assert np.all(np.abs(found.mean - every.mean(axis=0)) <= 1e-13 * size)
    np.testing.assert_allclose(
        found.scatter, off.T @ off, rtol=0, atol=1e-12 * np.outer(size, size).max()
    )


@pytest.mark.parametrize("last", [0, 1, 3])
@pytest.mark.parametrize("threads", [2, 5])
def test_a_group_that_ends_last_keeps_its_place(threads, last):
    """One group waits until all the others are done that may run without it."""
    expected, gate, done = summed(means, BLOCKS, BATCH, 1), Event(), []

    def held(number):
        if number == 16 * last:
            gate.wait(10.0)
        done.append(number)
        if len({k for k in done if k // 16 != last}) == BLOCKS - of_group(last):
            gate.set()
        return means(number)

    found = summed(held, BLOCKS, BATCH, threads)
    assert gate.is_set()
    assert done[-1] // 16 == last  # it was indeed the last one
    assert same(found, expected)


def of_group(number):
    return min(16, BLOCKS - 16 * number)


def test_each_block_has_the_stream_of_its_number():
    streams = Streams(3, cell_key("order"))
    drawn = []

    def sampler(rng, count):
        drawn.append(rng.standard_normal((2, count)))
        return drawn[-1]

    simulate(sampler, streams, samples=5 * 8, block=8, batch=2)
    for number, block in enumerate(drawn):
        np.testing.assert_array_equal(
            block, streams.block(number).standard_normal((2, 8))
        )
    assert len(drawn) == 5
