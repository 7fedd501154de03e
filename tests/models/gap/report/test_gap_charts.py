import numpy as np
import pytest

from firmware_py.core.units import LENGTH
from models.gap.report.gap_charts import draw_errors
from models.gap.report.gap_json import MappedRegion, largest_gaps
from models.gap.report.localisation_maps import localisation_maps
from models.shared.drawing import Drawing


def test_a_map_shows_every_value_and_shades_the_significant_ones():
    regions = [
        MappedRegion("tip_x_m", "phase", "1/8", 1.0, 0, 0.5, False),
        MappedRegion("tip_x_m", "phase", "2/8", 12.3, 0, 0, True),
        MappedRegion("angle_1_rad", "phase", "1/8", 3.21, 0, 0, True),
    ]
    _, table = localisation_maps(regions, 0.05)
    assert table.title == "Phase of the cycle" and list(table.header) == ["", "1/8", "2/8"]
    (angle, missing), (tip, most) = (row[1:] for row in table.rows)
    assert [cell.text for cell in (angle, missing, tip, most)] == ["3.2", "", "1.0", "12"]
    assert tip.shade is None and missing.shade is None
    assert 0.0 < angle.shade < most.shade == 1.0


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
