"""The rule of naming, on trials that depend linearly on every strength.

There d′ of a set is known: it follows from the projection of the trials on the set's directions. No
simulation is needed, and whatever differs from the projection is an error of search or rule.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from models.gap.decision.certainty import read_certainty
from models.gap.decision.naming import name_with_floor
from models.gap.estimation.gauss_newton import GaussNewton
from models.gap.estimation.nuisance_fit import NuisanceFit
from models.gap.residuals.fit_parameters import NUISANCE_PRIOR_FRACTION, effect_candidates
from models.gap.search.effect_search import EffectSearch
from models.plant.identification.residual_spectra import FitParameter
from models.plant.identification.trial_spectra import TrialGroup
from models.plant.plant import read_plant

PAYLOADS_KG, COUNT = (0.0, 0.0, 1.0, 1.0), 64
EFFECTS = (
    "viscous_friction", "coulomb_friction", "current_bias", "load_offset", "dead_time",
)  # fmt: skip
STRENGTH_OF_BOUND = 0.3  # Hidden strengths, and the unit of a direction
LINK_SEPARATION = 20.0  # d′ of one standard deviation of the link
LINK_DEVIATION = NUISANCE_PRIOR_FRACTION["link_mass_kg"]


class LinearResiduals:
    """Residuals that are linear in the fit parameters; noise has unit variance."""

    def __init__(self, link, directions, rows, joints):
        plant = self.plant = read_plant()
        self.trials = [
            SimpleNamespace(meta=SimpleNamespace(payload_kg=kg, dof=joints)) for kg in PAYLOADS_KG
        ]
        self.groups = [TrialGroup("motion", tuple(range(len(PAYLOADS_KG))), ("tip_x_m",), COUNT)]
        strengths = [effect_candidates(plant, name, 1)[name][0] for name in directions]
        mass = FitParameter("link_mass_kg", "nuisance", standard_deviation=LINK_DEVIATION)
        self.fit_parameters = [mass]
        self.fit_parameters += strengths
        units = np.array([STRENGTH_OF_BOUND * q.high for q in strengths])
        slopes = [
            link / LINK_DEVIATION,
            *(d / u for d, u in zip(directions.values(), units, strict=True)),
        ]
        self._slopes, self._rows, self.units = np.moveaxis(np.array(slopes), 0, -1), rows, units

    def residuals(self, values):
        return [self._rows - self._slopes @ values]

    def jacobian(self, values, wanted):
        return [self._slopes[..., wanted]]

    def as_counted(self, group, spectra):
        return spectra


def unit_floor():
    """Floor of white noise of unit variance, without an error of the plant's own."""
    known = {kg: {} for kg in PAYLOADS_KG}
    return SimpleNamespace(
        learned=True,
        whitener=lambda group, trials: np.tile(np.eye(len(trials)), (1, COUNT, 1, 1)),
        mean=lambda group, trials: np.zeros((len(trials), 1, COUNT)),
        curves_for=lambda group, trials: (known, "measured"),
    )


@pytest.fixture(scope="module")
def axes():
    """Orthogonal directions of unit length, which every payload shows alike.

    They are those of the effects, of the link and of something that is no candidate.
    """
    rng = np.random.default_rng(3)
    columns, _ = np.linalg.qr(rng.standard_normal((COUNT, len(EFFECTS) + 2)))
    shape = (len(EFFECTS) + 2, len(PAYLOADS_KG), 1, COUNT)
    return np.broadcast_to(columns.T[:, None, None], shape) / np.sqrt(len(PAYLOADS_KG))


def named(link, directions, rows, equation_error=0.1, joints=1):
    """Naming on trials with these directions of link and candidates, and these rows and noise."""
    noise = np.random.default_rng(4).standard_normal(rows.shape)
    residuals = LinearResiduals(link, directions, rows + noise, joints)
    estimator = GaussNewton(residuals, unit_floor())
    nothing = estimator.fit_nuisance(estimator.start())
    search = EffectSearch(NuisanceFit(estimator, estimator, nothing))
    return name_with_floor(search, read_certainty(), equation_error)


def trials_with(axes, separations, link_change=0.0, outside=0.0):
    """Directions of link and candidates, and the rows in which each has this d′; at 0 it is absent.

    `link_change`: in standard deviations. `outside`: d′ of what is no candidate.
    """
    *of_effects, of_link, of_rest = axes
    link, found = LINK_SEPARATION * of_link, zip(EFFECTS, separations, of_effects, strict=True)
    directions = {name: (d or 50.0) * axis for name, d, axis in found}
    rows = sum(d * axis for d, axis in zip(separations, of_effects, strict=True))
    return link, directions, rows + link_change * link + outside * of_rest


def test_effects_are_named_by_what_they_explain_and_with_their_strength(axes):
    naming = named(*trials_with(axes, (40.0, 0.0, 60.0, 0.0, 0.0)))
    assert naming.names == ("current_bias", "viscous_friction")
    assert naming.fit.separation == pytest.approx(np.hypot(40.0, 60.0), abs=2.0)
    residuals = naming.search.estimator.residuals
    found = naming.fit.point.values[1:] / residuals.units
    assert found == pytest.approx([1.0, 0.0, 1.0, 0.0, 0.0], abs=0.1)


def test_noise_names_nothing(axes):
    assert named(*trials_with(axes, np.zeros(5))).names == ()


@pytest.mark.parametrize(
    ("further", "equation_error", "is_named"),
    [
        (40.0, 0.1, True),
        (read_certainty().separation_of_nothing["identified"] - 4.0, 0.0, False),
        (read_certainty().separation_of_nothing["identified"] + 4.0, 0.0, True),
        (15.0, 0.2, False),
    ],
    ids=["clear", "as nothing reaches", "more than nothing reaches", "within the first's error"],
)
def test_a_further_effect_adds_more_than_nothing_does_and_than_an_equation_misses(
    axes, further, equation_error, is_named
):
    naming = named(*trials_with(axes, (further, 100.0, 0.0, 0.0, 0.0)), equation_error)
    expected = ("coulomb_friction", "viscous_friction") if is_named else ("coulomb_friction",)
    assert naming.names == expected


@pytest.mark.parametrize(
    ("link_change", "outside", "is_named"),
    [(1.0, 10.0, True), (4.0, 10.0, False), (4.0, 0.0, True)],
)
def test_on_another_link_a_further_effect_leaves_nothing_or_adds_more(
    axes, link_change, outside, is_named
):
    further = read_certainty().separation_of_nothing["other link"] + 4.0
    naming = named(*trials_with(axes, (further, 90.0, 0.0, 0.0, 0.0), link_change, outside))
    assert ("viscous_friction" in naming.names) is is_named
    assert naming.names[0] == "coulomb_friction"


@pytest.mark.parametrize("further", [20.0, 25.0, 40.0])
@pytest.mark.parametrize("outside", [0.0, 10.0, 18.0])
def test_something_is_named_where_the_stated_probability_is_more_than_one_half(
    axes, further, outside
):
    naming = named(*trials_with(axes, (25.0, further, 0.0, 0.0, 0.0), 4.0, outside))
    assert bool(naming.names) is (naming.answers.catalogue >= 0.5)


@pytest.mark.parametrize(
    ("joints", "link_change", "is_named"), [(1, 4.0, True), (2, 1.0, True), (2, 4.0, False)]
)
def test_two_joints_on_another_link_need_a_larger_separation(axes, joints, link_change, is_named):
    naming = named(*trials_with(axes, (25.0, 0.0, 0.0, 0.0, 0.0), link_change), joints=joints)
    assert naming.names == (("viscous_friction",) if is_named else ())


def test_no_more_than_three_effects_are_named(axes):
    fourth = read_certainty().separation_of_nothing["identified"] + 4.0
    naming = named(*trials_with(axes, (60.0, 50.0, 40.0, fourth, 0.0)), equation_error=0.0)
    assert naming.names == ("viscous_friction", "coulomb_friction", "current_bias")


@pytest.mark.parametrize(("difference", "is_named"), [(0.05, True), (0.3, False)])
def test_a_further_effect_has_the_same_strength_at_every_payload(axes, difference, is_named):
    link, directions, rows = trials_with(axes, (0.0, 80.0, 0.0, 0.0, 0.0))
    sign = np.where(np.array(PAYLOADS_KG) > 0, 1 + difference, 1 - difference)
    rows = rows + 60.0 * axes[0] * sign[:, None, None]
    assert ("viscous_friction" in named(link, directions, rows).names) is is_named


def test_a_pair_takes_the_place_of_a_third_that_looks_like_it(axes):
    """The third explains more than either of the two alone."""
    link, directions, rows = trials_with(axes, (50.0, 70.0, 0.0, 0.0, 0.0))
    between = (axes[0] + axes[1]) / np.sqrt(2)
    directions["load_offset"] = 60.0 * (0.95 * between + np.sqrt(1 - 0.95**2) * axes[3])
    naming = named(link, directions, rows)
    assert naming.rounds[0][0].candidates == ("load_offset",)
    assert naming.names == ("coulomb_friction", "viscous_friction")
