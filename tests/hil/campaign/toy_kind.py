"""Kind of cases that cost nothing, and can refuse, fail, or kill their worker."""

import os
import signal
import time
from typing import Annotated

from msgspec import Meta

from firmware_py.core.errors import InputError
from hil.campaign.kinds.case_kind import CaseKind, CaseOptions


class ToyOptions(CaseOptions, frozen=True, kw_only=True):
    value: Annotated[float, Meta(ge=0)]
    act: str = "count"
    file: str | None = None
    measures_time: bool = False

    def files(self):
        return {} if self.file is None else {"file": self.file}

    @property
    def in_real_time(self):
        return self.measures_time


def run_toy(options, scratch):
    print("about to", options.act)
    if options.act == "refuse":
        raise InputError(scratch, "cannot be used", "take another")
    if options.act == "raise":
        raise ZeroDivisionError("division of toys")
    if options.act == "die":
        time.sleep(0.5)  # a nanny of dask does not start anew what dies while it starts
        os.write(2, b"last words\n")
        os._exit(7)
    if options.act == "take long":
        time.sleep(0.3)
    if options.act == "never end":  # the pipe of the tests closes with the worker
        os.open(os.environ["TOY_PIPE"], os.O_WRONLY)
        signal.pause()
    return {"square": options.value**2, "off_m": float("nan"), "deep": {"list": [1, 2]}}


KIND = CaseKind(
    name="toy", options=ToyOptions, run=run_toy, sources=("hil/campaign/kinds",),
    figures={"square": "the square", "off_m": "off"},
)  # fmt: skip
