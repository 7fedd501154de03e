"""Keys and store of a campaign: what makes a case another one, and what counts as a result."""

import json
import os

import pytest

from firmware_py.core.errors import InputError
from hil.campaign.campaign_run import missing_cases
from hil.campaign.case_task import TaskOutcome


@pytest.fixture
def stored(toys):
    campaign = toys("out", [{"value": 1.0}, {"value": 2.0}])
    for case in campaign.cases:
        campaign.store.write(case.key, "toy", "code", case.config, '{"square":0.5}')
    return campaign


def test_a_key_follows_from_values_defaults_and_contents_alone(toys, tmp_path):
    files = [tmp_path / n for n in ("one", "same", "other")]
    for path, text in zip(files, ("a", "a", "b"), strict=True):
        path.write_text(text)
    a, b, c = (toys("out", [{"value": 1.0, "file": str(f)}]).cases[0].key for f in files)
    assert a == b != c
    plain, default = toys("out", [{"value": 1}]), toys("out", [{"value": 1.0, "act": "count"}])
    assert plain.cases[0].key == default.cases[0].key
    plain.maker.code = "of other code"
    assert plain.maker.cases([{"value": 1}], "")[0].key != default.cases[0].key


def test_a_case_that_stands_twice_is_one_case(toys):
    assert len(toys("out", [{"value": 1.0}, {"value": 1}, {"value": 2.0}]).cases) == 2


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ({"value": "much"}, "makes case 1 of kind toy, which does not fit: Expected `float`"),
        ({"value": 1.0, "colour": 2}, "unknown field `colour`"),
        ({}, "missing required field `value`"),
        ({"value": -1.0}, "value: is -1; give 0 or more"),
        ({"value": 1.0, "file": "/no/such"}, "/no/such: is missing"),
    ],
)
def test_a_configuration_that_does_not_fit_is_refused(toys, config, said):
    with pytest.raises(InputError) as caught:
        toys("out", [config])
    assert said in str(caught.value)


def test_a_result_is_read_as_it_was_written(stored):
    record = stored.store.read(stored.cases[0].key)
    assert record.result == {"square": 0.5}
    assert record.config["value"] == 1.0
    assert missing_cases(stored.cases, stored.store) == ([], 0)


@pytest.mark.parametrize("damage", ["cut", "edited", "another", "empty", "schema"])
def test_a_file_that_exists_is_no_result_yet(stored, damage):
    first, second = (stored.store.path(c.key) for c in stored.cases)
    text = first.read_text()
    changed = {
        "cut": text[:-20], "edited": text.replace("0.5", "0.6"), "another": second.read_text(),
        "empty": "", "schema": text.replace('"schema":1', '"schema":9'),
    }[damage]  # fmt: skip
    assert changed != text
    first.write_text(changed)
    assert stored.store.read(stored.cases[0].key) is None
    assert missing_cases(stored.cases, stored.store) == ([stored.cases[0]], 1)


def test_a_damaged_row_of_costs_does_not_count(stored):
    whole = 'a,code,done,0.5,0.4,1,900,host-1,"{""run"": 0.3}"'
    head = "key,code,state,wall_s,cpu_s,memory_bytes,result_bytes,worker,parts_s"
    other = [whole.replace("0.4", "x"), whole.replace("0.4", "nan"), whole[:-3], whole[:20]]
    stored.store.costs.write_text("\n".join([head, whole, *other]))
    assert [row["cpu_s"] for row in stored.store.read_costs()] == ["0.4"]
    stored.store.costs.write_bytes(b"\xff")
    with pytest.raises(InputError, match="cannot be read"):
        stored.store.read_costs()


@pytest.mark.parametrize("kind", ["pipe", "large"])
def test_what_a_case_names_is_read_within_limits(toys, tmp_path, kind):
    path = tmp_path / kind
    if kind == "pipe":
        os.mkfifo(path)
    else:
        with path.open("wb") as file:
            file.truncate(200_000_000)
    with pytest.raises(InputError, match=r"a device or a pipe|is larger than"):
        toys("out", [{"value": 1.0, "file": str(path)}])


def test_no_failure_is_ever_lost(stored):
    key, config = stored.cases[0].key, stored.cases[0].config
    for sentence in ("first", "second"):
        outcome = TaskOutcome(key=key, state="failed", sentence=sentence, log="a log")
        stored.store.write_failure("toy", "code", config, outcome)
    assert stored.store.last_failure(key).sentence == "second"
    files = sorted((stored.out / "failures").glob(f"{key}-*.json"))
    assert [json.loads(f.read_text())["sentence"] for f in files] == ["first", "second"]
    assert json.loads(files[0].read_text())["log"] == "a log"


def test_one_campaign_at_a_time_in_a_directory(stored):
    with (
        stored.store.locked(),
        pytest.raises(InputError, match="in use by another campaign"),
        stored.store.locked(),
    ):
        pass
