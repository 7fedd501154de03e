"""Kind of cases that cost nothing, and can refuse, fail, or kill their worker."""

import os
import signal
import time
from typing import ClassVar

from firmware_py.core.errors import InputError
from hil.campaign.kinds.case_kind import CaseConfig, CaseKind


class ToyConfig(CaseConfig, frozen=True, kw_only=True):
    value: float
    act: str = "count"
    file: str | None = None
    measures_time: bool = False


class ToyKind(CaseKind):
    name = "toy"
    config = ToyConfig
    rooms = ("hil/campaign/kinds",)
    figures: ClassVar = {"square": "the square", "off_m": "off"}

    def files(self, config):
        return {} if config.file is None else {"file": config.file}

    def check(self, config):
        if config.value < 0:
            raise InputError("value", f"is {config.value:g}", "give 0 or more")

    def in_real_time(self, config):
        return config.measures_time

    def run(self, config, context):
        print("about to", config.act)
        if config.act == "refuse":
            raise InputError(context.scratch, "cannot be used", "take another")
        if config.act == "raise":
            raise ZeroDivisionError("division of toys")
        if config.act == "die":
            time.sleep(0.5)  # a nanny of dask does not start anew what dies while it starts
            os.write(2, b"last words\n")
            os._exit(7)
        if config.act == "never end":  # the pipe of the tests closes with the worker
            os.open(os.environ["TOY_PIPE"], os.O_WRONLY)
            signal.pause()
        context.parts_s["thinking"] = 0.25
        return {"square": config.value**2, "off_m": float("nan"), "deep": {"list": [1, 2]}}


KIND = ToyKind()
