import msgspec
import pytest

from models.plant.provenance import Provenance
from models.rig.drawn_rig import rig_named
from models.rig.rig_parameters import read_parameters
from models.trials.origin_notice import origin_notice
from models.trials.trial_files import read_trial, write_trial
from models.trials.trial_origin import TrialOrigin, kind_of_origins, origins_of

RIG, MEASURED = TrialOrigin("rig", "default", 4), TrialOrigin("measured", trials=2)


@pytest.mark.parametrize(
    ("origins", "kind"),
    [
        ([], "unknown"),
        ([RIG], "simulated"),
        ([RIG, TrialOrigin("sil", "twin"), TrialOrigin("simulated")], "simulated"),
        ([MEASURED, TrialOrigin("recording")], "measured"),
        ([RIG, MEASURED], "mixed"),
        ([TrialOrigin("toy")], "unknown"),
        ([RIG, TrialOrigin("")], "unknown"),
        ([RIG, MEASURED, TrialOrigin("")], "mixed"),
    ],
)
def test_simulated_trials_never_pass_for_measured_ones(origins, kind):
    assert kind_of_origins(origins) == kind
    notice = origin_notice(origins)
    assert notice.kind == kind
    assert ("measured" in notice.label.lower()) is (kind in ("measured", "mixed"))
    assert all(o.words in notice.text for o in origins)


def test_a_notice_names_the_rig_and_says_that_no_robot_was_measured():
    text = origin_notice([TrialOrigin("rig", "test_a")]).text
    assert "the rig “test_a”" in text and "No robot was measured" in text
    assert "No robot" not in origin_notice([MEASURED]).text


def test_the_rig_is_kept_in_the_file_and_left_out_of_the_hash(make_trial, tmp_path):
    plain = make_trial([0.0, 0.1, 0.2, 0.3, 0.4], source="rig", rest_samples=2)
    named = msgspec.structs.replace(plain.meta, rig="drawn_3")
    path = write_trial(type(plain)("run", named, plain.columns), tmp_path)
    again = read_trial(path)
    assert again.meta.rig == "drawn_3"
    assert again.sha256() == plain.sha256()  # plants fitted before the key existed know the trial
    assert origins_of([again, again]) == (TrialOrigin("rig", "drawn_3", 2),)
    fitted = Provenance().fitted_with([again])
    assert Provenance(fitted_trials=fitted).origins == (TrialOrigin("rig", "drawn_3"),)


@pytest.mark.parametrize("name", ["default", "test_a", "drawn_3"])
def test_a_rig_knows_its_name_whatever_is_hidden_in_it(name):
    rig = rig_named(name)
    assert rig.name == rig.hide({"backlash": 0.01}).name == name
    assert read_parameters().name == "default"
