# The library of dropstitch: every public name, once. __init__.py imports a name from the module
# listed here on first access; docs/library.md explains each name.

from firmware_py.core.errors import DropstitchError as DropstitchError
from firmware_py.core.errors import InputError as InputError
from firmware_py.inference.batch_prediction import Predictions as Predictions
from firmware_py.inference.bundle import ModelBundle as ModelBundle
from firmware_py.log.recording import Recording as Recording
from firmware_py.log.recording import read_recording as read_recording
from firmware_py.core.motion import Motion as Motion

from models.trials.trial import Trial as Trial
from models.trials.trial import TrialMeta as TrialMeta
from models.trials.trial import TrialSet as TrialSet
from models.trials.files import read_trial as read_trial
from models.trials.files import read_trials as read_trials
from models.trials.files import write_trial as write_trial
from models.trials.importing import ImportedTake as ImportedTake
from models.trials.importing import import_recordings as import_recordings
from models.trials.data_frames import as_data_frame as as_data_frame
from models.trials.data_frames import trial_frame as trial_frame
from models.trials.data_frames import trial_from_frame as trial_from_frame
from models.trials.data_frames import trials_frame as trials_frame
from models.trials.deformation import deformation_index as deformation_index
from models.rig.drawn import rig_named as rig_named
from models.rig.parameters import RigParameters as RigParameters
from models.rig.protocol import TrialCase as TrialCase
from models.rig.protocol import run_case as run_case
from models.plant.plant import Plant as Plant
from models.plant.plant import read_plant as read_plant
from models.plant.document import Evaluation as Evaluation
from models.plant.simulation.runner import simulate_plant as simulate_plant
from models.plant.identification.identify import Identification as Identification
from models.plant.identification.identify import identify as identify
from models.plant.identification.evaluation import Comparison as Comparison
from models.plant.identification.evaluation import compare_with_trials as compare_with_trials
from models.plant.identification.evaluation import evaluate_plant as evaluate_plant
from models.plant.identification.evaluation import tip_rms_m as tip_rms_m
from models.gap.settings import GapSettings as GapSettings
from models.gap.diagnosis import diagnose as diagnose
from models.gap.report.gap_json import GapDocument as GapDocument
from models.gap.report.gap_results import Diagnosis as Diagnosis
from models.gap.report.gap_results import gap_document as gap_document
from models.gap.report.gap_words import gap_in_words as gap_in_words

from models.bundle.train import Training as Training
from models.bundle.train import train as train
from models.plan.plan import PathPlan as PathPlan
from models.plan.plan import plan as plan

from fmu.bundle_observer import add_observer as add_observer
from fmu.fmu_builder import build_fmu as build_fmu
from fmu.fmu_checker import FmuReport as FmuReport
from fmu.fmu_checker import check_fmu as check_fmu
from fmu.fmpy_run import FmuRun as FmuRun
from fmu.fmpy_run import simulate_fmu as simulate_fmu

from hil.sil import SilOptions as SilOptions
from hil.sil import SilResult as SilResult
from hil.sil import run_sil as run_sil

__version__: str
