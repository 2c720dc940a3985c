"""The compiled block under AddressSanitizer and UndefinedBehaviorSanitizer.

`make sanitize`, a part of `make nightly`: the block is compiled again with both, loaded
in an interpreter of its own, held to the NumPy form's bits, and given 20 000 random
sets of arguments. Either sanitizer ends the process at its first finding.
"""

import importlib.util
import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "simval" / "montecarlo" / "fused.c"
FLAGS = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all",
         "-ffp-contract=off", "-shared", "-fPIC")  # fmt: skip
CASES = 20_000


def compile_and_run():
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "_simval_fused.so"
        include = "-I" + sysconfig.get_path("include")
        subprocess.run(
            ["cc", *FLAGS, include, SOURCE, "-o", library, "-lm"], check=True
        )
        found = [
            subprocess.run(
                ["cc", f"-print-file-name={name}"],
                check=True, capture_output=True, text=True,
            ).stdout.strip()
            for name in ("libasan.so", "libubsan.so")
        ]  # fmt: skip
        environment = {
            **os.environ,
            "LD_PRELOAD": " ".join(found),
            "ASAN_OPTIONS": "detect_leaks=0",  # the interpreter's own
        }
        done = subprocess.run(
            [sys.executable, __file__, library], env=environment, check=False
        )
    sys.exit(done.returncode)


def attack(library):
    import numpy as np

    from simval.montecarlo import fused
    from simval.streams import Streams, cell_key

    spec = importlib.util.spec_from_file_location("_simval_fused", library)
    block = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(block)
    rng, streams = np.random.default_rng(1), Streams(1, cell_key("sanitized"))
    right = [fused.lanes(streams, 0), np.ones(9), 0.1, np.ones(4), np.empty((3, 14))]
    block.batches(*right)
    expected = fused.in_numpy(fused.lanes(streams, 0), 3, *right[1:4])
    if not np.array_equal(right[4], expected):
        sys.exit("the block has other bits than the NumPy form")
    kinds = ["f8", "f4", "u8", "i8", "u1", "c16", ">f8", "?"]
    things = [None, "text", b"x" * 72, 1.0, float("nan"), [1.0] * 9, memoryview(b"")]
    accepted = 0
    for _ in range(CASES):
        given = list(right)
        for place in rng.integers(0, 5, size=rng.integers(1, 5)):
            shape = tuple(rng.integers(0, 20, size=rng.integers(0, 4)))
            values = np.frombuffer(
                rng.bytes(16 * int(np.prod(shape, dtype=int))), dtype="u1"
            ).copy()
            array = np.resize(values, (*shape, 16))[..., :8].copy()
            array = array.view(rng.choice(kinds[:1])) if rng.random() < 0.5 else (
                np.zeros(shape, dtype=rng.choice(kinds))
            )  # fmt: skip
            array = array[::2] if array.ndim and rng.random() < 0.2 else array
            pick = things[rng.integers(len(things))] if rng.random() < 0.2 else array
            given[place] = pick
        try:
            block.batches(*given)
            accepted += 1
        except (ValueError, TypeError, BufferError):
            pass
    said = f"{CASES} sets of arguments, {accepted} of them accepted: nothing found"
    sys.stdout.write(said + "\n")


if __name__ == "__main__":
    attack(sys.argv[1]) if sys.argv[1:] else compile_and_run()
