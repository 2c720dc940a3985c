"""The compiled filter under AddressSanitizer and UndefinedBehaviorSanitizer.

`make sanitize`, a part of `make nightly`: it is compiled again with both, loaded in an
interpreter of its own, held to the NumPy form's numbers, and given 20 000 random sets
of arguments. Either sanitizer ends the process at its first finding.
"""

import importlib.util
import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

SOURCE = Path(__file__).parents[2] / "simval" / "imu" / "filters" / "mekf.c"
FLAGS = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all",
         "-ffp-contract=off", "-shared", "-fPIC")  # fmt: skip
CASES = 20_000


def compile_and_run():
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "_simval_mekf.so"
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

    from simval.imu.filters import mekf

    spec = importlib.util.spec_from_file_location("_simval_mekf", library)
    code = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(code)
    if not mekf.reproduces(code):
        sys.exit("the compiled filter has other numbers than the NumPy form")
    rng = np.random.default_rng(1)
    kinds = [np.dtype(k) for k in ["f8", "f4", "u8", "i8", "u1", "c16", ">f8", "?"]]
    kinds.append(kinds[0].newbyteorder("<"))  # its format states the order
    things = [None, "text", b"x" * 72, 1.0, [1.0] * 9, memoryview(b"")]
    accepted = 0
    for _ in range(CASES):
        rows, trials = rng.integers(0, 4, size=2)
        some = rng.integers(0, 2, size=2)
        m, each = 3 * int(some.sum()), int(rows * trials)
        sizes = [rows, 3 * each, 3 * each, 3 * each, 2 * m + 3, 46 * trials]
        given = [
            rng.standard_normal(size) for size in (*sizes, each * (43 + m + m * m))
        ]
        given[2:4] = [
            a if there else None for a, there in zip(given[2:4], some, strict=True)
        ]
        for place in rng.integers(0, 7, size=rng.integers(0, 3)):
            size = int(rng.integers(0, 60))
            array = np.zeros(size, dtype=kinds[rng.integers(len(kinds))])
            array = array[::2] if rng.random() < 0.2 else array
            pick = things[rng.integers(len(things))] if rng.random() < 0.2 else array
            given[place] = pick
        try:
            code.rows(*given)
            accepted += 1
        except (ValueError, TypeError, BufferError):
            pass
    said = f"{CASES} sets of arguments, {accepted} of them accepted: nothing found"
    sys.stdout.write(said + "\n")


if __name__ == "__main__":
    attack(sys.argv[1]) if sys.argv[1:] else compile_and_run()
