"""Colours stand in the palette and display units in their table, nowhere else."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
ROOMS = ("firmware_py", "models", "fmu", "hil", "bench")
PALETTE = ROOT / "models" / "shared" / "palette.py"
UNITS = ROOT / "firmware_py" / "display_units.py"

COLOUR = re.compile(
    r"""["'](?:\#[0-9a-fA-F]{3,8}|C\d|tab:\w+)["']"""  # a hex or matplotlib colour
    r"""|\bcolou?rs?=["']"""  # a colour given by its name or as a grey level
    r"""|(?:stroke|fill|background|color|border[\w-]*): ?[^;{]*\#[0-9a-fA-F]{3,8}\b"""  # CSS
    r"""|(?:stroke|fill)=\\?["']\#"""  # SVG
)
POWER = r"(?:1e-?[2369]|1_?000(?:_000)?(?:\.0)?|100(?:\.0)?)"
FACTOR = re.compile(
    rf"f['\"].*\{{[^{{}}'\"]*(?:\b{POWER} ?\*|[*/] ?{POWER}\b)[^{{}}]*\}}"  # within an f-string
    r"|^\s*_?(?:[MUKN][MSB]|PERCENT|MILLI\w*|MICRO\w*)(?:: Final)? = 1e-?[2369]\b",  # MM = 1e3
    re.MULTILINE,
)


def modules():
    return [p for room in ROOMS for p in sorted((ROOT / room).rglob("*.py"))]


def lines_with(pattern, path):
    return [
        f"{path.relative_to(ROOT)}:{k}: {line.strip()}"
        for k, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if pattern.search(line) and ">>>" not in line
    ]


def test_no_module_but_the_palette_defines_a_colour():
    files = [*modules(), *(p for room in ROOMS for p in (ROOT / room).rglob("*.css"))]
    files += [p for room in ROOMS for p in (ROOT / room).rglob("*.html")]
    assert len(files) > 100
    assert [hit for p in files if p != PALETTE for hit in lines_with(COLOUR, p)] == []


def test_no_module_but_the_table_scales_a_value_for_display():
    assert [hit for p in modules() if p != UNITS for hit in lines_with(FACTOR, p)] == []


@pytest.mark.parametrize(
    ("pattern", "line"),
    [
        (COLOUR, 'ax.plot(x, y, color="0.6")'), (COLOUR, 'LINE = "#1d6a96"'),
        (COLOUR, "td{border-bottom:1px solid #ddd}"), (COLOUR, 'ax.plot(x, y, "C3")'),
        (FACTOR, 'f"{1e3 * error_m:.1f} mm"'), (FACTOR, 'f"{busy_ns / 1e6:.2f} ms"'),
        (FACTOR, 'f"{100 * fraction:.0f} %"'), (FACTOR, "MM: Final = 1e3"),
    ],
)  # fmt: skip
def test_the_patterns_see_what_they_look_for(pattern, line):
    assert pattern.search(line)
