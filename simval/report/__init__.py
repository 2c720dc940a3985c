"""One self-contained HTML file from a run folder: figures inline, no network.

Computing and drawing are apart: everything here reads the run, nothing simulates.
Each section is one module in `sections`, with a function ``section(context)`` that
returns the section, or None where the run has nothing for it, and one template.
"""

from simval.report.page import figures, render

__all__ = ["figures", "render"]
