"""Software in the loop: the robot's control loop against emulated servos and a simulated plant."""

from hil.sil.sil_options import LineKind, SilOptions
from hil.sil.sil_results import SilResult
from hil.sil.sil_run import LOG_NAME, run_sil

__all__ = ["LOG_NAME", "LineKind", "SilOptions", "SilResult", "run_sil"]
