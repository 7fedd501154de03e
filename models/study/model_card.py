"""The model card: what a bundle is, for whom, how well it does and where it ends, for people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from firmware_py.inference.bundle import Manifest

MM: Final = 1e3


def model_card(manifest: Manifest, document: Mapping[str, Any]) -> str:
    """Write `MODEL_CARD.md` from the manifest and the study's tables."""
    sections = (
        _purpose(manifest),
        _data(document),
        _figures(manifest, document),
        _estimation(document),
        _limits(manifest, document),
        _findings(document),
    )
    return "\n\n".join(sections) + "\n"


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _purpose(manifest: Manifest) -> str:
    ranges = _table(
        ("input", "unit", "trained from", "to"),
        [
            (f"`{q.name}`", q.unit, f"{q.minimum:.4g}", f"{q.maximum:.4g}")
            for q in manifest.features
        ],
    )
    return f"""# End effector of a drop-stitch link, {manifest.dof}DOF

A polynomial of degree {manifest.degree} that predicts where the tip of an inflatable link is \
from what its servos measure and the Deformation Index (DI), every {MM * manifest.period_s:g} ms. \
On the robot DI is estimated, not seen: the plant observer (`observer.fmu`, added by \
`python -m fmu build --unit observer`) drives the identified link with the measured angle and \
current. The predictor was trained on the observer's DI.

Made for this link, its servos, its pressure and its motions. It is no safety device: stop the \
robot by limits of its own.

{ranges}

Inputs outside their range are clipped into it and `in_range` turns 0; a NaN does the same. \
`tip_m` is in the world frame (z up, origin where the joint axes meet). `half_width_m` is half \
the width of a 95 % prediction interval per axis; it grows outside the training data."""


def _data(document: Mapping[str, Any]) -> str:
    def line(role: str, part: Mapping[str, Any]) -> tuple[str, ...]:
        payloads = ", ".join(f"{kg:g}" for kg in part["payload_kg"])
        amplitudes = ", ".join(f"{rad:.3f}" for rad in part["amplitude_rad"])
        return role, str(len(part["trials"])), payloads, amplitudes, f"`{part['sha256'][:12]}`"

    rows = [line("trained on", document["training"])]
    rows += [line(f"tested on {name}", part) for name, part in document["tests"].items()]
    header = ("role", "trials", "payload in kg", "amplitude in rad", "SHA-256")
    return "## Data\n\n" + _table(header, rows)


def _figures(manifest: Manifest, document: Mapping[str, Any]) -> str:
    degrees = list(document["cross_validation"]["estimated_di"])
    rows = []
    for name, table in document["mean_euclidean_distance_m"].items():
        for variant, by_degree in table["pooled"].items():
            values = [f"{MM * by_degree[d]:.2f}" for d in degrees]
            rows.append((name, variant.replace("_", " "), *values))
    validated = document["cross_validation"]["estimated_di"]
    rows.append(("cross-validation", "estimated di",
                 *(f"{MM * validated[d]['selection_m']:.2f}" for d in degrees)))  # fmt: skip
    baselines = "; ".join(
        f"on {name} the observer's own tip {MM * part['observer_tip']['pooled']:.2f} mm, a link "
        f"that does not bend {MM * part['rigid_kinematics']['pooled']:.1f} mm"
        for name, part in document["baselines"].items()
    )
    several = "leave_one_payload_out_m" in validated[degrees[0]]
    folds = "each payload left out" if several else "five blocks of each run, with 1 s gaps"
    return f"""## How well it does

Mean Euclidean distance in mm over all payloads, by degree. Degree {manifest.degree} was chosen \
by cross-validation on the training trials ({folds}), never on a test.

{_table(("test", "predictor", *degrees), rows)}

Without a polynomial: {baselines or "no test was given"}."""


def _estimation(document: Mapping[str, Any]) -> str:
    rows = []
    for name, estimators in document["estimators"].items():
        for source, part in estimators.items():
            share = part["benefit_recovered"]["3"]
            shown = "none to recover" if share is None else f"{100 * share:.0f} %"
            rows.append((name, source, f"{part['r2_di']:.3f}", shown))
    header = ("test", "DI from", "R² of DI", "share of true DI's benefit at degree 3")
    return "## DI without motion capture\n\n" + _table(header, rows)


def _limits(manifest: Manifest, document: Mapping[str, Any]) -> str:
    coverage = "\n".join(
        f"- On {name} the 95 % interval held the tip in "
        f"{100 * part['interval_coverage_mean']:.1f} % of the rows and axes; "
        f"{100 * part['in_range_share']:.1f} % of the rows were in range."
        for name, part in document["deployed"].items()
    )
    validated = document["cross_validation"]["estimated_di"][str(manifest.degree)]
    payload = validated.get("leave_one_payload_out_m")
    unseen = (
        f"\n- A payload that training did not see: {MM * payload:.1f} mm (each payload left out "
        "in turn)."
        if payload is not None
        else ""
    )
    return f"""## Where it ends

{coverage}{unseen}
- The interval is calibrated on payloads left out of training, so it is wide for those that were \
not; on motions unlike the training's expect less coverage.
- Another pressure, temperature, link or servo needs new trials."""


def _findings(document: Mapping[str, Any]) -> str:
    lines = [f"- **{f['claim']}.** {f['text']}" for f in document["findings"]]
    return "## The published study's findings on these trials\n\n" + "\n".join(lines)
