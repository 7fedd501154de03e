"""Targets in the code beside those that the documentation states for the same figures."""

import re

import pytest

from bench.claims.claim_table import ROOT, read_claims
from firmware_py.realtime import targets
from firmware_py.realtime.targets import DI_GAIN_FRACTION, PATH_RMS_TO_RIGID, PLANT_TIP_RMS_M

CLAIMS = {claim.name: claim for claim in read_claims()}
TRIALS = {
    "held-out trials": "held-out", "unseen 20° motion": "20deg", "unseen multisine": "multisine",
}  # fmt: skip
OF_CODE = {
    **{f"loop-own-p50-{dof}dof": targets.OWN_COST_P50_NS for dof in (1, 2)},
    **{f"loop-own-p99-{dof}dof": targets.OWN_COST_P99_NS for dof in (1, 2)},
    **{f"plant-tip-{TRIALS[title]}-{dof}dof": limit
       for title, limits in PLANT_TIP_RMS_M.items() for dof, limit in limits.items()},
    **{f"study-gain{part}-{dof}dof": DI_GAIN_FRACTION[test]
       for test, part in (("trial_2", ""), ("unseen_20deg", "-20deg")) for dof in (1, 2)},
    **{f"plans-{known}-{dof}dof": 1 / ratio
       for known, ratio in PATH_RMS_TO_RIGID.items() for dof in (1, 2)},
    **{f"plan-speeds-{known}": 1 / ratio for known, ratio in PATH_RMS_TO_RIGID.items()},
}  # fmt: skip


@pytest.mark.parametrize("name", OF_CODE)
def test_code_and_documentation_have_one_target(name):
    claim = CLAIMS[name]
    stated = claim.at_most if claim.at_most is not None else claim.at_least
    assert stated == pytest.approx(OF_CODE[name] * claim.factor, rel=1e-12)


def test_no_module_states_a_target_of_its_own():
    """Numbers of the targets beside a word for a limit, outside `firmware_py.realtime.targets`."""
    number = re.compile(
        r"(TARGET|P99|P50|COST|LIMIT_NS)\w*(: Final)? = (1_500_000|1_000_000|500_000|1\.5e6|1e6)\b"
    )
    found = [
        str(path.relative_to(ROOT))
        for room in ("firmware_py", "models", "fmu", "hil", "bench")
        for path in (ROOT / room).rglob("*.py")
        if number.search(path.read_text(encoding="utf-8"))
    ]
    assert found == ["firmware_py/realtime/targets.py"]
