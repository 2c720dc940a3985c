"""Sweeps as processes, alone and on clusters on loopback, some workers strangers."""

import contextlib
import os
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time

from places import ROOT

from simval.sweep import store

QUIET = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}

# sends one more line than the other; not a number of any study
OTHER_KERNELS = {
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
}


def plain(source=ROOT, **words):
    """Environment of a process with this source, and of the tests only the kernels."""
    set_here = re.compile("DASK|OPENBLAS_NUM|OMP")
    kept = {k: v for k, v in os.environ.items() if not set_here.match(k)}
    path = os.pathsep.join([str(source), str(ROOT / "tests")])
    return {**kept, "PYTHONPATH": path, **words}


def copy_of_source(folder, **changes):
    """A second copy of the package, of the same version, with changed files."""
    shutil.copytree(ROOT / "simval", folder / "simval")
    shutil.copytree(ROOT / "models", folder / "models")
    for name, (old, new) in changes.items():
        file = folder / "simval" / name.replace("__", "/")
        file = file.with_suffix(".py")
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))
    return folder


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Cluster:
    """A scheduler, and workers that join when they are asked to."""

    def __init__(self, folder, **words):
        self.folder, self.words = folder, words
        self.address = f"tcp://127.0.0.1:{free_port()}"
        port = self.address.rpartition(":")[2]
        self.workers, self.drivers = [], []
        self.scheduler = self._start(
            "dask_scheduler", "--host", self.address.rpartition(":")[0], "--port", port
        )

    def _start(self, name, *words, source=ROOT, **environment):
        base = [sys.executable, "-m", f"distributed.cli.{name}", *words]
        return subprocess.Popen(
            [*base, "--no-dashboard"],
            cwd=self.folder,
            env=plain(source, **self.words, **environment),
            **QUIET,
        )

    def join(self, nanny=False, **options):
        """Have one more worker join; a nanny starts it again when it dies."""
        kind = "--nanny" if nanny else "--no-nanny"
        words = (self.address, "--nthreads", "1", kind)
        self.workers.append(self._start("dask_worker", *words, **options))
        return self.workers[-1]

    def sweep(self, suite, folder, *words, **options):
        """Have a driver sweep on it, as a process."""
        where = ("--scheduler", self.address)
        self.drivers.append(sweep(suite, folder, *where, *words, **options))
        return self.drivers[-1]

    def await_workers(self, count):
        from distributed import Client

        with Client(self.address, timeout=60, set_as_default=False) as client:
            if count:
                client.wait_for_workers(count, timeout=60)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        for process in (*self.drivers, *self.workers, self.scheduler):
            process.kill()
            process.communicate()


def without_simval(folder):
    """A path by which a Python has a package `simval` that cannot be imported."""
    package = folder / "nothing" / "simval"
    package.mkdir(parents=True)
    words = "No module named 'simval'"
    (package / "__init__.py").write_text(f"raise ModuleNotFoundError({words!r})\n")
    return package.parent


def sweep(suite, folder, *words, source=ROOT, group=False, limit=None, **environment):
    """A driver as a process, which hears Ctrl-C; its files may have a limit of size."""
    command = [sys.executable, "-m", "simval", "sweep", str(suite)]

    def begin():
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        if limit:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))

    return subprocess.Popen(
        [*command, "--out", str(folder), *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=plain(source, **environment),
        start_new_session=group,
        preexec_fn=begin,
    )


def ended(process, timeout=120):
    """Exit code, standard output and standard error of a process."""
    out, err = process.communicate(timeout=timeout)
    process.communicate = lambda: None  # its pipes are closed
    return process.returncode, out, err


def until(condition, seconds=90):
    """Wait for something, not for ever."""
    limit = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < limit
        with contextlib.suppress(KeyboardInterrupt):
            time.sleep(0.05)


def finished(folder):
    """Times of the finished cells of a run, by their names."""
    if not (folder / "run.sqlite").exists():
        return {}
    with store.opened(folder / "run.sqlite") as database:
        cells = store.read_cells(database)
        return {cell.name: cell.seconds for cell in cells if cell.status == "done"}


def poisoned(folder, words):
    """Words by which a Python's cells kill it or wait, as `poison` says."""
    site = folder / "site"
    site.mkdir(exist_ok=True)
    (site / "sitecustomize.py").write_text("import poison; poison.install()\n")
    source = os.pathsep.join([str(site), str(ROOT)])
    return {"SIMVAL_TEST_POISON": words, "source": source}
