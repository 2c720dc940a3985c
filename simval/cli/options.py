"""Options that several commands share."""

from typing import Any

import click


class Rate(click.FloatRange):
    """A false-alarm rate: above 0, at most a half, and a number."""

    def __init__(self) -> None:
        super().__init__(0.0, 0.5, min_open=True)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Convert, and refuse what compares with nothing."""
        rate = float(super().convert(value, param, ctx))
        if not rate > 0.0:
            self.fail(f"{value!r} is no rate; give a number above 0, at most 0.5.")
        return rate


alpha_option = click.option(
    "--alpha",
    type=Rate(),
    default=1e-3,
    show_default=True,
    help="False-alarm rate of all checks together.",
)
