"""The two figures of the first screen, where a user's algorithms have that place."""

from simval.report.section import Context, Section, made
from simval.report.sections.algorithms import has_user_code
from simval.report.sections.summary import figures


def section(context: Context) -> Section | None:
    """Make the section."""
    drawings = figures(context) if has_user_code(context.run) else []
    if not drawings:
        return None
    return made("overview", "Simulation beside theory", drawings)
