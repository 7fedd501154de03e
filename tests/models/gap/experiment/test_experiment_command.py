"""The command refuses what it cannot use, in one sentence."""

import pytest

from models.__main__ import main


@pytest.mark.parametrize(
    ("out", "said"), [("gap.json", "no TOML file"), ("gap.toml", "is a file that is read")]
)
def test_the_diagnosis_is_not_overwritten(tmp_path, capsys, out, said):
    for name in ("gap.json", "gap.toml"):
        (tmp_path / name).write_text("kept")
    code = main(["experiment", "--gap", str(tmp_path / out), "--limits", "robot.toml",
                 "--out", str(tmp_path / out)])  # fmt: skip
    assert code == 2
    assert said in capsys.readouterr().err
    assert (tmp_path / out).read_text() == "kept"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [(["--hide", "creep=0.1"], "--repeat"), ([], "none.json")],
)
def test_wrong_options_give_one_sentence(tmp_path, capsys, options, sentence):
    code = main(["experiment", "--gap", str(tmp_path / "none.json"), "--limits", "robot.toml",
                 "--out", str(tmp_path / "motion.toml"), *options])  # fmt: skip
    assert code == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert sentence in told
    assert not (tmp_path / "motion.toml").exists()
