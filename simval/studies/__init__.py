"""The studies: named experiments, one module each. Read this first.

A study wires the layers below it into one experiment:

    scene -> readings -> algorithm -> errors -> moments, against theory's prediction

It is a module with four names:

- ``TITLE``: one line for people;
- ``Parameters``: a pydantic model (subclass of `StudyParameters`) of one cell's
  parameters, scalars only, each with its unit in the description and a default, and
  with ``cost()``, the expected cost of a cell;
- ``run(parameters, streams) -> Outcome``: a pure function of these parameters and
  of the cell's random streams (``streams.block(i)`` is the generator of block i).
  It returns rows (`simval.results`) of statistics (`simval.statistics`), and
  artifacts for the report;
- ``SECTION``: the section of the report that shows it, or None: then it is among the
  further studies.

Where it has ``FIGURES``, the report draws these (`simval.figures`: data, no drawing),
else its numbers along what varies; ``ABOUT`` stands above them.

A study of a user's algorithm states a `Problem` (`simval.studies.plugin`): how it is
probed, its trials and its rows. Its ``run`` is that of all such studies, for which a
child process answers, as is a fifth name, ``compute``, for which this one does.

What studies share: `simval.studies.trials` runs trials in blocks and judges the noise
in them, `simval.studies.response` is how any estimator answers its readings, and the
control variates that follow from it.

To add a study, write the module and put its name into `simval.vocabulary.STUDIES`;
suites, the command line, the gate and the report take it from there. A module is
imported when its study is asked for: the child process of a plug-in needs no other. A
study never plots, prints or judges.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module

from simval import vocabulary
from simval.errors import InputError
from simval.studies.study import Study, StudyParameters, study_of
from simval.text import did_you_mean

__all__ = ["STUDIES", "Study", "StudyParameters", "find_study"]


@cache
def _study(name: str) -> Study:
    return study_of(import_module(f"simval.studies.{name}"))


class _Studies(Mapping[str, Study]):
    """The studies by their names."""

    def __getitem__(self, name: str) -> Study:
        if name not in vocabulary.STUDIES:
            raise KeyError(name)
        return _study(name)

    def __contains__(self, name: object) -> bool:
        return name in vocabulary.STUDIES

    def __iter__(self) -> Iterator[str]:
        return iter(vocabulary.STUDIES)

    def __len__(self) -> int:
        return len(vocabulary.STUDIES)


STUDIES: Mapping[str, Study] = _Studies()


def find_study(name: str) -> Study:
    """Find a study by its name.

    Parameters
    ----------
    name : str
        A key of `STUDIES`.

    Returns
    -------
    Study
        The study.

    Raises
    ------
    InputError
        If there is no such study; the message lists those there are.
    """
    if name not in STUDIES:
        near = did_you_mean(name, STUDIES)
        msg = f"there is no study `{name}`{near}; the studies are {', '.join(STUDIES)}"
        raise InputError(msg)
    return STUDIES[name]
