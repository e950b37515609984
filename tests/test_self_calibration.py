"""Self-calibration against known truths, injected into the static laboratory by the effects themselves."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import tulip_testbed as tt
from studies.hidden_effects.laboratories import draw_laboratory
from tests.edited_rows import within
from tests.effect_changes import statically
from tests.test_refusals import refuse
from tulip_testbed.calibration.families import (
    SOLE,
    TOLERANCES,
    check_tolerances,
    families_of,
    read_tolerances,
    tolerances_of,
)
from tulip_testbed.calibration.linear_model import linear_model
from tulip_testbed.calibration.member_columns import member_columns
from tulip_testbed.calibration.member_removal import members_removed, with_estimated_loads
from tulip_testbed.calibration.self_calibration import _share_of_last, least_determined, self_calibrate
from tulip_testbed.discovery.candidates import Fitted, candidates
from tulip_testbed.discovery.columns import effect_columns
from tulip_testbed.discovery.joint_fit import Data, gauss_newton
from tulip_testbed.discovery.patterns import patterns
from tulip_testbed.discovery.selection import _may_be_usual
from tulip_testbed.discovery.unusual_members import too_wide
from tulip_testbed.effects.catalogue import catalogue
from tulip_testbed.effects.instance import instances_of, removed
from tulip_testbed.experiments.identify import identify, warn_of_unrest
from tulip_testbed.identification.base_parameters import standard_parameters
from tulip_testbed.identification.estimators import MIXED_MODEL
from tulip_testbed.identification.noise_structure import NoiseStructure, groups
from tulip_testbed.identification.observation import observe
from tulip_testbed.identification.residual_channels import (
    ROWS,
    TWIST,
    center,
    constants_of_stances,
    fields,
    more_as_read,
    packed,
    residuals,
    residuals_in_use,
    sensitivity,
    total_force,
    unpacked,
)
from tulip_testbed.identification.residual_noise import noise_of
from tulip_testbed.sim.random_robots import draw_robot
from tulip_testbed.sim.rig import preset_rig

FORCE_PLATE = tt.SensorSheet(1e-4, None, 0.1, None, (4e-4, 4e-4, 1e-3))


@pytest.fixture(scope="module")
def ordinary(robot, plan, nominal):
    """A laboratory in which all members of four families are off: run, true values by family."""
    rng = np.random.default_rng(5)
    chosen = ("encoder-offset", "cell-gain", "joint-compliance", "link-length")
    true = {}
    for family in families_of(robot, tolerances_of(FORCE_PLATE)):
        if family.name in chosen:
            size = 0.7 * family.tolerance * rng.standard_normal(len(family))
            true[family.name] = family, np.abs(size) if family.positive else size
    hidden = tuple(i for family, values in true.values() for i in family.instances(values))
    run = tt.Laboratory(robot, "force-plate", hidden=hidden).run(plan, 1001, "statics")
    return run, {name: values for name, (_, values) in true.items()}


@pytest.fixture(scope="module")
def observed(ordinary, nominal):
    return observe(ordinary[0].measurements, nominal)


@pytest.fixture(scope="module")
def found(observed):
    return self_calibrate(observed)


def test_members_and_base_parameters_are_recovered(ordinary, found, plan):
    run, true = ordinary
    for one in found.families:
        z = (one.value - true.get(one.family.name, 0.0)) / one.standard_error
        assert np.abs(z).max() < 4.5, one.family.name
        inside = (one.interval95[:, 0] <= one.value) & (one.value <= one.interval95[:, 1])
        assert inside.all() or one.family.positive
        assert (one.interval95 >= 0).all() or not one.family.positive
        assert (one.interval95[:, 1] > 1.959 * one.standard_error).all() or not one.family.positive
    error = found.theta - run.laboratory.true_base_parameters(plan)
    assert error @ np.linalg.solve(found.covariance, error) < 52.6  # 99.9 % of chi-square with 25
    plain = identify(run.measurements, run.laboratory.robot, estimator=MIXED_MODEL).full
    wrong = plain.value - run.laboratory.true_base_parameters(plan)
    assert wrong @ np.linalg.solve(plain.covariance, wrong) > 500


def test_a_family_is_wider_than_usual_where_the_likelihood_excludes_its_tolerance(observed, found):
    name, tolerance = "encoder-offset", tolerances_of(FORCE_PLATE).value["encoder-offset"]
    narrow = self_calibrate(observed, {name: tolerance / 8})
    as_stated, as_narrow = (
        next(one for one in calibration.families if one.family.name == name)
        for calibration in (found, narrow)
    )
    assert as_narrow in too_wide(narrow)
    assert not _may_be_usual(narrow, as_narrow)
    assert _may_be_usual(found, as_stated)


def test_spreads_tell_which_families_are_there(ordinary, found):
    spread = {one.family.name: one.spread for one in found.families}
    for name, values in ordinary[1].items():
        tolerance = next(o.family.tolerance for o in found.families if o.family.name == name)
        assert spread[name] == pytest.approx(np.sqrt((values**2).mean()) / tolerance, rel=0.7)
    assert spread["encoder-gain"] < 0.2  # exact, and the data show it


def test_effects_are_put_back_as_they_are_removed(ordinary, found, robot, nominal):
    """How a floor that slopes tilts the swing foot depends on the zeros of encoders."""
    observed = observe(ordinary[0].measurements, nominal)
    effects = instances_of(["sole-compliance=0.001", "tilt=0,0.03"], robot)
    both = dataclasses.replace(found, effects=effects)
    clean, members_out = both.cleaned(observed), both.without_members(observed)
    assert np.abs(packed(members_out) - packed(clean)).max() > 0.01
    assert packed(removed(members_out, effects)) == pytest.approx(packed(clean), abs=1e-6)


def test_exchanged_cells_keep_their_own_members(ordinary, found, robot, nominal):
    """Two exchanges of a plate: their order counts."""
    observed = observe(ordinary[0].measurements, nominal)
    pairs = ("front_left,rear_right", "rear_right,rear_left")
    tilt, *exchanged = instances_of(["tilt=0,0.03", *(f"swapped-cells:left={one}" for one in pairs)], robot)
    assert [one.name for one in catalogue().values() if one.exchanges] == ["swapped-cells"]
    both = dataclasses.replace(found, effects=(tilt, *exchanged))
    swapped = removed(observed, exchanged[::-1])  # as exchanging them does
    restored = removed(both.without_members(swapped), both.effects)
    plain = dataclasses.replace(found, effects=(tilt,)).cleaned(observed)
    assert packed(restored) == pytest.approx(packed(plain), abs=1e-6)


def test_zeros_that_wander_are_estimated_however_they_wander(ordinary, nominal):
    """Paths of sines and of the square of time, not of the waves that the families have."""
    measured = ordinary[0].measurements
    t = (measured.time - measured.time.min()) / np.ptp(measured.time)
    rng = np.random.default_rng(3)
    forces, angles = measured.cell_forces.copy(), measured.joint_angles.copy()
    draws = rng.random((8, 3)) * (1.3, 6, 2)
    paths = np.array([np.sin(2 * np.pi * t * r + s) + u * t**2 for r, s, u in draws])
    paths -= paths.mean(axis=1, keepdims=True)
    forces += 0.3 * paths.T
    angles[:, 3] += 2e-4 * paths[0]
    observed = observe(dataclasses.replace(measured, cell_forces=forces, joint_angles=angles), nominal)
    wandering = self_calibrate(observed)
    still = self_calibrate(observed, {"cell-wander": 0.0, "encoder-wander": 0.0})
    family = next(one for one in wandering.families if one.family.name == "cell-wander")
    waves = np.sqrt(2) * np.cos(np.pi * np.outer(t, [1, 2, 3, 4])) / [1, 2, 3, 4]
    left = 0.3 * paths - family.value.reshape(8, 4) @ waves.T
    left -= left.mean(axis=1, keepdims=True)  # a constant is a matter of tare
    assert (left**2).mean() < 0.2 * ((0.3 * paths) ** 2).mean()
    assert wandering.solved.log_evidence > still.solved.log_evidence + 100
    assert wandering.solved.scales[1] < 0.9 * still.solved.scales[1]  # of the cells' noise


def test_what_the_regressor_absorbs_is_known_by_the_prior_only(found):
    determined = {one.family.name: one.determined for one in found.families}
    assert determined["encoder-offset"].all()
    assert not determined["cell-position-scale"].any()
    assert not determined["plate-translation"].all()


def test_the_budget_is_the_whole_variance(found):
    assert found.shares.sum(axis=0) == pytest.approx(np.ones(len(found.theta)))
    assert (found.shares > -1e-9).all()
    assert len(found.sources) == len(found.shares)


def test_a_tolerance_of_zero_leaves_the_family_out(observed, nominal):
    exact = dict.fromkeys(TOLERANCES, 0.0)
    assert not self_calibrate(observed, exact).families
    only = self_calibrate(observed, exact | {"encoder-offset": 0.01})
    assert [one.family.name for one in only.families] == ["encoder-offset"]
    stating = observe(dataclasses.replace(observed.measurements, tolerances=exact), nominal)
    assert not self_calibrate(stating).families
    stated = self_calibrate(stating, {"encoder-offset": 0.01})
    assert [one.family.tolerance for one in stated.families] == [0.01]


def test_tolerances_are_read_or_follow_the_sensors():
    assert read_tolerances(["tilt=0", "cell-tare=0.1"]) == {"tilt": 0.0, "cell-tare": 0.1}
    wii = tolerances_of(tt.SensorSheet(cell_sd=1.43, placement_sd=(0.0035, 0.0035, 0.01)))
    assert wii.value["cell-gain"] == 0.01
    assert wii.assumed == "those of preset wii"
    fine = tolerances_of(FORCE_PLATE)
    assert fine.value["plate-translation"] == pytest.approx(3e-4)
    between = tolerances_of(tt.SensorSheet(cell_sd=0.4, placement_sd=(0.0035, 0.0035, 0.01)))
    assert 0.003 < between.value["cell-gain"] < 0.01
    assert "assumed" in between.assumed
    assert tolerances_of(tt.SensorSheet()).value == wii.value  # unknown sensors are taken for coarse ones


def test_the_noise_is_that_which_discovery_uses(observed):
    """Chi-square without members, by weights without the feet's poses and with them as nuisances."""
    model = linear_model(observed, noise_of(observed))
    used, white = residuals_in_use(observed), model.whitening
    structure = NoiseStructure(
        placement=groups(observed.measurements.placement),
        stance=groups(observed.stance),
        fixed=np.where(used[:, :, None] & used[:, None], white.own, np.eye(11)),
        own=np.zeros((0, *white.own.shape)),
        shared=used[..., None] * white.levers,
        owner=np.zeros(6, int),
        free=constants_of_stances(used),
    )
    weights = structure.weights(np.zeros(1))
    columns = np.concatenate([model.observed.geometry.regressor, np.zeros((len(observed), 9, 25))], axis=1)
    columns = np.concatenate([columns, np.eye(11)[None, :, 2:3].repeat(len(observed), 0)], axis=2)
    solved = weights(used[..., None] * columns)
    inner = np.tensordot(columns, solved, axes=((0, 1), (0, 1)))
    assert observed.measurements.weighed_mass
    mass_sd = observed.measurements.weighed_mass[1] * observed.measurements.gravity
    inner[-1, -1] += mass_sd**-2
    r = used * residuals(observed, model.theta)
    moment = np.einsum("mrp,mr->p", solved, r)
    rest = np.vdot(r, weights(r[..., None])[..., 0])
    assert rest - moment @ np.linalg.solve(inner, moment) == pytest.approx(model.chi_square, rel=1e-3)


def test_columns_are_the_change_by_removal(observed, nominal, robot):
    """Removing small members of all kinds at once changes the residuals as their columns say."""
    families = families_of(robot, tolerances_of(FORCE_PLATE))
    theta = nominal.value
    slope = sensitivity(observed, theta)
    columns = np.concatenate([member_columns(observed, theta, slope, f) for f in families], axis=2)
    rng = np.random.default_rng(0)
    values = [1e-3 * family.tolerance * rng.standard_normal(len(family)) for family in families]
    instances = [i for family, v in zip(families, values, strict=True) for i in family.instances(v)]
    change = residuals(observed, theta) - residuals(removed(observed, instances), theta)
    error = np.abs(columns @ np.concatenate(values) - change).max(axis=0)
    assert (error < 0.03 * np.abs(change).max(axis=0)).all()


def test_noise_reaches_what_yields(found, observed):
    """A cell that reads more, or a plate recorded elsewhere, changes angles and tilts without compliances."""
    at = fields(found.observed)
    expected = found.background().yielding
    free = [*range(at["cells"].start), *range(at["stance_tilt"].start, at["rise"].stop)]
    for reading, field, step in ((2, "cell_forces", 0.1), (5, "cell_forces", 0.1), (8, "plate_poses", 1e-4)):
        ends = []
        for sign in (1, -1):
            values = getattr(observed, field).copy()
            values.reshape(len(values), -1)[:, reading % 8] += sign * step
            ends.append(packed(found.cleaned(observed.changed(**{field: values}))))
        by_reading = (ends[0] - ends[1])[:, free] / (2 * step)
        column = expected[:, free, at["cells"].start + reading]
        assert column == pytest.approx(by_reading, abs=0.03 * np.abs(by_reading).max())


def test_gains_that_are_removed_leave_the_noise_as_it_was(observed, nominal, robot):
    """Otherwise all gains too large would make it smaller, and the evidence for them would be better."""
    families = [one for one in families_of(robot, tolerances_of(FORCE_PLATE)) if one.name == "cell-gain"]
    errors = np.zeros_like(packed(observed))
    errors[:, fields(observed)["cells"]] = 0.1 * np.random.default_rng(1).standard_normal((len(observed), 8))
    quiet = unpacked(observed, packed(observed) - errors)
    estimate = np.full(8, 0.05), nominal.value, 1e-9 * np.eye(len(nominal.value))
    noisy = members_removed(observed, families, *estimate, errors)
    assert noisy.cell_forces - members_removed(quiet, families, *estimate).cell_forces == pytest.approx(
        errors[:, fields(observed)["cells"]]
    )


@pytest.mark.parametrize("drift", [-2.0, 2.0])
def test_force_that_is_taken_off_leaves_the_noise_of_the_centre_as_it_was_read(
    observed, nominal, robot, drift
):
    m, forces = observed.measurements, observed.cell_forces.copy()
    forces[:, :4] += drift * ((m.time - m.time[0]) / np.ptp(m.time))[:, None]
    read = observe(dataclasses.replace(m, cell_forces=forces), nominal)
    clean = removed(read, instances_of(f"plate-drift:right={drift}", robot))
    with_drift, without, never = (
        linear_model(one, noise_of(one), smoothed=one, rounds=1).whitening.log_volume
        for one in (read, clean, observed)
    )
    # What the drift changes in the plates' shares, and so in the noise of their places, is no such noise.
    assert abs(without - with_drift) < 0.3 * abs(never - with_drift)


@pytest.mark.parametrize("drift", [-6.0, 6.0])
def test_evidence_for_a_drift_is_that_of_its_column_whatever_its_sign(robot, nominal, plan, drift):
    m = tt.Laboratory(robot, "wii").run(plan.take(plan.placement <= 8), seed=3, engine="statics").measurements
    time, forces = (m.time - m.time[0]) / np.ptp(m.time), m.cell_forces.copy()
    forces[:, :4] += drift * time[:, None]
    observed, label = observe(dataclasses.replace(m, cell_forces=forces), nominal), "plate-drift:right"
    linear = Data(observed, noise_of(observed)).null.linear
    chosen = next(one for one in candidates(observed) if one.label == label)
    fit = gauss_newton(linear, (Fitted(chosen, 0, np.zeros(1), 0.0),))
    left, column = linear.residual, linear.project(effect_columns(linear, chosen, 0))[:, 0]
    gained, size = 0.5 * (left @ left - fit.residual @ fit.residual), fit.sizes[0]
    assert gained == pytest.approx(size * (column @ left) - 0.5 * size**2 * (column @ column), abs=1.5)

    found = self_calibrate(observed, effects=instances_of(f"{label}={drift}", robot))
    reach = found.linear.covariance.reach[:, :2, fields(observed)["cells"]]
    apart = np.linalg.norm(reach[:, :, 0] - reach[:, :, 3], axis=1) * forces.sum(axis=1)
    distance = np.linalg.norm(np.ptp(observed.cell_places[:, [0, 3]], axis=1), axis=1)
    assert abs(np.polyfit(time, apart / distance, 1)[0]) < 0.02


def test_no_error_of_cells_is_left_in_the_columns_however_large(observed):
    # A cell that errs by a hundred s.d. in one row would otherwise ask for other gains in all rows.
    forces = observed.cell_forces.copy()
    forces[3, 2] += 100 * 0.1
    smooth = linear_model(observed.changed(cell_forces=forces), noise_of(observed), "AFT").smoothed
    twist = smooth.cell_forces.reshape(-1, 2, 4) @ TWIST
    assert observed.on_four_cells[3, 0]
    assert twist[observed.on_four_cells] == pytest.approx(0, abs=1e-6)


def test_noise_of_cells_counts_at_their_stated_places(robot, plan, nominal):
    read = observe(statically(preset_rig("wii", robot), plan.take(np.arange(9)), 1), nominal)
    clean = removed(read, instances_of("cell-position-scale=0.2", robot))
    by_cells, as_read = (
        sensitivity(one, nominal.value)[:, ROWS["A"], fields(one)["cells"]] for one in (clean, read)
    )
    moved = (center(clean) - center(read)) / total_force(read)[:, None]
    found = by_cells + more_as_read(clean, by_cells)
    assert found == pytest.approx(as_read - moved[..., None], abs=1e-12)
    assert np.abs(by_cells - found).max() > 1e-4


def test_smaller_units_of_the_readings_are_no_evidence(robot, nominal):
    """Of cells further inwards all noise is smaller, also that of the loads by which a soft sole leans."""
    few = tt.draw_plan(placements=10, per_placement=8, seed=1).plan
    soft = tt.Laboratory(sensors="wii").with_effects("sole-compliance=0.0015")
    measured = soft.run(few, seed=1, engine="statics").measurements
    more = np.random.default_rng(2).normal(0.0, 2.0, measured.cell_forces.shape)
    noisy = dataclasses.replace(measured, cell_forces=measured.cell_forces + more)
    observed, known = observe(noisy, nominal), {"cell-position-scale": 0.0}
    start = self_calibrate(observed, known)
    inwards = removed(observed, instances_of("cell-position-scale=-0.05", robot))
    found = self_calibrate(inwards, known, start=start)
    assert found.log_evidence_about(start) < start.solved.log_evidence - 3
    assert found.solved.log_evidence > start.solved.log_evidence


@pytest.mark.slow
def test_joints_do_not_take_up_the_noise_that_a_soft_sole_makes_of_loads(robot, plan, nominal):
    """Steps lead away to joints ten times as soft as they are, and the best evidence was on the way there."""
    built = draw_laboratory(
        robot, "wii", np.random.default_rng(np.random.SeedSequence(111, spawn_key=(3, 60, 0)))
    )
    sole = instances_of("sole-compliance=0.0013", robot)
    measured = built.with_effects({"sole-compliance": (0.0013,)}).measured(plan, 1294)
    found = self_calibrate(observe(measured, nominal), effects=sole)
    (joints,) = (one for one in found.families if one.family.name == "joint-compliance")
    assert joints.spread < 1
    assert found.effects[0].values[0] == pytest.approx(0.0013, abs=3 * found.effect_errors[0][0])


@pytest.fixture(scope="module")
def soft(robot, nominal):
    """Measurements of soft joints and soles with a coarse sensor."""
    joints = [f"joint-compliance:{joint}=2e-4" for joint in nominal.parameters.tree.joints]
    laboratory = tt.Laboratory(robot, sensors="wii").with_effects(*joints, "sole-compliance=4e-4")
    return laboratory.run(tt.plans.random, seed=1, engine="statics").measurements


@pytest.mark.slow
def test_noisy_loads_leave_no_pattern_in_soft_joints(soft, nominal):
    """The noise of the loads passes into the angles that the compliances correct."""
    found = self_calibrate(observe(soft, nominal))
    fit = Data(found.observed, found.noise, found.background()).null
    assert patterns(fit.linear, fit.residual, fit.columns)[0].p > 0.05


def test_noisy_loads_are_allowed_for_in_a_known_compliance(soft, robot):
    found: Any = identify(soft, robot, adopted=instances_of("sole-compliance=4e-4", robot)).calibration
    for name, true in (("joint-compliance", 2e-4), ("sole-compliance", 0.0)):
        one = next(family for family in found.families if family.family.name == name)
        assert np.abs((one.value - true) / one.standard_error).max() < 3
    assert 0.7 < found.solved.scales[1] < 1.3  # of the cells


@pytest.mark.slow
def test_a_gap_that_passes_for_noise_of_the_loads_does_not_make_joints_soft(robot, nominal):
    """Two exchanged cells that no effect explains widen the noise of all cells fourfold."""
    exchanged = tt.Laboratory(robot, sensors="wii").with_effects("swapped-cells:left=rear_right,rear_left")
    observed = observe(exchanged.run(tt.plans.random, seed=1, engine="statics").measurements, nominal)
    found = self_calibrate(observed)
    rigid = self_calibrate(observed, {"joint-compliance": 0.0, "sole-compliance": 0.0})
    assert 3 < found.solved.scales[1] < 5
    assert found.solved.log_evidence > rigid.solved.log_evidence - 10


def test_loads_are_those_of_the_estimated_robot(observed, nominal, robot):
    """Exact base parameters of another robot give its loads, though its masses are unknown."""
    other = draw_robot(robot.model, 0.2, np.random.default_rng(1))
    other *= observed.weight / observed.measurements.gravity / other[:, 0].sum()
    theta = nominal.parameters.values(other)
    true = dataclasses.replace(observed, standard=other).torques
    by_estimate = with_estimated_loads(observed, theta, 1e-14 * np.eye(25), np.zeros(12)).torques
    assert by_estimate == pytest.approx(true, abs=2e-3 * np.abs(true).max())
    assert np.abs(observed.torques - true).max() > 0.02 * np.abs(true).max()
    unsure = with_estimated_loads(observed, theta, 1e6 * np.eye(25), np.zeros(12))
    total = observed.weight / observed.measurements.gravity
    model = standard_parameters(robot.model)
    assert unsure.standard == pytest.approx(model * total / model[:, 0].sum(), abs=1e-6)


@pytest.mark.parametrize("most", [15, 14, 0])
def test_too_few_postures_name_the_families_to_leave_out(ordinary, observed, robot, most):
    """With more families than `most` nothing can be estimated; the least determined go first."""
    order = least_determined(observed)
    # Without those of sensors that are not there, and what is taken as exact.
    exact = {"cell-side-force", SOLE}
    others = {n for n in TOLERANCES if n.startswith("wrench")} | {"inertia", "contact-lag", "foot-damping"}
    assert set(order) == set(TOLERANCES) - others - exact
    assert order.index("cell-position-scale") < order.index("encoder-offset")

    def limited(observed, tolerances):
        left_out = sum(value == 0 for value in (tolerances or {}).values())
        if len(order) - left_out > most or most == 0:
            raise np.linalg.LinAlgError
        return self_calibrate(observed, tolerances, rounds=1)

    with pytest.raises(tt.InputError) as refusal:
        identify(ordinary[0].measurements, robot, calibrate=limited)
    named = {15: order[:1], 14: order[:2]}.get(most)
    advice = f"; leave out {', '.join(named)} (tolerance 0), or choose" if named else "calibrating; choose"
    assert advice in str(refusal.value)
    assert "too much alike (or a stated noise that is too small) for estimator self-calibrating" in str(
        refusal.value
    )
    if named:
        stated = dict.fromkeys(named, 0.0)
        identify(ordinary[0].measurements, robot, tolerances=stated, calibrate=limited)


def test_the_zero_of_a_sensor_is_no_family_to_leave_out(robot):
    """It is stated with the sensor, not as a tolerance."""
    feet: Any = (
        tt.Laboratory(robot, sensors="foot-ft").run(tt.plans.random, seed=2, engine="statics").measurements
    )
    zeros = within("contacts", feet, zero_sd=np.ones((2, 6)))

    def impossible(observed, tolerances):
        check_tolerances(tolerances or {})
        raise np.linalg.LinAlgError

    refuse("too much alike", identify, zeros, robot, calibrate=impossible)


def test_an_estimate_that_does_not_come_to_rest_is_warned_of(ordinary, robot):
    """Cells without noise by their sheet: nothing explains the noise that the readings have."""
    measured = ordinary[0].measurements
    measured = measured.take(measured.placement <= 15)
    sharp = within("sensors", measured, cell_sd=0.0)
    with pytest.warns(tt.InputWarning, match="restless: the estimate did not come to rest"):
        warn_of_unrest(identify(sharp, robot), "restless")


def test_a_family_as_wide_as_allowed_is_at_its_bound(found):
    assert found.at_bound == ()
    first, *others = found.families
    wide = dataclasses.replace(found, families=(dataclasses.replace(first, spread=20.0), *others))
    assert wide.at_bound == (first.family.name,)


def test_a_step_that_leaves_no_load_is_an_error_without_warnings(observed, robot):
    (louder,) = instances_of(["cell-gain:right.front_left=0.1"], robot)
    silent = [dataclasses.replace(louder, values=(-1.0,))]
    with pytest.raises(np.linalg.LinAlgError):
        self_calibrate(observed, effects=silent)


def test_steps_in_circles_come_to_rest_and_steps_ahead_are_kept():
    """A map that turns by a third of a circle about zero, as the estimates of large cross-talk did."""
    turn = np.array([[-0.5, -(0.75**0.5)], [0.75**0.5, -0.5]])
    at, last, before = np.array([1.0, 0.0]), np.zeros(2), None
    for _ in range(10):
        step, reached = turn @ at - at, turn @ at
        share = 0.0 if before is None else _share_of_last(step, before)
        at, before, last = reached + share * (last - reached), step, reached
    assert np.linalg.norm(at) < 0.05
    assert _share_of_last(0.5 * step, step) == 0.0
    assert _share_of_last(-100 * step, step) == 0.5


@pytest.mark.slow
def test_sensors_finer_than_contacts_are_exact(plan, robot):
    """A stated noise of 1e-12 N is none: the laboratory's own residuals take its place."""
    measured = tt.Laboratory(robot, "ideal").run(plan, 1, "statics").measurements
    fits = []
    for cell_sd in (0.0, 1e-12):
        sheet = within("sensors", measured, encoder_sd=0.0, cell_sd=cell_sd)
        fits.append(identify(sheet, robot).full.value)
    np.testing.assert_allclose(fits[0], fits[1], atol=1e-6)  # m
