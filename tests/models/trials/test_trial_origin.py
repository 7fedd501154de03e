"""Origin of trials: simulated ones never pass for measured ones."""

from dataclasses import replace

import msgspec
import pytest

from firmware_py.core.motion import Motion
from models.plant.document import Provenance
from models.rig.parameters import DEFAULT_STRUCTURE
from models.rig.protocol import RigConditions, TrialCase, record_conditions
from models.trials.files import read_trial, write_trial
from models.trials.origin import TrialOrigin, origin_notice, origins_of

RIG, MEASURED = TrialOrigin("rig", "default", 4), TrialOrigin("measured", trials=2)


@pytest.mark.parametrize(
    ("origins", "kind"),
    [
        ([RIG, TrialOrigin("sil", "twin"), TrialOrigin("simulated")], "simulated"),
        ([MEASURED, TrialOrigin("recording")], "measured"),
        ([RIG, MEASURED, TrialOrigin("")], "mixed"),
        ([TrialOrigin("toy")], "unknown"),
        ([RIG, TrialOrigin("")], "unknown"),
    ],
)
def test_a_notice_has_the_kind_and_names_every_origin(origins, kind):
    notice = origin_notice(origins)
    assert notice.kind == kind
    assert ("measured" in notice.label.lower()) is (kind in ("measured", "mixed"))
    assert ("No robot was measured" in notice.text) is (kind == "simulated")
    assert all(o.words in notice.text for o in origins)
    assert "the rig “default”" in origin_notice([RIG]).text


def test_the_rig_is_read_from_the_record_beside_a_trial(make_trial, tmp_path):
    trial = make_trial([0.0, 0.1, 0.2, 0.3, 0.4], source="rig", rest_samples=2)
    again = read_trial(write_trial(trial, tmp_path))
    assert origins_of([again, trial]) == (TrialOrigin("rig", trials=2),)  # no record: not known
    conditions = RigConditions(
        seed=1, hidden={"backlash": 0.1}, rig_sha256="", rig="drawn_3", structure=DEFAULT_STRUCTURE
    )
    case = TrialCase(Motion(), 0.0, 1)
    record_conditions([case], conditions, tmp_path)
    named = replace(again, name=case.name)
    assert origins_of([named, named]) == (TrialOrigin("rig", "drawn_3", 2),)
    fitted = Provenance().fitted_with([named])
    assert Provenance(fitted_trials=fitted).origins == (TrialOrigin("rig", "drawn_3"),)
    assert "backlash" not in repr(origins_of([named]))  # what is hidden stays hidden
    measured = replace(named, meta=msgspec.structs.replace(named.meta, source="measured"))
    assert origins_of([measured]) == (TrialOrigin("measured"),)
    for damaged in ("{", "[]", '{"trials": {"' + case.name + '": 1}}'):
        (tmp_path / "rig_conditions.json").write_text(damaged)
        assert origins_of([named]) == (TrialOrigin("rig"),)
