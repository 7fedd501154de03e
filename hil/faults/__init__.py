"""Faults of wire, servo, host and process: injected by name and seed, judged against a table.

`rates` is what a line does to a share of the packets at random (`hil sil --faults`). The campaign
(`hil faults`) is the rest: `table` says which faults there are and what must happen, `plan` injects
them, `witness` is what the servos saw, `virtual`, `live` and `process` run a case each on its line,
`observe` puts record and witness together, `verdict` judges, `campaign` runs everything.
"""

from hil.emulator.line_faults import KINDS, LATE_NS, FaultPlan, parse_rates

__all__ = ["KINDS", "LATE_NS", "FaultPlan", "parse_rates"]
