"""Documentation page of an FMU: how to use it, its variables, and further sections."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from firmware_py.core.units import symbol_of
from fmu.interface import FmiVariable, Interface, finite_bounds
from models.shared.pages import Paragraph, Section, Table, render_page

__all__ = ["documentation_page"]

_USAGE = Markup(
    "Co-Simulation with any communication step size. A value that is set between two steps "
    "acts on the outputs immediately. A refused call leaves the instance unchanged and logs "
    "one message under <code>logStatusError</code>. The folder <code>resources/</code> holds "
    "the plant and the predictor that the FMU was built from."
)


def documentation_page(
    interface: Interface, description: str, sections: Sequence[Section] = ()
) -> str:
    """Return documentation/index.html: description, further sections, table of variables."""
    rows = [
        [v.name, v.causality, symbol_of(v.unit), _range(v), v.description]
        for v in interface.variables
    ]
    table = Table("", ["variable", "causality", "unit", "range", "description"], rows)
    lead = [Paragraph(description, "lead"), Paragraph(_USAGE)]
    return render_page(
        interface.name, lead, [*sections, Section("variables", "Variables", [table])]
    )


def _range(variable: FmiVariable) -> str:
    limits = finite_bounds(variable)
    if not limits:
        return ""
    return f"{limits.get('min', '')} … {limits.get('max', '')}"
