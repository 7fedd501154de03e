import numpy as np
import pytest

from firmware_py.core.units import LENGTH
from models.gap.report.gap_charts import draw_errors
from models.gap.report.gap_json import MappedRegion, largest_gaps
from models.gap.report.localisation_maps import draw_heat_map
from models.shared.drawing import Drawing
from models.shared.palette import HEAT, MUTED


def texts(ax):
    return [t.get_text() for t in ax.texts]


def test_a_heat_map_writes_every_value_and_leaves_missing_cells_empty():
    cells = {("tip x", "1/8"): 1.0, ("tip x", "2/8"): 12.3, ("angle 1", "1/8"): 3.21}
    with Drawing() as (_, ax):
        draw_heat_map(ax, ["tip x", "angle 1"], ["1/8", "2/8"], cells, most=12.3,
                      faint={("tip x", "1/8")})  # fmt: skip
        assert sorted(texts(ax)) == ["1.0", "12", "3.2"]
        assert len(ax.collections) == 3
        assert {t.get_text(): t.get_color() for t in ax.texts}["1.0"] == MUTED
        darkest = ax.collections[1].get_facecolor()[0][:3]
        assert darkest == pytest.approx([int(HEAT[-1][k : k + 2], 16) / 255 for k in (1, 3, 5)])


def test_errors_are_shown_in_their_unit_around_zero():
    time_s = np.arange(1000) * 0.01 + 5.0
    before = 2e-3 * np.sin(time_s)
    with Drawing() as (_, ax):
        draw_errors(ax, time_s, [before, 0.5 * before], LENGTH, 1e-4)
        first, _ = ax.lines
        assert np.max(np.abs(first.get_ydata())) == pytest.approx(2.0, rel=1e-3)
        assert first.get_xdata()[0] == 0.0
        low, high = ax.get_ylim()
        assert low == -high and ax.get_ylabel() == "error in mm"


def test_signals_are_ranked_by_their_largest_significant_gap_over_a_trial():
    rows = [
        MappedRegion("di", "trial", "one", 3.0, 0, 0, True),
        MappedRegion("tip_x_m", "trial", "one", 2.0, 0, 0, True),
        MappedRegion("tip_x_m", "trial", "two", 5.0, 0, 0, True),
        MappedRegion("current_1_a", "trial", "one", 9.0, 0, 0, False),
        MappedRegion("di", "band", "0 to 0.3 Hz", 20.0, 0, 0, True),
    ]
    assert largest_gaps(rows) == {"tip_x_m": 5.0, "di": 3.0}
    assert list(largest_gaps(rows[3:])) == ["current_1_a"]
