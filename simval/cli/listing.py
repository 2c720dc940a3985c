"""What `simval list` does."""

import click

from simval.plugins.builtin import BUILTIN
from simval.plugins.loading import installed
from simval.scene import scenes
from simval.studies import STUDIES
from simval.sweep import load_suite
from simval.vocabulary import builtin_suites


def run() -> int:
    """Do what `simval list` is asked."""
    click.echo("suites")
    for name in builtin_suites():
        suite = load_suite(name)
        click.echo(f"  {name}: {suite.title} ({len(suite.cells)} cells)")
    click.echo("studies")
    for study in STUDIES.values():
        click.echo(f"  {study.name}: {study.title}")
        for key, field in study.parameters.model_fields.items():
            click.echo(f"    {key} = {field.default}  {field.description}")
    click.echo("scenes")
    for scene in scenes().values():
        click.echo(f"  {scene.name}: {scene.summary}")
    click.echo("algorithms of its own, measured beside plug-ins")
    click.echo(f"  {', '.join(BUILTIN)}")
    click.echo("plug-ins (installed; for files see docs/plugins.md)")
    for name, distribution in installed():
        click.echo(f"  {name}: {distribution}")
    return 0
