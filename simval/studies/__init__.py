"""The studies: named experiments, one module each. Read this first.

A study wires the layers below it into one experiment:

    scene -> readings -> algorithm -> errors -> moments, against theory's prediction

It is a module with four names:

- ``TITLE``: one line for people;
- ``Parameters``: a pydantic model (subclass of `StudyParameters`) of one cell's
  parameters, scalars only, each with its unit in the description and a default, and
  with ``cost()``, the expected `Cost` of a cell;
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

A user's own is such a module outside the package: a file that `bring` adds under its
name, as `simval sweep --study FILE` does, or an entry point of the group
``simval.studies``. Files stand in the environment, so that each process that is started
from here has them, too.
"""

import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import import_module, metadata
from pathlib import Path

from simval import vocabulary
from simval.arguments import instance
from simval.errors import InputError
from simval.studies.study import Cost, Study, StudyParameters, study_of
from simval.text import did_you_mean

__all__ = ["STUDIES", "Study", "StudyParameters", "bring", "brought", "find_study"]

GROUP = "simval.studies"
FILES = "SIMVAL_STUDIES"
"""Variable of the environment with the files of a user's studies."""


def brought() -> dict[str, Path]:
    """Files of a user's studies, by the studies' names."""
    listed = os.environ.get(FILES, "").split(os.pathsep)
    return {Path(each).stem: Path(each) for each in listed if each}


def _reach(folders: Iterable[Path]) -> None:
    # modules of the package come first, and what a study imports from its own folder
    for folder in map(str, folders):
        for path in (__path__, sys.path):
            if folder not in path:
                path.append(folder)


_reach(file.parent for file in brought().values())


@cache
def _installed() -> dict[str, metadata.EntryPoint]:
    return {point.name: point for point in metadata.entry_points(group=GROUP)}


@cache
def _study(name: str) -> Study:
    if name in vocabulary.STUDIES:
        return study_of(name, import_module(f"simval.studies.{name}"))
    source = brought().get(name, name)
    try:
        if name in brought():
            found = study_of(name, import_module(f"simval.studies.{name}"))
        else:
            found = study_of(name, _installed()[name].load())
        instance("cost()", found.parameters().cost(), Cost)
    except (Exception, SystemExit) as error:  # whatever a user's file may raise
        msg = f"study {source} cannot be used: {type(error).__name__}: {error}"
        raise InputError(msg) from error
    return found


class _Studies(Mapping[str, Study]):
    """The studies by their names."""

    def __getitem__(self, name: str) -> Study:
        if name not in self:
            raise KeyError(name)
        return _study(name)

    def __contains__(self, name: object) -> bool:
        return name in vocabulary.STUDIES or name in brought() or name in _installed()

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys((*vocabulary.STUDIES, *brought(), *_installed())))

    def __len__(self) -> int:
        return sum(1 for _ in self)


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


def bring(files: Iterable[str | Path]) -> None:
    """Add the studies of a user's files, here and in every process started from here.

    Parameters
    ----------
    files : iterable of str or Path
        Modules as `simval.studies` describes them; a study has its file's name.

    Raises
    ------
    InputError
        If a file cannot be read or imported, its name is taken or is no name of a
        module, or it lacks one of the names that a study has.
    """
    for file in map(Path, files):
        name, own = file.stem, Path(__file__).parent
        if not (file.suffix == ".py" and file.is_file()):
            msg = f"study {file} is not a Python file; give the path of its module"
            raise InputError(msg)
        why = "" if name.isidentifier() else "no name of a module"
        if (own / file.name).exists():
            why = "the name of a module of simval"
        elif name in ("title", "seed", "question", "need") or hasattr(
            StudyParameters, name
        ):
            why = "no key that a suite can have"
        if why:
            msg = f"study {file}: `{name}` is {why}; rename the file"
            raise InputError(msg)
        before, known = os.environ.get(FILES, ""), brought() | {name: file.absolute()}
        os.environ[FILES] = os.pathsep.join(map(str, known.values()))
        _reach([file.absolute().parent])
        try:
            _study(name)
        except InputError:
            os.environ[FILES] = before
            raise
