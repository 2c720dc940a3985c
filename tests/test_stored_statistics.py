"""A statistic that is read from a run: the field that is wrong is the one named."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simval.results import Row
from simval.statistics import BIAS, FAMILIES, Statistic
from simval.sweep.documents import DamagedError
from simval.sweep.entries import NAMED, row_entries
from simval.sweep.plausible import name_of, row_of, statistic_of

GOOD = Row(statistic=BIAS("x"), value=0.5, standard_error=0.1, n=300, check="plain")
WORDS = "it must be a JSON list of words"
PRINTABLE = "it must be a printable text of at most 10000 characters"
FAMILY = (
    "it must be a family of statistics of this version; read it with the version of "
    "simval that wrote it, or sweep anew"
)


def entry(**changed):
    """A stored row with some fields that are not as they were."""
    fields = dict(zip(NAMED, row_entries(0, [GOOD])[0][1:], strict=True))
    assert changed.keys() <= fields.keys()
    return tuple({**fields, **changed}.values())


@pytest.mark.parametrize(
    ("field", "given", "words"),
    [
        ("family", "invented", FAMILY),
        ("family", None, FAMILY),
        ("family", b"bias", FAMILY),
        ("entries", "[", WORDS),
        ("entries", "[[1]]", WORDS),
        ("entries", '["\\u0000"]', WORDS),
        # a word and the keys of an object fall apart into words, but are no list
        ("entries", '"xy"', WORDS),
        ("entries", '{"x": 1}', WORDS),
        ("controlled", 2, "it must be 0 or 1"),
        ("unit", "\x00", PRINTABLE),
        ("unit", 7, PRINTABLE),
    ],
)
def test_the_field_that_is_wrong_is_the_one_named(field, given, words):
    shown = "missing" if given is None else repr(given)
    with pytest.raises(DamagedError) as refused:
        row_of(entry(**{field: given}))
    assert str(refused.value) == f"`{field}` is {shown}; {words}"


def test_a_good_row_is_read_as_it_was_written():
    assert row_of(entry()) == GOOD


names = st.text(st.characters(exclude_categories=("C", "Z")), max_size=8)


@given(st.sampled_from(sorted(FAMILIES)), st.lists(names, max_size=3), st.booleans())
def test_every_statistic_is_read_as_it_was_written(family, entries, controlled):
    written = Statistic(FAMILIES[family], tuple(entries), controlled, "m")
    stored = row_entries(0, [Row(statistic=written, value=0.5)])[0]
    assert statistic_of(*stored[2:6]) == written


def test_a_row_that_cannot_be_read_is_named_by_its_family():
    assert name_of(entry()) == str(BIAS("x"))
    assert name_of(entry(entries="[")) == "bias"
    assert name_of(entry(family="invented")) == "invented"
