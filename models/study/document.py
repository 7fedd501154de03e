"""Study document (`study.json`): every table and curve of the published study on some trials.

Distances are in m; DI, R² and fractions are dimensionless. Keys of the tables, by type:

Test     trial_2, unseen_20deg, …: one set of held-out trials
Part     pooled, a payload in kg ("0.5"), or a phase of joint 2 ("phase_90deg")
Variant  with_di, without_di, estimated_di: the DI that a predictor gets
Degree   "1" to "6", of the polynomial
Source   observer, lagged, none: estimator of DI
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

import msgspec

from firmware_py.core.documents import Document, read_document
from firmware_py.core.output_files import write_whole
from models.predictor.document import TrialsSummary

Test = str
Part = str
Variant = str
Degree = str
Source = str
Payload = str

ByDegree = dict[Degree, float]
DistanceTable = dict[Part, dict[Variant, ByDegree]]
"""Distances in m of one test (paper, eq. 8 and Figs. 14 and 15)."""
Curve = tuple[float, ...]


class FoldErrors(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """Mean Euclidean distance of a cross-validation."""

    blocks_m: float  # Blocks of time left out
    # Payloads left out; absent if the training has one payload
    leave_one_payload_out_m: float | None = None
    # Distance by which the degree is chosen: payloads left out if there are several
    selection_m: float


class EstimatorScores(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Accuracy of one estimator of DI on one test."""

    r2_di: float  # R² of DI; negative where the estimate is worse than the mean
    rms_error_di: float  # Root mean square error of DI
    mean_euclidean_distance_m: ByDegree  # Distance in m of the predictors trained on this DI
    # Fraction of true DI's gain in distance; None if true DI gains nothing
    benefit_recovered: dict[Degree, float | None]


class BaselineErrors(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Mean Euclidean distances without a polynomial."""

    observer_tip: dict[Part, float]  # Distance in m of the plant observer's tip
    rigid_kinematics: dict[Part, float]  # Distance in m of a link that does not bend


class DeployedScores(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Accuracy of the robot's predictor on one test."""

    # In m, with the observer's DI and inputs clipped to the training box
    mean_euclidean_distance_m: float
    interval_coverage: dict[str, float]  # Fraction of rows inside the 95 % interval, per world axis
    # Mean over the axes that move: y of one joint, which cannot miss, does not count
    interval_coverage_mean: float
    interval_coverage_by_part: dict[Part, float]  # Mean over the axes that move, per part
    in_range_fraction: float  # Fraction of rows whose inputs lie in the training box


class TipPath(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Path of the end effector in the world frame (paper, Fig. 7)."""

    tip_x_m: Curve
    tip_y_m: Curve
    tip_z_m: Curve


class DiCurve(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True
):
    """DI over the joint angles of one trial (paper, Figs. 9 and 10)."""

    angle_1_rad: Curve
    angle_2_rad: Curve | None = None
    di: Curve


class ErrorCurves(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Distance over time with true DI, mean over payloads (paper, Figs. 12 and 13)."""

    time_s: Curve
    euclidean_distance_m: dict[Degree, Curve]


class DiEstimates(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """DI over time with the heaviest payload, measured and estimated."""

    time_s: Curve
    true: Curve
    observer: Curve
    lagged: Curve


class StudyCurves(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Curves of the figures; `path` and `di` are by payload and phase of the training trials."""

    path: dict[str, TipPath]
    di: dict[str, DiCurve]
    error: dict[Test, ErrorCurves]
    estimates: dict[Test, DiEstimates]


class StudyFinding(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Finding of the paper, tested on these trials."""

    claim: str
    holds: bool | None  # Whether it is reproduced; None if these trials cannot decide it
    text: str  # Result in one sentence with its figures


class StudyDocument(Document, frozen=True, kw_only=True):
    """Content of `study.json`."""

    VERSION: ClassVar[int] = 2
    MADE_BY: ClassVar[str] = "dropstitch train --study"

    dof: Annotated[int, msgspec.Meta(ge=1, le=2)]
    rows: str  # Which rows of the trials were used
    training: TrialsSummary
    # Held-out errors on the training trials alone
    cross_validation: dict[Variant, dict[Degree, FoldErrors]]
    mean_di: dict[Payload, float]  # Mean DI over the moving rows, by payload (paper, Fig. 11)
    # Mean DI over the moving rows with the other dof, by payload
    mean_di_other_dof: dict[Payload, float]
    chosen_degree: int  # Degree of the least `selection_m` of estimated_di
    tests: dict[Test, TrialsSummary]
    mean_euclidean_distance_m: dict[Test, DistanceTable]
    estimators: dict[Test, dict[Source, EstimatorScores]]
    baselines: dict[Test, BaselineErrors]
    deployed: dict[Test, DeployedScores]  # Scores of the robot's predictor
    series: StudyCurves
    # Findings of the paper, tested on these trials; none for another link than the paper's
    findings: tuple[StudyFinding, ...]


def read_study(path: Path) -> StudyDocument:
    return read_document(path, StudyDocument)


def write_study(path: Path, document: StudyDocument) -> None:
    """Write `study.json` on one line: indented it would be half of a bundle."""
    write_whole(path, msgspec.json.encode(document) + b"\n")
