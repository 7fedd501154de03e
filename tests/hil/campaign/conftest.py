"""Campaign of toys: cases, maker and store."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from hil.campaign.campaign_cases import CaseMaker
from hil.campaign.result_store import ResultStore
from tests.hil.campaign.toy_kind import KIND

MODULE = "tests.hil.campaign.toy_kind"


@pytest.fixture(scope="module")
def toys(tmp_path_factory):
    """Build a campaign of toys in a directory of its own: `toys(name, configurations)`."""

    def build(name, configurations):
        out = tmp_path_factory.mktemp(name)
        maker = CaseMaker(KIND, MODULE, out / "shared")
        cases = maker.cases(configurations, "toys.toml")
        return SimpleNamespace(out=out, maker=maker, cases=cases, store=ResultStore(out))

    return build
