"""The generated pages: everything in the reference is read from the code."""

from pathlib import Path

from docs.site.commands import commands_page
from docs.site.interfaces import (
    equations_page,
    index_page,
    interface_page,
    public_modules,
    public_names,
    top_page,
    with_equations,
)
from docs.site.studies import statistics_page, studies_page, suites_page


def pages() -> dict[str, str]:
    """Text of each generated page, by its path below ``docs/reference``."""
    public = public_modules()
    taken = {f"{name}.{n}" for name in public for n in public_names(public[name])}
    found = {
        "commands.md": commands_page(),
        "studies.md": studies_page(),
        "suites.md": suites_page(),
        "statistics.md": statistics_page(),
        "api/simval.rst": top_page(),
        "api/index.rst": index_page("Python", ["simval", *public]),
        "equations/index.rst": index_page("Equations by module", with_equations()),
    }
    for name, module in public.items():
        found[f"api/{name}.rst"] = interface_page(name, module)
    for package, members in with_equations().items():
        found[f"equations/{package}.rst"] = equations_page(
            package, members, taken | set(public)
        )
    return found


def write(folder: Path) -> None:
    """Write the pages, touch none that is the same, and remove any other."""
    wanted = {folder / name: text for name, text in pages().items()}
    for path in folder.rglob("*.*"):
        if path not in wanted:
            path.unlink()
    for path, text in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
