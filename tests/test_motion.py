"""A robot that is measured while it moves: plan, laboratory, folders and checks."""

import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import mujoco
import numpy as np
import pytest
import rerun as rr
from pydantic import TypeAdapter

import tulip_testbed as tt
from tests.test_refusals import check_words, refuse
from tests.test_refusals import rows as table
from tulip_testbed.base.progress import Advance
from tulip_testbed.calibration.families import EXACT as EXACT_LABORATORY
from tulip_testbed.calibration.families import Family
from tulip_testbed.calibration.self_calibration import LASTING, as_log_shows, self_calibrate, without_inertia
from tulip_testbed.effects.instance import EffectInstance, removed
from tulip_testbed.effects.laws.misread import undo
from tulip_testbed.effects.motion_effects import LAG, MOTION_EFFECTS
from tulip_testbed.experiments.discovery_curves import about_stances
from tulip_testbed.experiments.protocols import motion_plan
from tulip_testbed.identification import preflight
from tulip_testbed.identification.center_of_pressure import center_of_pressure
from tulip_testbed.identification.inertial_wrench import inertial_parameters, link_wrenches
from tulip_testbed.identification.noise_in_time import WHITE
from tulip_testbed.identification.nominal import nominal_robot
from tulip_testbed.identification.observation import CLOSURE, observe, turned
from tulip_testbed.identification.preflight import motion_checks
from tulip_testbed.identification.residual_channels import ANCHORED, residuals
from tulip_testbed.measurements import read_samples
from tulip_testbed.measurements.logs.series_reduction import _weights, reduced_motion
from tulip_testbed.measurements.trajectory import runs
from tulip_testbed.sim.compliance import lagging
from tulip_testbed.sim.dynamics import moving_run
from tulip_testbed.sim.dynamics.hold import put_down
from tulip_testbed.sim.dynamics.stand import Stand
from tulip_testbed.sim.plan_folder import read_plan, write_plan
from tulip_testbed.sim.procedure import header_of
from tulip_testbed.sim.rig import preset_rig
from tulip_testbed.sim.scene import boards_under
from tulip_testbed.sim.sensors import PLATE, Sensors, WrenchSensors, delayed, sample_series
from tulip_testbed.viewer.postures_view import log_standing
from tulip_testbed.viewer.subject import of_measurements

EXACT = "ideal"


@pytest.fixture(scope="module")
def three():
    """The first postures of a placement."""
    return tt.plans.random.take(np.flatnonzero(tt.plans.random.placement == 1)[:3])


@pytest.fixture(scope="module")
def planned(once):
    few = tt.plans.random
    return once("motion-plan", lambda: tt.plan_motion(few.take(np.isin(few.placement, [1, 3, 4])), speed=0.5))


@pytest.fixture(scope="module")
def moved(robot, planned, once):
    return once(
        "motion-run", lambda: tt.Laboratory(robot, sensors=EXACT).run(planned.plan, seed=2, workers=1)
    )


def checks(run_or_folder) -> dict:
    return {check.name: check for check in tt.check(run_or_folder).checks}


def test_forces_of_the_ground_are_those_that_the_motion_needs(robot, moved):
    """MuJoCo against our inverse dynamics of the encoders' readings, in windows of half a second."""
    m = moved.measurements
    assert 0.45 < np.abs(m.joint_rates).max() <= 0.5
    wrench = link_wrenches(nominal_robot(robot), m)[0].sum(axis=1)
    depth = m.top_height[0]  # cells are below the boards' tops
    moments = np.column_stack([-wrench[:, 4], wrench[:, 3]]) - depth * wrench[:, :2]
    off = center_of_pressure(m) - moments / wrench[:, 2:3]
    assert np.sqrt((off**2).mean(axis=0)).max() < 1e-4
    assert np.abs(m.cell_forces.sum(axis=1) - wrench[:, 2]).max() < 0.1


def test_springs_follow_a_load_sooner_while_the_robot_moves(robot, three):
    effects = ("sole-compliance=0.0003", "joint-compliance:right_knee=0.0002")
    rig = tt.Laboratory(robot, sensors=EXACT).with_effects(*effects).rig
    stand = Stand(rig, boards_under(rig, three.foot_poses[:1])[0])
    model, at = stand.model, lagging(stand.model)
    before = model.dof_damping.copy()
    soles = [f"{foot}_sole_{axis}" for foot in robot.feet for axis in ("roll", "pitch")]
    assert {model.joint(k).name for k in model.dof_jntid[at]} == {*soles, "right_knee_yield"}
    with moving_run._moving(stand):
        assert model.dof_damping[at] == pytest.approx(moving_run.FREELY * before[at])
    assert model.dof_damping == pytest.approx(before)


def test_the_legs_close_between_the_postures_of_a_row_too(robot, moved):
    observed = observe(moved.measurements, nominal_robot(robot))
    left = about_stances(residuals(observed, observed.nominal.value), observed.stance)[:, CLOSURE]
    assert np.sqrt((left**2).mean(axis=0)).max() < 1.5e-5  # m, rad


@pytest.mark.parametrize("label", ["sole-compliance=0.0003", "joint-compliance:right_ankle_pitch=0.0002"])
def test_what_yields_to_a_load_that_changes_accelerates_the_body(robot, planned, moved, label):
    run = tt.Laboratory(robot, sensors=EXACT).with_effects(label).run(planned.plan, seed=2, workers=1)
    ((instance,),) = (run.laboratory.hidden,)
    observed = observe(run.measurements, nominal_robot(robot))
    motion = observed.motion
    still = replace(motion, load_rates=0 * motion.load_rates, yielding=0 * motion.yielding)
    left, without = (
        np.sqrt((about_stances(residuals(each, each.nominal.value), each.stance)[:, :2] ** 2).mean())
        for each in (removed(one, [instance]) for one in (observed, observed.changed(motion=still)))
    )
    assert left < 0.5 * without


@pytest.mark.parametrize("fed", [True, False])
def test_the_side_force_between_the_feet_follows_from_the_commands(robot, three, fed):
    """Servos sag without feed-forward. Loads of that put a link at its play's other end."""
    rig, plan = preset_rig(EXACT, robot), tt.plan_motion(three).plan
    rig = replace(rig, sensors=replace(rig.sensors, wrench=WrenchSensors(place=PLATE)))
    motion: Any = plan.motion
    plan = plan if fed else replace(plan, motion=replace(motion, torques=None))
    m: Any = tt.Laboratory(robot, nominal=rig).run(plan, workers=1).measurements
    observed = observe(m, nominal_robot(robot))
    truth = turned(m.plate_poses[:, 1, 2], m.wrenches[:, 1, :2])
    assert np.abs(truth).mean(axis=0).max() < 1 if fed else np.abs(truth).mean(axis=0).min() > 5
    off = truth - observed.loads.internal_wrench[:, :2]
    assert np.sqrt((off**2).mean(axis=0)).max() < 0.6  # N; 0.8 without the friction of the drives


def test_feet_that_creep_have_no_place_for_longer_than_a_stance(robot, monkeypatch):
    monkeypatch.setattr(moving_run, "STICKS", 1.0)
    plan: Any = tt.plan_motion(tt.plans.random.take(tt.plans.random.placement == 1), speed=0.1).plan
    assert plan.motion.seconds > 35
    observed = observe(
        tt.Laboratory(robot, sensors=EXACT).run(plan, 2, workers=1).measurements, nominal_robot(robot)
    )
    residual = residuals(observed, observed.nominal.value)
    crept, left = (
        np.sqrt((about_stances(residual, number)[:, ANCHORED] ** 2).mean(axis=0))
        for number in (observed.measurements.placement, observed.stance)
    )
    assert crept[:2].min() > 2e-5
    assert (left < 0.5 * crept)[:2].all()


def test_an_encoder_that_errs_with_the_direction_errs_with_the_rate_of_its_row(robot, moved):
    """As one on the motor does, by friction and what yields; rows before and after tell it less well."""
    samples, size = moved.samples, 2e-3
    at, angles = samples.joints.index("right_knee"), samples.joint_angles.copy()
    angles[:, at] += size * np.sign(np.gradient(angles[:, at]))
    m, rows = moved.measurements, np.arange(0, len(moved.measurements), 3)
    faulty = observe(reduced_motion(replace(samples, joint_angles=angles)).take(rows), nominal_robot(robot))
    left = undo(faulty, "encoder:right_knee/direction/step", (size,)).joint_angles - m.joint_angles[rows]
    assert np.sqrt(np.mean(left[:, at] ** 2)) < 0.25 * size


def test_a_board_that_rocks_within_a_row_has_no_twist(robot, moved):
    spread = np.ones((len(moved.measurements), 8))
    spread[5, :4] = 2.5
    seen = observe(replace(moved.measurements, cell_forces_sd=spread), nominal_robot(robot)).on_four_cells
    assert seen[:5].all()
    assert seen[5].tolist() == [False, True]


def test_every_segment_is_one_motion_on_one_placement(planned, moved):
    motion = planned.plan.motion
    assert planned.segments == len(motion.segments) >= 3
    assert planned.fastest <= planned.limit + 1e-6
    assert planned.minutes == pytest.approx(len(motion) / 6000, rel=0.01)
    for rows in motion.segments:
        there = planned.plan.placement == motion.placement[rows.start]
        ends = motion.joint_angles[[rows.start, rows.stop - 1]]
        assert all((np.abs(planned.plan.joint_angles[there] - end).max(axis=1) < 1e-9).any() for end in ends)
    assert not moved.truth.dropped
    assert len(moved.samples) == len(motion)
    assert set(moved.measurements.placement) == set(motion.placement)


def test_a_longer_budget_is_a_slower_motion(three):
    fast = tt.plan_motion(three)
    slow = tt.plan_motion(three, minutes=2 * fast.minutes)
    assert slow.minutes == pytest.approx(2 * fast.minutes, rel=0.01)
    assert slow.fastest == pytest.approx(fast.fastest / 2, rel=0.02)
    assert "2.0 times slower" in slow.notes[0]
    short = tt.plan_motion(three, minutes=fast.minutes / 2)
    assert short.minutes == fast.minutes
    assert f"more than {fast.minutes / 2:g}" in short.notes[0]


def test_fast_motion_is_named_before_and_after(robot, three, planned, moved):
    """The plan's figures are those that the check finds in the record."""
    rough, fine = (header_of(preset_rig(name, robot)).sensors for name in ("wii", "force-plate"))
    m = moved.measurements
    found, fast = (
        {one.name: one for one in tt.check(replace(m, sensors=sheet)).checks}["inertial part"]
        for sheet in (rough, fine)
    )
    assert (found.result, fast.result) == ("pass", "warn")
    assert "slower motion" in fast.advice
    added, share = (float(found.seen.split(before)[1].split()[0]) for before in ("by ", "r.m.s., "))
    assert added == pytest.approx(planned.inertial_mm, rel=0.15)
    assert share == pytest.approx(planned.inertial_mm / planned.noise_mm, rel=0.15)
    assert f"{planned.inertial_mm:.2g} mm r.m.s." in str(planned)
    assert fast.advice in str(tt.plan_motion(three, robot, sensors="force-plate"))
    assert fast.advice not in str(tt.plan_motion(three, robot))


@pytest.fixture(scope="module")
def identified(robot, moved):
    sheet = header_of(preset_rig("wii", robot)).sensors
    return tt.identify(replace(moved.measurements, sensors=sheet), robot)


def test_a_gross_fault_leaves_the_noise_in_time_as_assumed(robot, moved, monkeypatch):
    """With swapped cells no calibration of a motion converged, so they were not searched for."""

    def diverges(*_, **__):
        raise np.linalg.LinAlgError

    monkeypatch.setattr("tulip_testbed.calibration.self_calibration.self_calibrate", diverges)
    seen, found = as_log_shows(observe(moved.measurements, nominal_robot(robot)))
    assert (seen.noise_in_time, found) == (LASTING, None)


@pytest.mark.parametrize(("size", "left"), [(0.5, 1.0), (1e3, 0.0)])
def test_inertias_that_a_motion_determines_are_exported(robot, identified, tmp_path, size, left):
    """Of a robot with the base parameters of CAD: the file differs by the change alone, or a part of it."""
    calibration, cad = identified.calibration, inertial_parameters(robot.model)
    (number, inertia), *_ = [
        (k, one) for k, one in enumerate(calibration.families) if one.family.effect.name == "inertia"
    ]
    families = list(calibration.families)
    known = np.arange(len(inertia.value)) == 0
    families[number] = replace(inertia, value=np.full(len(known), size), determined=known)
    found = replace(
        identified,
        full=replace(identified.full, value=nominal_robot(robot).value),
        mass=(float(robot.model.body_mass.sum()), 0.01),
        calibration=replace(calibration, families=tuple(families)),
    )
    exported = tt.export_model(found, robot, out=tmp_path / "moved.xml")
    assert f"The motion determines 1 of {len(known)} directions" in str(exported)
    assert ("A consistent robot can have" in str(exported)) == (left < 1)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "moved.xml"))
    change = (inertial_parameters(model) - cad).ravel()
    whole = size * calibration.observed.motion.directions[:, int(inertia.family.targets[0]) - 1]
    share = float(change @ whole / (whole @ whole))
    assert np.abs(change - share * whole).max() < 1e-6 * np.abs(change).max()
    assert share == pytest.approx(1.0) if left else 0 < share < 0.1


def test_noise_of_encoders_reaches_the_forces_of_motion(robot, moved):
    """Against the residuals of the same motion with noise in every sample."""
    nominal, samples, size = nominal_robot(robot), moved.samples, 1e-3
    noise = size * np.random.default_rng(6).standard_normal(samples.joint_angles.shape)
    read = reduced_motion(replace(samples, joint_angles=samples.joint_angles + noise))
    of_a_row = size * np.sqrt((_weights(0.01 * np.arange(50) - 0.245, 0.5)[0][0] ** 2).sum())
    read = replace(read, sensors=replace(read.sensors, encoder_sd=of_a_row, cell_sd=1e-3))
    observed = observe(read, nominal).changed(noise_in_time=WHITE)
    foretold, without = (
        self_calibrate(one, EXACT_LABORATORY).linear.covariance.structure.own[0][:, [0, 1], [0, 1]]
        for one in (observed, without_inertia(observed))
    )
    assert (without < 0.2 * foretold).all()
    exact, noisy = (residuals(observe(m, nominal), nominal.value)[:, :2] for m in (moved.measurements, read))
    assert ((noisy - exact) ** 2 / foretold).mean() == pytest.approx(1.0, rel=0.25)


def test_an_identification_says_how_many_rows_count(identified):
    found = identified
    count, rows = found.calibration.effective_rows, len(found.measurements)
    assert 1 < count <= rows
    assert f"{rows} rows determine a constant like {count:.0f} rows" in "\n".join(map(str, found.tables()))


def test_work_on_a_plan_says_how_far_it_is(robot):
    done: dict[str, int] = {}

    @contextmanager
    def progress(what: str, total: int | None, before: int) -> Iterator[Advance]:
        assert total is not None

        def advance(count: int, /, value: float | None = None) -> None:
            done[what] += count

        done[what] = -total
        yield advance

    few = tt.plans.random.take(np.flatnonzero(tt.plans.random.placement <= 2))
    tt.plan_motion(few, robot, progress=progress)
    assert done == {"placements": 0, "segments of the motion": 0}


def test_a_plan_folder_keeps_the_motion(tmp_path, robot, planned):
    write_plan(tmp_path / "plan", planned.plan)
    again = read_plan(tmp_path / "plan", robot).motion
    for name, values in vars(planned.plan.motion).items():
        np.testing.assert_array_equal(values, getattr(again, name))
    assert "The robot moves: 3 segments" in str(tt.describe_plan(tmp_path / "plan"))


def test_a_measurement_folder_keeps_samples_and_is_read_as_rows(tmp_path, moved):
    tt.write_measurements(tmp_path / "data", moved)
    samples, rows = read_samples(tmp_path / "data"), tt.read_measurements(tmp_path / "data")
    assert samples is not None
    np.testing.assert_array_equal(samples.posture, moved.samples.posture)
    for name in ("time", "window", "joint_angles", "joint_rates", "cell_forces", "plate_poses", "placement"):
        np.testing.assert_array_equal(getattr(rows, name), getattr(moved.measurements, name))
    ends = {one.start: moved.samples.time[one.stop - 1] for one in runs(moved.samples.posture)}
    begins = moved.samples.time[list(ends)]
    last = np.array(list(ends.values()))[np.searchsorted(begins, rows.time, side="right") - 1]
    assert (rows.time + rows.window <= last + 1e-6).all()  # no window crosses a segment's end
    assert checks(tmp_path / "data")["sampling"].result == "pass"
    tt.write_measurements(tmp_path / "rows", rows)
    for folder, what in (("data", "samples"), ("rows", "rows")):
        watch = partial(tt.watch, tmp_path / folder, plan="random", once=True)
        refuse(f"found {what} of a motion, expected held postures", lambda watch=watch: list(watch()))


def test_check_tells_late_contacts(moved):
    s, slow = moved.samples, Sensors(contact_lag=0.02, contact_filter=0.02)
    late = np.concatenate([delayed(slow, s.cell_forces[rows], 0.01) for rows in runs(s.posture)])
    rows = reduced_motion(replace(s, cell_forces=late))
    found = {one.name: one for one in tt.check(rows).checks}["lag of contacts"]
    assert found.result == "warn"
    assert abs(float(found.seen.split()[0]) - 40) <= 3  # ms


def test_what_late_contacts_read_is_known_with_the_inertial_forces(robot, moved):
    s, nominal = moved.samples, nominal_robot(robot)
    late = np.concatenate(
        [delayed(Sensors(contact_lag=0.02), s.cell_forces[r], 0.01) for r in runs(s.posture)]
    )
    now, then = (observe(reduced_motion(one), nominal) for one in (s, replace(s, cell_forces=late)))
    lag = EffectInstance(LAG, "", (0.02,))
    truth, wrong, right = (residuals(o, nominal.value)[:, :2] for o in (now, then, removed(then, [lag])))
    assert np.linalg.norm(right - truth) < 0.1 * np.linalg.norm(wrong - truth)


@pytest.mark.parametrize("depth", [0.05, 1.0])
def test_the_lever_of_horizontal_forces_counts_once_in_the_lag(robot, moved, depth, monkeypatch):
    """On deep plates an error of the lever changes the lag by milliseconds."""
    nominal, m = nominal_robot(robot), replace(moved.measurements, top_height=np.full(2, depth))
    wrench, step = link_wrenches(nominal, m)[0].sum(axis=1), 1e-4 * m.joint_rates
    ahead, place, behind = (nominal.center_of_mass(m.joint_angles + k * step) for k in (1, 0, -1))
    moments = np.column_stack([-wrench[:, 4], wrench[:, 3]]) - depth * wrench[:, :2]
    added = moments / wrench[:, 2:3] - place
    speed = (ahead - behind) / 2e-4
    for rows in np.split(np.arange(len(m)), np.flatnonzero(np.diff(m.time) > 0.75) + 1):
        speed[rows] += np.gradient(added[rows], m.time[rows], axis=0)
    monkeypatch.setattr(motion_checks, "center_of_pressure", lambda m: place + added - 0.04 * speed)
    (lag, _) = motion_checks.rows_of(m, nominal)
    assert lag.seen.startswith("40 ms behind"), lag.seen


@table("motion checks")
def test_a_check_of_a_motion_says_what_is_wrong(moved, changes, words):
    names = {"moved": moved, "s": moved.samples, "replace": replace, "np": np}
    names["right"] = replace(moved.samples, support=np.full(len(moved.samples), "right"))
    names["reduced"] = reduced_motion
    one = checks(eval(changes[0], names))[words.partition(":")[0]]
    check_words(words, f"{one.name}: {one.result}; {one.where}")


def test_a_correct_motion_passes_checks_of_rows_whose_noise_is_not_independent(robot, planned):
    run: Any = tt.Laboratory(robot, sensors="force-plate").run(planned.plan, seed=4, workers=2)
    found = checks(run)
    assert found["weight balance"].result == found["legs close"].result == "pass"


def test_checks_of_a_motion_take_rows_apart_that_carry_the_weight_alone(robot, moved):
    m, nominal = moved.measurements, nominal_robot(robot)
    some = preflight._independent(m, nominal)
    weight = float(robot.model.body_subtreemass[1]) * m.gravity
    raw, left = (np.abs(each.cell_forces.sum(axis=1) - weight).max() for each in (m, some))
    assert left < 0.1 * raw
    gaps = [np.diff(some.time[some.placement == number]).min() for number in np.unique(some.placement)]
    assert 4 <= min(gaps) < 5
    at_rest = replace(m, joint_rates=None, joint_accelerations=None)
    assert preflight._independent(at_rest, nominal) is at_rest


def test_samples_of_a_clock_that_jumps_become_rows(moved):
    s = moved.samples
    jump = replace(s, time=s.time + 1e12 * (s.posture == s.posture[0]) * (s.time > 2))
    assert len(reduced_motion(jump)) >= len(moved.measurements) - 2


def test_families_of_a_motion_can_be_written_and_sent():
    documents = TypeAdapter(Family)
    for effect in MOTION_EFFECTS:
        assert documents.validate_json(documents.dump_json(Family(effect, 1.0, ("1",)))).effect is effect
        assert pickle.loads(pickle.dumps(effect)) is effect


def test_families_of_a_motion_are_not_told_of_holds():
    held = tt.identify("docs/how-to/your-data", tolerances={"tilt": 0})
    assert "Taken as exact: tilt, plate-map." in str(held)


def test_a_view_plays_a_motion_in_its_time(moved, robot):
    m = moved.measurements.take(np.arange(5))
    canvas = log_standing(rr.RecordingStream("motion"), of_measurements(m, robot))
    assert canvas.index.timeline_name() == "time"
    held = replace(m, joint_rates=None, joint_accelerations=None)
    canvas = log_standing(rr.RecordingStream("held"), of_measurements(held, robot))
    assert canvas.index.timeline_name() == "posture"


def test_slow_errors_keep_the_sheet_s_deviation_and_lag_is_exact():
    rng = np.random.default_rng(5)
    read, _ = sample_series(np.zeros((400, 500)), (2.0, 0.0, 0.0), 1, rng, 0.01, 2.0)
    assert np.std(read) == pytest.approx(2.0, rel=0.05)
    assert (read[:200] * read[200:]).mean() / 4 == pytest.approx(np.exp(-1), abs=0.1)  # 2 s later
    ramp = np.arange(300)[:, None] * 0.01
    late = delayed(Sensors(contact_lag=0.013, contact_filter=0.02), ramp, 0.01)
    np.testing.assert_allclose(late[100:], ramp[100:] - 0.033, atol=1e-6)


def test_a_posture_that_cannot_be_held_costs_the_way_to_the_next_one(robot, three, monkeypatch):
    hold, tried = moving_run.hold, []

    def once_lost(stand, posture):
        tried.append(posture)
        return (None, "lost sole corner") if len(tried) == 1 else hold(stand, posture)

    monkeypatch.setattr(moving_run, "hold", once_lost)
    plan: Any = tt.plan_motion(three, robot).plan
    run: Any = tt.Laboratory(robot, sensors=EXACT).run(plan, workers=1)
    assert run.truth.dropped == ((1, "lost sole corner"),)
    first = int(np.abs(plan.motion.joint_angles - tried[1]).max(axis=1).argmin())
    assert np.abs(plan.joint_angles[1] - tried[1]).max() < 1e-4
    assert len(run.samples) == len(plan.motion) - first
    assert np.abs(run.samples.joint_angles - plan.motion.joint_angles[first:]).max() < 0.02
    late = moving_run._times(run.laboratory.rig, plan.motion)[first]
    assert run.samples.time[0] == pytest.approx(late)


def test_a_robot_that_tips_goes_on_at_the_next_posture(robot):
    mixed = tt.plans.mixed
    few = mixed.take(np.flatnonzero(mixed.support == "left")[:3])
    plan: Any = tt.plan_motion(few, robot, speed=0.6).plan
    run: Any = tt.Laboratory(robot, sensors=EXACT, random_robot=(0.1, 2)).run(plan, workers=1)
    assert run.truth.dropped == ((1, "tipped"),)
    time = run.samples.time - moving_run._times(run.laboratory.rig, plan.motion)[0]
    lost = int(np.diff(time).argmax())
    second = int(np.abs(plan.motion.joint_angles - plan.joint_angles[1]).max(axis=1).argmin())
    assert 0 < time[lost] < plan.motion.time[second] == pytest.approx(time[lost + 1])
    assert time[-1] == pytest.approx(plan.motion.time[-1])


def test_a_robot_that_is_put_down_again_stands_where_it_stood(robot, three):
    """Unknown zeros and lengths put the foot elsewhere in each posture."""
    effects = ("encoder-offset:right_ankle_roll=0.01", "link-length:right_upper_leg=0.005")
    rig = tt.Laboratory(robot, sensors=EXACT).with_effects(*effects).rig
    stand, other = (Stand(rig, boards_under(rig, three.foot_poses[:1])[0]) for _ in range(2))
    put_down(stand, three.joint_angles[0])
    place = stand.feet()[0]
    for one in (stand, other):
        put_down(one, three.joint_angles[1])
    assert np.abs(other.feet()[0] - place).max() > 1e-4
    assert stand.feet()[0] == pytest.approx(place, abs=2e-5)


def test_postures_on_one_foot_share_placements_in_a_motion():
    mixed = tt.plans.mixed
    together = motion_plan._gathered(mixed)
    both = mixed.support == "double"
    np.testing.assert_array_equal(together.placement[both], mixed.placement[both])
    for foot in ("right", "left"):
        _, counts = np.unique(together.placement[mixed.support == foot], return_counts=True)
        assert counts.tolist() == [11, 11, 11, 11]
    assert len(np.unique(together.placement)) == 12
    moved = replace(mixed, swing_pose=mixed.swing_pose + np.arange(len(mixed))[:, None])
    np.testing.assert_array_equal(motion_plan._gathered(moved).placement, mixed.placement)


@pytest.mark.slow
def test_results_do_not_depend_on_workers(robot, planned):
    one, two = (tt.Laboratory(robot).run(planned.plan, seed=3, workers=count) for count in (1, 2))
    np.testing.assert_array_equal(one.measurements.to_frame(), two.measurements.to_frame())


@pytest.mark.slow
def test_a_foot_that_lifts_costs_its_samples(robot, planned):
    """A link that is 3 mm longer than the plan knows lifts a corner of its foot."""
    laboratory = tt.Laboratory(robot, sensors=EXACT).with_effects("link-length:right_upper_leg=0.003")
    run: Any = laboratory.run(planned.plan)
    assert 0 < len(run.samples) < len(planned.plan.motion)
    assert all("lost" in reason or "lifted" in reason for _, reason in run.truth.dropped)
