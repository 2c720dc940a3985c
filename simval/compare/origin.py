"""Where a run comes from: its folder, suite, seeds, commit and dates, in words."""

from dataclasses import dataclass

from simval.sweep.run import Run

SHORT = 10
"""Digits of a commit that a person needs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Where a run comes from.

    Attributes
    ----------
    name : str
        Name of its folder.
    suite : str
        Name of its suite.
    seeds : tuple of int
        Its seeds.
    commit : str
        The first digits of the commit, ``+`` where files were changed; empty where
        it is not known.
    committed, started : str
        When the commit and the run were made, ISO 8601; empty where not known.
    """

    name: str
    suite: str
    seeds: tuple[int, ...]
    commit: str
    committed: str
    started: str

    @property
    def label(self) -> str:
        """The commit, else the folder."""
        return self.commit or self.name

    @property
    def words(self) -> str:
        """All of it in one line; of a date the day."""
        when = self.committed or self.started
        of = " of " if self.committed else ", run on "
        commit = f"commit {self.commit}" if self.commit else "commit unknown"
        seeds = ", ".join(map(str, self.seeds)) or "none"
        return (
            f"{self.name}: suite {self.suite or 'unknown'}, seeds {seeds}, "
            f"{commit}{of + when[:10] if when else ''}"
        )


def origin_of(run: Run) -> Origin:
    """Read from a run where it comes from."""
    git = run.manifest.get("git", {})
    commit = str(git.get("commit") or "")[:SHORT]
    return Origin(
        name=run.folder.resolve().name,
        suite=str(run.manifest.get("suite", "")),
        seeds=tuple(sorted({cell.seed for cell in run.cells})),
        commit=f"{commit}+" if commit and git.get("dirty") else commit,
        committed=str(run.timing.get("committed") or ""),
        started=str(run.timing.get("started") or ""),
    )
