"""`simval list`."""

from __future__ import annotations

from simval.cli.options import declared
from simval.cli.terminal import say
from simval.vocabulary import builtin_suites


@declared("list")
def command() -> int:
    """List suites, studies with their parameters, scenes and installed plug-ins."""
    from simval.plugins.loading import BUILTIN, installed
    from simval.scene import scenes
    from simval.studies import STUDIES
    from simval.sweep import load_suite

    lines = ["suites"]
    for name in builtin_suites():
        suite = load_suite(name)
        lines.append(f"  {name}: {suite.title} ({len(suite.cells)} cells)")
    lines.append("studies")
    for study in STUDIES.values():
        lines.append(f"  {study.name}: {study.title}")
        for key, field in study.parameters.model_fields.items():
            lines.append(f"    {key} = {field.default}  {field.description}")
    lines.append("scenes")
    lines += [f"  {scene.name}: {scene.summary}" for scene in scenes().values()]
    lines.append("built-in algorithms, measured with plug-ins")
    lines.append(f"  {', '.join(BUILTIN)}")
    lines.append("plug-ins (installed; for files see docs/plugins.md)")
    lines += [f"  {name}: {distribution}" for name, distribution in installed()]
    say(lines)
    return 0
