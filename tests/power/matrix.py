"""Every fault and its clean twin, through the real flow: suite, run, gate.

A fault is injected into the functions that the flow itself calls; the suite is run into
a folder, read back and judged. Its twin is the same suite without the fault. The gate
is right if the fault ends in fail or inconclusive, and the twin in pass.
"""

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from power import attitude, calibration, diagnosis, filters, machinery, small
from power.fault import Fault, replaced
from simval.errors import InputError
from simval.judge import GateResult, findings, judge_run, read_baseline, write_baseline
from simval.sweep.run import Run, load_run
from simval.sweep.runner import run_suite
from simval.sweep.suite import expand, load_suite
from simval.verdict import Answer

FEWER: dict[str, dict[str, Any]] = {"filter": {"scenario": "gimbal slow"}}
"""What is left of the longest part of the smoke suite: one of two scenarios."""


def smoke_parts() -> dict[str, dict[str, Any]]:
    """Each study of the smoke suite as a suite of its own."""
    grid: Any = load_suite("smoke").grid
    return {
        f"smoke {name}": {name: cells | FEWER.get(name, {})}
        for name, cells in grid.items()
        if isinstance(cells, dict)
    }


SUITES: dict[str, dict[str, Any]] = {
    "attitude": {"attitude": {"noise_std": [0.02, 0.05, 0.1], "samples": 1_048_576}},
    "streams": {
        "attitude": {"noise_std": [0.02, 0.05, 0.1], "samples": 1_048_576},
        "sampling": {"blocks": 8},
    },
    # noise of 1.5 m/s^2: only there do 6144 trials see a bias of second order
    "calibration": {
        "calibration": {
            "noise_std": [0.0, 0.01, 1.5],
            "poses": 20,
            "hold_time": 0.02,
            "trials": 6144,
        }
    },
    # of an accelerometer as noisy as the magnetometer, too: there it counts
    "magnetometer": {
        "magnetometer": {
            "accelerometer_noise": [1e-4, 5e-3],
            "poses": 20,
            "trials": 1024,
        }
    },
    # once with a quiet gyroscope: there the noise of the poses counts
    "gyroscope": {
        "gyroscope": {"poses": 14, "trials": 512, "angle_random_walk": [0.01, 1e-3]}
    },
    "noise": {"noise_model": {"estimate": "known weights", "rows": 4096}},
    "choices": {"noise_model": {"estimate": "chosen", "rows": 4096}},
    "scene": {"scene": {"scene": "gimbal", "poses": 20}},
    # fast, too: there coning counts; and told wrongly, which theory predicts
    "filter": {
        "filter": {
            "scenario": [
                "gimbal slow",
                "gimbal fast",
                "gimbal slow, gyroscope noise 3",
            ],
            "seconds": 8.0,
        }
    },
    "order": {"attitude_order": {"geometry": 3, "noise": "isotropic"}},
    "vectors": {"attitude_vectors": {"noise_std": 0.01}},
    "sound logs": {"diagnosis": {"logs": ["sound", "of known noise"], "trials": 6}},
    "faults": {"diagnosis": {"logs": ["changed readings", "biases"], "trials": 2}},
    "simulators": {"audit": {"simulators": ["right", "times"]}},
    **smoke_parts(),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """The gate's answers for a fault and for its twin."""

    fault: Fault
    seen: Answer  # the gate's answer with it
    alone: Answer  # the same by theory alone
    twin: Answer  # the gate's answer without it
    crashed: bool
    reason: str  # the gate's first finding with the fault

    @property
    def right(self) -> bool:
        """Whether the gate was right about both, and nothing else went wrong."""
        told_apart = self.seen != "pass" and self.twin == "pass"
        stated = (self.alone == "pass") == bool(self.fault.baseline)
        return told_apart and stated and self.crashed == self.fault.crash


def faults() -> tuple[Fault, ...]:
    """Every fault, in the order of the flow."""
    return tuple(
        fault
        for module in (calibration, filters, attitude, machinery, small, diagnosis)
        for fault in module.FAULTS
    )


def inject_all(chosen: tuple[Fault, ...]) -> Iterator[Result]:
    """Run each fault and its twin through the gate."""
    with TemporaryDirectory(prefix="simval-power-") as folder:
        twins = {
            name: _Twin.of(name, Path(folder) / f"{name}-twin")
            for name in dict.fromkeys(fault.suite for fault in chosen)
        }
        for number, fault in enumerate(chosen):
            twin = twins[fault.suite]
            baseline = twin.baseline if fault.baseline else None
            place = Path(folder) / str(number)
            if fault.stops:
                with suppress(RuntimeError):
                    _run(fault.suite, place, fault.inject())
                run = load_run(place)
            else:
                run = _run(fault.suite, place, fault.inject())
            result = judge_run(run, baseline)
            yield Result(
                fault=fault,
                seen=result.answer,
                alone=judge_run(run).answer,
                twin=twin.beside_baseline if fault.baseline else twin.alone,
                crashed=any(cell.status == "failed" for cell in run.cells),
                reason=_first(result).replace(str(place), "RUN"),
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Twin:
    baseline: Any
    alone: Answer
    beside_baseline: Answer

    @classmethod
    def of(cls, suite: str, folder: Path) -> "_Twin":
        # the baseline is one clean run; another clean run is compared with it
        stored = folder.with_suffix(".json")
        write_baseline(stored, _run(suite, folder, nullcontext()), "the clean twin")
        baseline = read_baseline(stored)
        again = _run(suite, folder.with_suffix(".again"), nullcontext())
        return cls(
            baseline=baseline,
            alone=judge_run(again).answer,
            beside_baseline=judge_run(again, baseline).answer,
        )


def _run(name: str, folder: Path, context: AbstractContextManager[None]) -> Run:
    suite = expand(name, {"seed": 1} | SUITES[name])
    with without_pictures(), context:
        return run_suite(suite, folder)


def without_pictures() -> AbstractContextManager[None]:
    """No picture is drawn: they are not judged and would take most of the time."""

    def none(*_: Any, **__: Any) -> bytes:
        msg = "no pictures here"
        raise InputError(msg)

    study = import_module("simval.studies.scene")  # the name is the package's too
    return replaced(study, "drawn", none)


def _first(result: GateResult) -> str:
    bad = [f for f in findings(result) if f.answer != "pass"]
    return bad[0].line if bad else "nothing"
