"""The command line: one file for each command, loaded when it is used.

A file begins with what its command is called with, and imports no more than click: a
function imports what does the work, so that a help is quick.

Exit codes: 0 pass, 1 the gate failed, 2 usage, configuration or unreadable input,
3 inconclusive, refused or nothing measured, 4 a cell crashed, 70 a bug of ours,
130 interrupted.
"""

import gc
import importlib
import os
import sys
from collections.abc import Sequence

import click

from simval.cli.interruption import watch
from simval.cli.terminal import failure_of, patient, say
from simval.errors import SimvalError
from simval.text import did_you_mean

COMMANDS = (
    ("check", "Measure and judge your own algorithm in seconds."),
    ("sweep", "Run a suite of studies into a run folder."),
    ("report", "Write a run as one self-contained HTML file."),
    ("gate", "Judge a run against theory and the baseline; exit code for CI."),
    ("calibrate", "Calibrate the sensors of a recorded log, with error bars."),
    ("correct", "Apply a calibration to a log."),
    ("noise", "Measure the noise of sensors at rest, from a log."),
    ("filter", "Run attitude filters over a log and measure their errors."),
    ("audit", "Judge a simulated IMU: is it what an ideal sensor would read?"),
    ("tell", "Say what noise a filter should be given, and what it then achieves."),
    ("plan", "Predict a calibration's error bars before any data is taken."),
    ("scene", "Simulate a scene and write its readings or a picture."),
    ("compare", "Show what changed between two runs, or two calibrations of a sensor."),
    ("trend", "Show what became better or worse in a series of runs."),
    ("repro", "Compute one cell again and compare it with the run."),
    ("export", "Write the table of a run as Parquet."),
    ("suite-schema", "Print the JSON Schema of suite files."),
    ("completion", "Print the script that lets a shell complete commands."),
    ("list", "List suites, studies, scenes and plug-ins."),
)

# a module becomes a name in this package, so none may shadow a builtin
MODULES = {"list": "listing", "suite-schema": "suite_schema"}


COMPLETE = "_SIMVAL_COMPLETE"
"""Variable by which a shell asks what completes a word."""


class LazyGroup(click.Group):
    """A group whose commands are imported only when they are called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands, in the order of the table."""
        return [name for name, _ in COMMANDS]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the module of a command and return its command object."""
        if cmd_name not in self.list_commands(ctx):
            return None
        name = MODULES.get(cmd_name, cmd_name)
        module = importlib.import_module(f"simval.cli.{name}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; for an unknown one, suggest names that are near."""
        word, known = args[0], self.list_commands(ctx)
        if word in known or word.startswith("-") or ctx.resilient_parsing:
            return super().resolve_command(ctx, args)
        return ctx.fail(f"No such command {word!r}{did_you_mean(word, known)}.")

    def format_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """List the commands without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl(COMMANDS)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="simval")
def group() -> None:
    """Validate inertial calibration and attitude estimation.

    How wrong are my calibration and my attitude estimate, does theory say that they
    must be that wrong, and did today's change make them worse?
    """


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code."""
    try:
        code = group.main(
            args=list(arguments), prog_name="simval", standalone_mode=False
        )
    except click.ClickException as error:
        error.show()
        return 2
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        return 130
    except SimvalError as error:
        taken = getattr(error, "__notes__", ())
        tried = getattr(error, "tried", "") if "--verbose" in arguments else ""
        words = [*f"error: {error}".splitlines(), *tried.splitlines()]
        say([*taken, *words], err=True)
        return error.exit_code
    except SystemExit as end:  # click completed a word
        return 0 if COMPLETE in os.environ and end.code == 0 else 2
    except (KeyError, ValueError) as error:
        if COMPLETE not in os.environ:
            raise
        click.echo(f"error: {COMPLETE} is for the script of a shell: {error}", err=True)
        return 2
    except OSError as error:
        click.echo(f"error: cannot write the output: {error}", err=True)
        return 2
    return code if isinstance(code, int) else 0


def main() -> None:
    """Entry point of the program."""
    # One thread in the linear algebra: the matrices are small, cells are what runs
    # in parallel, and the bits must not depend on the number of cores.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    gc.set_threshold(500_000, 50, 100)  # imports and lines of a log are no garbage
    interruption = watch()
    sys.stdout, sys.stderr = patient(sys.stdout, 1), patient(sys.stderr, 2)
    try:
        code = run(sys.argv[1:])
        if code != 130 and (failure := failure_of(sys.stdout)):
            say([f"error: standard output could not be written: {failure}"], err=True)
            code = 2
    except (Exception, KeyboardInterrupt) as error:
        code = 70
        if not interruption.asked:
            sys.excepthook(type(error), error, error.__traceback__)
            click.echo("this is a bug of simval; please report it", err=True)
    if interruption.asked and code != 130:  # dropped, or taken for another error
        click.echo("interrupted", err=True)
        code = 130
    gc.freeze()  # the end of the process would look for garbage twice
    exec("")  # else `python -m` ends by the signal where a text was interrupted
    sys.exit(code)
