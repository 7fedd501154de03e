"""Software in the loop: the robot's own loop, an emulated line, a plant or the rig behind it.

`run_sil` runs it, `write_results` judges it and writes what it leaves.
"""

from hil.sil.sil_loop import SilResult
from hil.sil.sil_options import LineKind, SilOptions
from hil.sil.sil_results import write_results
from hil.sil.sil_run import run_sil

__all__ = ["LineKind", "SilOptions", "SilResult", "run_sil", "write_results"]
