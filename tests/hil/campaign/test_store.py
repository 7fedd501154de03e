"""Keys, tasks and store of a campaign: what makes another case, and what counts as a result."""

import json
import os
from types import SimpleNamespace

import msgspec
import pytest

from firmware_py.core.errors import InputError
from firmware_py.core.output_files import locked_directory
from hil.campaign.cases import CaseMaker
from hil.campaign.store import ResultStore
from hil.campaign.worker import CaseOutcome, run_case
from tests.hil.campaign.toy_kind import KIND


@pytest.fixture
def toys(tmp_path):
    maker = CaseMaker(KIND, "tests.hil.campaign.toy_kind", tmp_path / "shared")

    def build(*values):
        return SimpleNamespace(cases=maker.cases(values, "toys.toml"), maker=maker)

    return build


@pytest.fixture
def stored(toys, tmp_path):
    cases, store = toys({"value": 1.0}, {"value": 2.0}).cases, ResultStore(tmp_path / "out")
    for case in cases:
        store.add(case, "toy", "code", CaseOutcome(state="done", result={"square": 0.5}))
    return store, cases


def test_a_key_follows_from_values_defaults_and_contents_alone(toys, tmp_path):
    files = [tmp_path / n for n in ("one", "same", "other")]
    for path, text in zip(files, ("a", "a", "b"), strict=True):
        path.write_text(text)
    a, b, c = (toys({"value": 1.0, "file": str(f)}).cases[0].key for f in files)
    assert a == b != c
    same = toys({"value": 1.0}, {"value": 1, "act": "count"}, {"value": 2.0})
    assert len(same.cases) == 2
    same.maker.code = "of other code"
    assert same.maker.cases([{"value": 1}], "")[0].key != same.cases[0].key


def test_a_worker_with_other_code_or_files_refuses(toys, tmp_path):
    path = tmp_path / "file"
    path.write_text("as it was")
    campaign = toys({"value": 1.0, "file": str(path)})
    task = campaign.maker.task(campaign.cases[0])
    assert run_case(task).state == "done"
    for change, sentence in (
        ({"code": "old"}, "the campaign has old"),
        ({"files": {"/no/such": "0"}}, "/no/such: is missing on the worker"),
        ({"files": {str(path): "0"}}, "differs on the worker"),
    ):
        outcome = run_case(msgspec.structs.replace(task, **change))
        assert outcome.state == "refused"
        assert sentence in outcome.sentence
    path.write_text("as it is now")
    assert "differs on the worker" in run_case(task).sentence


@pytest.mark.parametrize("damage", ["cut", "edited", "another", "schema"])
def test_a_damaged_file_is_no_result(stored, damage):
    store, (first, second) = stored
    assert store.read(first.key).result == {"square": 0.5}
    text = store.path(first.key).read_text()
    changed = {
        "cut": text[:-20], "edited": text.replace("0.5", "0.6"),
        "another": store.path(second.key).read_text(),
        "schema": text.replace('"schema":1', '"schema":9'),
    }[damage]  # fmt: skip
    assert changed != text
    store.path(first.key).write_text(changed)
    assert store.read(first.key) is None


def test_a_file_of_a_case_is_read_within_limits(toys, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(200_000_000)
    for name in ("pipe", "large"):
        with pytest.raises(InputError, match=r"a device or a pipe|is larger than"):
            toys({"value": 1.0, "file": str(tmp_path / name)})


def test_failures_are_never_removed(stored):
    store, (case, _) = stored
    for sentence in ("first", "second"):
        store.add(case, "toy", "code", CaseOutcome(state="failed", sentence=sentence, log="a log"))
    assert store.last_failure(case.key).sentence == "second"
    files = sorted((store.directory / "failures").glob(f"{case.key}-*.json"))
    assert [json.loads(f.read_text())["sentence"] for f in files] == ["first", "second"]
    assert json.loads(files[0].read_text())["log"] == "a log"


def test_a_directory_has_one_campaign_at_a_time(stored):
    store, _ = stored
    with (
        locked_directory(store.directory),
        pytest.raises(InputError, match="in use by another run"),
        locked_directory(store.directory),
    ):
        pass
