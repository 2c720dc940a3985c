"""What the numbers depend on, and the command that makes them again."""

from simval.report.section import Context, Section, made


def section(context: Context) -> Section | None:
    """Make the section.

    Parameters
    ----------
    context : Context
        The run and its verdicts.

    Returns
    -------
    Section or None
        Always a section.
    """
    manifest, timing = context.run.manifest, context.run.timing
    git = manifest["git"]
    return made(
        "provenance",
        "Provenance",
        manifest=manifest,
        timing=timing,
        commit=git["commit"] or "not from a checkout",
        dirty=bool(git["dirty"]),
    )
