"""Tuned numbers of the gap workflow, each with its effect and its origin."""

from __future__ import annotations

from typing import Final

import msgspec

from models.plant.parameter import AT_BOUND

__all__ = ["DEFAULT_SETTINGS", "GapSettings"]


class GapSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Tuned numbers of residuals, noise floor, search and tests of the gap workflow.

    The calibrated data files (`model_discrepancy.npz`, `null_distribution.json`,
    `equation_error.json`, `answers.json`) were measured with the default values. If you change
    those of the residuals, the noise floor or the estimation, measure the files again
    (`models.gap.training`). A fraction is relative to the quantity named. Residuals and d′ are in
    standard deviations of the noise floor, costs in their squares.

    Examples
    --------
    >>> stricter = GapSettings(false_discovery_rate=0.01)
    >>> stricter.false_discovery_rate, stricter.most_named
    (0.01, 3)
    """

    # Prior distributions
    nuisance_prior_fraction: dict[str, float] = msgspec.field(
        default_factory=lambda: {
            "_stiffness_": 0.02, "root_limit_moment_nm": 0.008, "_damping_": 0.04,
            "link_mass_kg": 0.02,
        }
    )  # fmt: skip
    """Standard deviation of a nuisance parameter of the link, as a fraction of its value, by a part
    of its name: a fifth of 10 % for stiffness and mass, 20 % for damping [assumed] and 4 % for the
    limit moment, which stayed within 5 % on links of drawn rigs that changed. A fifth, since errors
    of equations make the cost of a large gap some 25 times too certain (docs/decisions.md, "Gap
    workflow"). The limit moment changes with the pressure, as the stiffness does: fixed, a change
    of the link went into the variation of pressure between trials."""
    bound_prior_fraction: float = 0.25
    """Standard deviation of a nuisance parameter of other loads, as a fraction of the distance
    between its bounds [assumed]."""
    plant_is_known: bool = False
    """Whether a plant of another load was identified, and on none of these trials: then its values
    are known. `models.gap.diagnosis.diagnose` sets it."""
    known_value_fraction: float = 0.05
    """Standard deviation of a nuisance parameter of such a plant, as a fraction of its value
    [assumed]."""
    frame_shift_prior_m: float = 0.005
    """Standard deviation of the mocap frame's shift that is common to all trials [assumed]."""
    frame_turn_prior_rad: dict[str, float] = msgspec.field(
        default_factory=lambda: {"joint": 0.0005, "other": 0.005}
    )
    """Standard deviation of the mocap frame's turn, common to all trials, about a joint's axis and
    about another one [assumed]: 5 mrad as the shift over a metre; about a joint's axis 0.1 mm over
    the 0.2 m of a calibration square, since a larger turn there looks like an encoder's offset."""
    clock_limit_s: float = 0.010
    """Clocks that differ by no more than this count as synchronised [assumed]."""

    # Search over the joints
    separate_joints: bool = False
    """Whether every effect has a strength for each joint. Servos of a type have the same effects,
    so one strength for both joints is tried first. A fault of one servo is searched for where that
    leaves a gap that no effect of the catalogue explains."""
    separate_joints_gain_ratio: float = 1.5
    """Fall of the cost by one effect with a strength for each joint, over the fall by the best
    effect with one strength. Above this ratio separate strengths are searched first [assumed]; if
    they name nothing, the search with one strength follows."""

    # Noise floor
    nuisance_floor_rounds: int = 2
    """Times that floor and nuisance are estimated in turn, where the plant file carries no floor
    [assumed]."""
    model_error_left_fraction: float = 0.35
    """Fraction of the plant's own error (in amplitude) that remains after its mean curve and the
    patterns of `models.gap.estimation.model_discrepancy` are subtracted; measured by
    `models.gap.training.plant_error` on rigs left out (see `discrepancy_patterns`)."""
    equation_error_fraction: float = 0.1
    """Fraction of a named effect's contribution that its equation may miss; measured: the plant
    reproduces the link itself to 6 to 10 %."""
    equation_error_repeated_fraction: float = 0.8
    """Fraction of an equation's error (in power) that repeats when a trial is repeated [assumed]:
    near instability no two trials are alike."""
    amplified_scatter_limit: float = 2.7
    """Power by which repetitions differ, over what the floor expects, above which the floor at
    their payload grows: the 95 % quantile of 78 ratios on unchanged links of 13 drawn rigs for
    tuning, nothing hidden. On 26 changed links of these rigs residuals above 1.63 noise floors
    (1.8, 2.3, 3.2, 5.0) came with higher ratios only."""
    odd_trial_ratio: float = 3.0
    """Ratio of a trial's error to that of the other trials of its motion, in noise floors, above
    which it is left out as an outlier, where no trial repeats it [assumed]."""
    odd_repetition_ratio: float = 2.0
    """The same ratio to its repetitions: a quarter more than the largest of 180 pairs of
    repetitions on 12 drawn rigs for tuning, effects hidden in 48 of 60 data sets."""
    odd_variation_sd: float = 7.0
    """Difference of two repetitions in friction, clock, place of the payload or pressure, in
    standard deviations of their usual difference, above which one of them is left out as an outlier
    [assumed]; of 78 pairs of repetitions on 4 drawn rigs for tuning, effects hidden in 19 of 26
    data sets, the largest difference was 5.7, of friction beside a hidden backlash."""
    discrepancy_patterns: int = 48
    """Number of patterns of the plant's own error. Measured by `models.gap.training.plant_error`
    on 66 links of 22 rigs of drawn structure, each rig left out in turn: 48 patterns lower the
    median of the mean squared error, without noise, from 0.36 to 0.23 floors, and its 90th
    percentile from 1.41 to 0.95; 16 patterns to 0.30 and 1.13."""

    # Estimation
    floor_fit_steps: int = 12
    """Most steps of a fit while the noise floor is measured [assumed]."""
    converged_cost_fall: float = 0.3
    """Predicted fall of twice the cost below which a fit stops [assumed]."""
    line_search_fractions: tuple[float, ...] = (1.0, 0.5, 0.2, 0.05)
    """Fractions of a step that are tried in turn [assumed]."""
    nuisance_fit_steps: int = 20
    """Most steps of the nuisance fit, and of the fit after an inclusion [assumed]."""
    candidate_start_steps: int = 2
    """Most steps of a candidate's fit from each start [assumed]."""
    candidate_fit_steps: int = 8
    """Most further steps of a candidate's fit, from the best of its starts [assumed]."""
    candidate_relative_fall: float = 1e-3
    """Relative fall of the cost below which a candidate's fit takes exact derivatives [assumed]."""
    restart_steps: int = 3
    """Most steps of a fit from another strength (`restart_bound_fractions`) [assumed]."""
    deletion_steps: int = 5
    """Most steps of a fit without an effect that was included earlier [assumed]."""
    normal_ridge_fraction: float = 1e-10
    """Ridge of a scaled normal equation: keeps it regular [assumed]."""
    held_out_ridge_fraction: float = 1e-9
    """Ridge of a scaled normal equation in cross-validation, where fewer trials determine it
    [assumed]."""
    nuisance_bias_limit_sd: float = 10.0
    """Least |z| of the nuisance that counts as more than chance. Measured on drawn rigs for tuning:
    up to 9.4 where nothing or one effect was hidden; 15 to 24 of eccentricity where a denied
    payload offset had gone into it; of friction 11 to 28 in nine of twelve data sets with Coulomb
    friction beside another effect, 6 to 9 in three; 13 and 25 of pressure beside softening."""
    nuisance_bias_kinds: tuple[str, ...] = ("eccentricity_m", "frame_m", "friction", "pressure")
    """Kinds of trial variation that are tested for bias; pressure only where the link is the same
    (`same_link`). The clock is not tested: the mean of the clocks is held at zero."""

    # Effect search
    widening_rounds: int = 2
    """Times that the floor is widened by a fraction of the gap and the nuisance refitted
    [assumed]."""
    refitted_candidates: int = 5
    """Candidates of a round that are refitted, best first [assumed]."""
    refit_growth: float = 1.5
    """Factor by which a refit may raise a screened candidate's gain, or the gain that derivatives
    predict; a further round refits only candidates that may then pass. Measured on 12 diagnoses of
    drawn rigs: up to 1.49, 1.3 without a dead zone."""
    refitted_pairs: int = 3
    """Pairs of effects that are refitted, best first [assumed]."""
    most_named: int = 3
    """Effects that one diagnosis may include [assumed]."""
    further_effect_fraction: float = 0.1
    """Fraction of the d′ already named that a further effect must have beyond its own least d′: the
    equation error of the first effect looks like another effect [assumed]."""
    further_effect_fraction_by_port: dict[str, float] = msgspec.field(
        default_factory=lambda: {"stiffness": 0.2, "bend_torque": 0.2}
    )
    """`further_effect_fraction` by the port of the effect named before [assumed]."""
    inconsistent_further_effect_fraction: float = 0.35
    """`further_effect_fraction` where the strength of the further effect is not consistent.
    Measured on single hidden effects: stand-ins for an equation's error reached 0.25 of the
    first."""
    open_residual: float = 2.0
    """Mean squared residual, in noise floors, above which fits from further strengths and pairs of
    effects are tried [assumed]."""
    restart_bound_fractions: tuple[float, ...] = (-0.5, -0.25, -0.1, 0.1, 0.25, 0.5)
    """Fractions of its bounds from which an included effect is fitted again where the residual is
    large [assumed]."""
    indistinguishable_separation: float = 3.0
    """d′ below which two effects cannot be told apart
    (docs/sources.md, "Naming a missing effect")."""
    distant_bound_fractions: tuple[float, ...] = (0.1, 0.3)
    """Fractions of its bounds at which an effect is also tried: a lag of the current of 0.02 s and
    0.06 s, or one of 0.05 s and 0.15 s on the flexible link, which needs 0.16 s (docs/sources.md,
    "Real recordings"). For the plant's own link the first fraction is enough to tell whether a
    strength far from zero lowers the cost."""
    ladder_bound_fractions: tuple[float, ...] = (0.3, 0.5, 0.65, 0.75, 0.8, 0.85, 0.9)
    """Fractions of its bound at which an effect with a dead zone is tried [assumed]."""
    ladder_refinements: int = 5
    """Times that the ladder of these strengths is refined around its best rung [assumed]."""
    menu_rest_samples: int = 60
    """Samples at rest before a motion that is simulated to separate look-alikes [assumed]."""
    swapped_payload_kg: float = 2.0
    """Payload of the payload swap among these motions; none where trials carried more than half of
    it [assumed]."""

    # Held-out errors
    held_out_steps: int = 3
    """Most steps of the fit without a fold, starting from the fit of all trials [assumed]."""
    held_out_time_blocks: int = 4
    """Blocks of time that are left out in turn where there is one trial: few enough that each holds
    several motions of the available recordings, 5 to 6 s [assumed]."""
    least_block_rows: int = 500
    """Fewest rows of a block that begins in motion; in shorter trials rows are masked [assumed]."""
    least_held_out_fall_fraction: float = 0.03
    """Least fall of the held-out error that a further effect must bring where no noise floor is
    learned [assumed]."""
    harm_fraction: float = 0.05
    """Rise of a signal's held-out error, relative to the plant that was diagnosed, above which a
    plant is refused (the project's requirement)."""
    at_bound_fraction: float = AT_BOUND
    """Distance from a bound, as a fraction of the range, within which a value counts as at the
    bound [assumed]."""

    most_alternatives: int = 2
    """Effects that are tried in turn instead of one that was refused [assumed]."""

    # Strength consistency
    consistency_bands: int = 3
    """Frequency bands, of equal width on a logarithmic scale [assumed]."""
    tolerated_difference_fraction: float = 0.3
    """Fraction by which the strengths of an effect may differ: two hinges that stand for a beam, or
    a smooth sign, miss that much. Measured: correctly named effects stayed below 0.17 on 45
    development cases (backlash 0.22), below 0.27 on drawn rigs with presliding friction. Of further
    effects on 16 drawn rigs, stand-ins differed by 0.36 and more, one correct name by 0.26."""
    inconsistency_probability: float = 1e-3
    """Probability of a larger χ² below which strengths count as different [assumed]."""
    least_block_information: float = 1.0
    """Least information of a block, or of a direction of the blocks, that counts [assumed]."""

    # Change of the link since the plant was identified, relative to the links of the calibration
    same_link: bool = False
    """Whether the user states that the link is the one that the plant was identified on."""
    least_link_change: float = 0.3
    """Least change that counts: the fit estimates it with an error of some per cent [assumed]. The
    d′ that an effect must reach on an unchanged link does not depend on it."""
    largest_link_change: float = 1.0
    """Largest change that counts: that of the calibration. A hidden effect that stiffens or softens
    looks like a large change of the link; without this limit it would raise the d′ that it needs.
    """

    # Null distribution
    null_quantile: float = 0.98
    """Quantile of the residual on data sets without an effect up to which it counts as noise
    [assumed]."""
    least_threshold: float = 4.5
    """Least d′ of a named effect, in standard deviations of its d′ without a gap. Measured: at 4.0,
    which Gaussian noise of 25 effects would pass in one of 500 data sets, an effect was named in 4
    of 105 data sets without one, at 4.25, 4.43, 4.47 and 7.5; of 66 hidden effects none was named
    below 4.5."""
    uncalibrated_threshold: float = 5.0
    """Least d′ of a named effect for loads without a measured null distribution [assumed]."""
    uncalibrated_residual_limit: float = 1.6
    """Mean square up to which a residual counts as noise for these loads [assumed]."""

    # Certainty
    noise_residual: float = 1.25
    """Mean square up to which a residual counts as noise: 6 % of 190 data sets without an effect
    were above it."""

    # Localisation
    location_bands_hz: tuple[float, ...] = (0.0, 0.3, 0.8, 2.0, 4.0, 8.0)
    """Edges of the frequency bands [assumed]."""
    location_phases: int = 8
    """Number of parts of a period [assumed]."""
    standing_rate_rad_s: float = 0.02
    """Joint rate below which the motion counts as standing [assumed]."""
    bootstrap_block_s: float = 1.0
    """Length of a block of the bootstrap [assumed]."""
    bootstrap_draws: int = 400
    """Draws of the bootstrap [assumed]."""
    false_discovery_rate: float = 0.05
    """Rate of false discoveries (Benjamini and Hochberg 1995)."""
    least_region_samples: int = 20
    """Fewest samples of a region that is tested: one must have more [assumed]."""
    least_band_coefficients: int = 4
    """Fewest coefficients of a band that is tested [assumed]."""
    one_sided_fraction: float = 0.5
    """Mean of a residual, as a fraction of its root mean square, above which its sign is reported
    [assumed]."""
    payload_trend_ratio: float = 1.5
    """Ratio of the gap at the heaviest payload to that at the lightest above which the gap is
    reported to grow with payload [assumed]."""

    # Waterfall
    waterfall_steps: int = 12
    """Most steps of each fit [assumed]."""
    waterfall_relative_fall: float = 1e-3
    """Relative fall of the cost below which these fits compute exact derivatives [assumed]."""


DEFAULT_SETTINGS: Final = GapSettings()
"""Settings that the calibrated data files were measured with."""
