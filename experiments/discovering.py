"""The whole discovery: search, identification before and after by one estimator, check in full dynamics."""

from collections.abc import Mapping

from tulip_testbed.base.budget import Budget
from tulip_testbed.base.errors import InputError, at_least
from tulip_testbed.base.progress import Progress, silent
from tulip_testbed.calibration.prediction import left_by
from tulip_testbed.discovery.candidate_search import first_calibration
from tulip_testbed.discovery.discover import discover
from tulip_testbed.discovery.dynamics_check import check_in_dynamics
from tulip_testbed.discovery.experiment_information import Explanation
from tulip_testbed.discovery.story import story
from tulip_testbed.effects.lasting import everywhere
from tulip_testbed.effects.motion_effects import MOTION_EFFECTS
from tulip_testbed.experiments.discovery_result import PARTS, Discovered
from tulip_testbed.experiments.identify import identify
from tulip_testbed.experiments.proposed_experiment import propose_experiments
from tulip_testbed.experiments.rig_folder import rig_files
from tulip_testbed.experiments.run_file import made_by
from tulip_testbed.identification.residual_channels import residuals
from tulip_testbed.measurements import Measurements, as_joined
from tulip_testbed.sim.robot import Robot

AS_FOUND = (  # what a result has of its search
    *("verdict", "adopted", "calibrated", "families", "explanations", "undetectable"),
    *("where", "repeats", "noise", "patterns", "wall_s"),
)


def discover_effects(
    measurements: Measurements,
    robot: Robot,
    seed: int = 0,
    check: bool = True,
    workers: int = 1,
    source: str = "measurements",
    tolerances: Mapping[str, float] | None = None,
    progress: Progress = silent,
) -> Discovered:
    """Find and adopt what the nominal model lacks, and identify the robot; see `tulip_testbed.discover`."""
    at_least("seed", seed, 0)
    measurements = as_joined(measurements)
    # Says what does not fit, before the work.
    before = identify(measurements, robot, source, tolerances=tolerances, calibrate=first_calibration)
    with progress(f"looking for what is missing, in at most {Budget(len(measurements))}", None, 0) as advance:
        discovery = discover(
            measurements,
            robot,
            seed,
            tolerances=tolerances,
            source=source,
            calibration=before.calibration,
            progress=advance,
        )
    after = None
    if discovery.adopted:
        after = identify(measurements, robot, source, adopted=discovery.adopted, tolerances=tolerances)
    checked = None
    simulated = tuple(one for one in discovery.adopted if one.effect not in MOTION_EFFECTS)
    if check and any(not one.effect.misreads for one in simulated):
        with progress("the adopted model in full dynamics", 80, 0) as advance:
            checked = check_in_dynamics(discovery, simulated, workers, advance)
    inputs = {"measurements": source, "robot": robot.path.name, "seed": seed, "no_check": not check}
    explanations, observed = discovery.explanations, discovery.observed.measurements
    try:
        proposals = propose_experiments(observed, robot, discovery.verdict, explanations)
        ranking = proposals.experiments
    except InputError:  # none can be weighed, which the story says
        ranking = ()
    assert discovery.heldout is not None
    sentences = story(discovery, ranking)
    if len(observed) < len(measurements):
        sentences.append(
            f"The robot moved: of {len(measurements)} rows the {len(observed)} were searched that are so far "
            "apart that their noise is independent."
        )
    lasting = [effect for effect in discovery.corrections if everywhere(effect.target)]
    calibration = discovery.selection.calibration
    sides = {
        "before": residuals(discovery.observed, discovery.selection.null.linear.theta),
        "after": left_by(calibration, calibration.observed),
    }
    return Discovered(
        **{name: getattr(discovery, name) for name in AS_FOUND},
        runners_up=tuple(
            Explanation(fitted.instance, fitted.log_bayes_factor, k + 1)
            for k in discovery.effects
            for fitted in discovery.runners_up(k)
        ),
        weakly_detectable=discovery.selection.weak,
        heldout=discovery.heldout,
        next_experiments=tuple(ranking),
        before=before,
        after=after,
        alarm_p=discovery.selection.p,
        story=tuple(sentences),
        check=checked,
        robot=robot,
        measurements=measurements,
        residuals={"posture": observed.posture, "placement": observed.placement, "time": observed.time}
        | {f"{side}.{part}": values[:, k] for side, values in sides.items() for k, part in enumerate(PARTS)},
        rig_files=rig_files(robot, lasting) if lasting else {},
        document=made_by("discover", inputs, robot),
        discovery=discovery,
    )
