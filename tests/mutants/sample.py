"""A seeded sample of one-line faults per package, and the survivors among them.

mutmut writes every mutant of every undecorated function into `mutants/` and runs, for
each one asked for, the tests that reach its function, fastest first. It has no sample,
no list of survivors that are known to be harmless, and no limit: these are here.

    python tests/mutants/sample.py --count 200 --seed 1 attitude theory

A survivor is known by its function and its changed line, not by a number, in
`kept.toml` beside this file, with the reason why it may live. The exit code is 1 if the
others are more than 5 % of a package's sample.
"""

import argparse
import re
import subprocess
import sys
import tomllib
from contextlib import redirect_stdout
from fnmatch import fnmatch
from io import StringIO
from pathlib import Path
from random import Random

from mutmut import __main__ as mutmut
from mutmut.configuration import config
from mutmut.mutation.data import SourceFileMutationData
from mutmut.mutation.diff_apply import get_diff_for_mutant
from mutmut.stats import status_by_exit_code
from mutmut.utils.format_utils import orig_function_and_class_names_from_key
from scipy.stats import binomtest

LIMIT = 0.05
KEPT = Path(__file__).with_name("kept.toml")
SURVIVED = ("survived", "no tests", "not checked", "suspicious", "skipped")
# words of a type, of a contract between two lines, and of a message (with a space)
UNCOUNTED = re.compile(r"\b(dtype|strict)=[\w.]+|\"[^\"]* [^\"]*\"|[,\s]")

Change = tuple[str, str, str]  # function, the line as it was, the line as it is now


def packages() -> dict[str, str]:
    """Name of each package that is mutated, and the pattern of its files."""
    return {Path(p.removesuffix("/*")).stem: p for p in config().only_mutate}


def generated(pattern: str) -> dict[str, Path]:
    """All mutants of a package, and the file of each."""
    found = {}
    for path in sorted(Path("simval").rglob("*.py")):
        if fnmatch(str(path), pattern):
            data = SourceFileMutationData(path=path)
            data.load()
            found.update(dict.fromkeys(sorted(data.exit_code_by_key), path))
    return found


def change(name: str, path: Path) -> Change:
    """What a mutant changes, in words that do not move with the lines above it."""
    lines = get_diff_for_mutant(name, path=path).splitlines()[2:]
    was, now = (
        " ".join(line[1:].strip() for line in lines if line.startswith(sign))
        for sign in "-+"
    )
    function, owner = orig_function_and_class_names_from_key(name)
    module = ".".join(path.with_suffix("").parts)
    return ".".join(part for part in (module, owner, function) if part), was, now


def drawn(pattern: str, count: int, seed: str) -> dict[str, Change]:
    """A random sample of the mutants that count."""
    paths = generated(pattern)
    names = list(paths)
    Random(seed).shuffle(names)
    sample: dict[str, Change] = {}
    for name in names:
        if count and len(sample) == count:
            break
        what = change(name, paths[name])
        if UNCOUNTED.sub("", what[1]) != UNCOUNTED.sub("", what[2]):
            sample[name] = what
    return sample


def survivors(pattern: str, sample: dict[str, Change]) -> dict[str, Change]:
    """The mutants of a sample that no test saw when they were last run."""
    codes: dict[str, int | None] = {}
    for path in set(generated(pattern).values()):
        data = SourceFileMutationData(path=path)
        data.load()
        codes |= data.exit_code_by_key
    return {
        name: what
        for name, what in sample.items()
        if status_by_exit_code[codes[name]] in SURVIVED
    }


def kept() -> set[Change]:
    """Survivors that may live, from the kept list."""
    entries = tomllib.loads(KEPT.read_text(encoding="utf-8"))["kept"]
    assert all(entry["why"] for entry in entries)
    return {(entry["function"], entry["was"], entry["now"]) for entry in entries}


def judged(package: str, sample: dict[str, Change], alive: list[Change]) -> bool:
    """Print one package's line and its unexplained survivors; whether it is good."""
    known = kept()
    unexplained = [what for what in alive if what not in known]
    n = len(sample)
    interval = binomtest(len(unexplained), n).proportion_ci(method="exact")
    print(
        f"{package:11} {n:5} mutants, {n - len(alive):5} seen, "
        f"{len(alive) - len(unexplained):3} kept, {len(unexplained):3} unexplained "
        f"({len(unexplained) / n:.1%}, 95 %: {interval.low:.1%} to {interval.high:.1%})"
    )
    for function, was, now in sorted(unexplained):
        print(f"    {function}\n      - {was}\n      + {now}")
    for function, was, now in sorted(known & set(sample.values()) - set(alive)):
        print(f"    kept, yet seen: {function}\n      - {was}\n      + {now}")
    return len(unexplained) <= LIMIT * n


def main() -> int:
    """Draw, run and judge the sample."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("packages", nargs="*", help="which; default, all")
    parser.add_argument("--count", type=int, default=200, help="of each; 0 for all")
    parser.add_argument("--seed", default="1", help="of the sample")
    parser.add_argument(
        "--again", action="store_true", help="run only what was not seen the last time"
    )
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time")
    options = parser.parse_args()
    patterns = packages()
    chosen = options.packages or list(patterns)
    if unknown := set(chosen) - set(patterns):
        parser.error(f"no package {sorted(unknown)}; there are {sorted(patterns)}")
    Path("mutants").mkdir(exist_ok=True)
    with redirect_stdout(StringIO()):  # it prints the name of each file
        mutmut.copy_src_dir()
        mutmut.copy_also_copy_files()
        mutmut.create_mutants(options.jobs)
    samples = {
        name: drawn(patterns[name], options.count, f"{options.seed} {name}")
        for name in chosen
    }
    names = [
        name
        for package, sample in samples.items()
        for name in (survivors(patterns[package], sample) if options.again else sample)
    ]
    run = ["mutmut", "run", "--max-children", str(options.jobs), *names]
    with Path("mutants/run.log").open("w", encoding="utf-8") as log:
        done = subprocess.run(
            [str(Path(sys.executable).with_name(run[0])), *run[1:]],
            stdout=log,
            stderr=subprocess.STDOUT,
            check=False,
        )
    if done.returncode:
        print("mutmut could not run; see mutants/run.log")
        return 2
    good = [
        judged(name, sample, list(survivors(patterns[name], sample).values()))
        for name, sample in samples.items()
    ]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
