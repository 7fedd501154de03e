"""Recordings of other machines: the shipped plants against their claims, and the MATLAB reader."""

import json

import numpy as np
import pytest

from bench.claims.claim_table import read_accepted, read_claims
from models.__main__ import main
from models.plant.plant import NOMINAL
from models.trials.importers.table_file import read_columns
from tests.real_data import real_recordings

EXAMPLES = NOMINAL.parent / "examples"
TOLERANCE = 0.01
"""Largest relative distance of an error from the accepted figure; both come from one plant file."""


def errors_on(recordings, pattern, system, tmp_path, capsys):
    """Errors of a shipped plant by signal, on recordings imported by the command."""
    for file in sorted(recordings.glob(pattern)):
        table = ["--as", "table", "--map", str(EXAMPLES / f"{system}.map.toml")]
        assert main(["import", str(file), *table, "--out", str(tmp_path / "trials")]) == 0
    plant = str(EXAMPLES / f"{system}_identified.json")
    capsys.readouterr()
    assert main(["evaluate", str(tmp_path / "trials"), "--plant", plant, "--json"]) == 0
    return json.loads(capsys.readouterr().out)["signals"]


def claimed(name):
    """Accepted figure of a claim in SI units, and whether a value meets its target."""
    (claim,) = [c for c in read_claims() if c.name == name]
    return read_accepted()[name].value / claim.factor, lambda si: claim.is_met(si * claim.factor)


def test_the_pendulums_error_on_all_logs_is_the_claimed_one(tmp_path, capsys):
    recordings = real_recordings("bam_xl330")
    mae_rad = errors_on(recordings, "*.json", "xl330_pendulum", tmp_path, capsys)["angle_1_rad"][
        "mae"
    ]
    value_rad, met = claimed("xl330-all")
    assert met(mae_rad)
    assert mae_rad == pytest.approx(value_rad, rel=TOLERANCE)


def test_the_cars_error_is_the_claimed_one(tmp_path, capsys):
    recordings = real_recordings("emps")
    rms_m = errors_on(recordings, "*.mat", "emps", tmp_path, capsys)["position_1_m"]["rms"]
    value_m, met = claimed("emps-all")
    assert met(rms_m)
    assert rms_m == pytest.approx(value_m, rel=TOLERANCE)


def test_the_flexible_links_records_are_read_column_by_column():
    """Eight records of 4 s at 500 Hz; their description gives 0.459° RMS of deflection."""
    files = sorted(real_recordings("quanser").glob("lqg_step_*.mat"))
    assert len(files) == 8
    records = [read_columns(file) for file in files]
    for record in records:
        assert np.allclose(np.diff(record["time"]), 0.002) and len(record["time"]) == 2000
    deflection_rad = np.concatenate([record["theta12"] for record in records])
    assert np.degrees(np.sqrt(np.mean(deflection_rad**2))) == pytest.approx(0.459, abs=0.001)
