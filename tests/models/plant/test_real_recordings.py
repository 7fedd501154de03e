"""Recordings of other machines: the shipped plants follow them, and the MATLAB reader."""

import json

import numpy as np
import pytest

from dropstitch.__main__ import main
from models.plant.plant import NOMINAL
from models.trials.recordings.mapping import ColumnSource, RecordingMap
from models.trials.recordings.table import read_table
from tests.real_data import real_recordings

EXAMPLES = NOMINAL.parent / "examples"


def errors_on(recordings, pattern, system, tmp_path, capsys):
    """Errors of a shipped plant by signal, on recordings imported by the command."""
    for file in sorted(recordings.glob(pattern)):
        table = ["--as", "table", "--map", str(EXAMPLES / f"{system}.map.toml")]
        assert main(["import", str(file), *table, "--out", str(tmp_path / "trials")]) == 0
    plant = str(EXAMPLES / f"{system}_identified.json")
    capsys.readouterr()
    assert main(["evaluate", str(tmp_path / "trials"), "--plant", plant, "--json"]) == 0
    return json.loads(capsys.readouterr().out)["signals"]


@pytest.mark.slow
def test_the_pendulum_follows_all_logs(tmp_path, capsys):
    """Three quarters of what viscous and Coulomb friction alone leave, 62 mrad in the mean."""
    recordings = real_recordings("bam_xl330")
    errors = errors_on(recordings, "*.json", "xl330_pendulum", tmp_path, capsys)
    assert errors["angle_1_rad"]["mae"] < 0.75 * 0.062


def test_the_car_follows_its_recording(tmp_path, capsys):
    """Closer than with the published friction and offset, 3.0 mm."""
    errors = errors_on(real_recordings("emps"), "*.mat", "emps", tmp_path, capsys)
    assert errors["position_1_m"]["rms"] < 0.0030


def test_the_flexible_links_records_are_read_column_by_column():
    """Eight records of 4 s at 500 Hz; their description gives 0.459° RMS of deflection."""
    files = sorted(real_recordings("quanser").glob("lqg_step_*.mat"))
    assert len(files) == 8
    names = {"time_s": "time", "angle_2_rad": "theta12"}
    mapping = RecordingMap(columns={n: ColumnSource(source=s) for n, s in names.items()})
    records = [read_table(file, mapping)[0] for file in files]
    for record in records:
        assert np.allclose(np.diff(record.time_s), 0.002) and len(record.time_s) == 2000
    deflection_rad = np.concatenate([record.columns["angle_2_rad"] for record in records])
    assert np.degrees(np.sqrt(np.mean(deflection_rad**2))) == pytest.approx(0.459, abs=0.001)
