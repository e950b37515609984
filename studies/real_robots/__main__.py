"""Draw the pictures of docs/how-to/real-robot.md: `TULIP_ICUB_YOGA=... python -m studies.real_robots`.

They show what models predict of each half of a real iCub's log. The variable names the folder of log and
URDF.
"""

import os
import sys

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as in studies/__main__.py
os.environ.setdefault("MUJOCO_GL", "disable")

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import tulip_testbed as tt
from studies.study_real_robots import ICUB, ROBOTS
from studies.teaching.style import DOCS, GREY, X, card, save_svg
from tulip_testbed.experiments.posture_splits import by_halves
from tulip_testbed.experiments.predict import PredictionProblem, cad_errors, corrected_errors
from tulip_testbed.identification.base_parameters import common_support
from tulip_testbed.identification.nominal import nominal_robot

MAP = Path(__file__).resolve().parents[2] / "examples" / "icub_yoga.toml"
LOG = "left_foot_yoga.csv"


def main(data: Path) -> None:
    """Draw the centre of pressure over time, along x and along y."""
    _, urdf, feet, sole, _ = ROBOTS["icub"]
    with TemporaryDirectory() as scratch:
        tt.describe_robot(data / urdf, feet=feet, sole=sole, out=f"{scratch}/icub")
        robot = tt.load_robot(f"{scratch}/icub/robot.toml")
        tt.import_table(data / LOG, robot, out=f"{scratch}/yoga", map=[str(MAP)])
        m = tt.read_measurements(f"{scratch}/yoga")
    problem = PredictionProblem(m, nominal_robot(robot, common_support(m.support)))
    cad, corrected = np.empty((2, len(m), 2))
    for train, test in by_halves(m).folds:
        cad[test] = cad_errors(problem, train, offset=True)[test]
        corrected[test], _ = corrected_errors(problem, (), train, test)
    order, measured = np.argsort(m.time), problem.center - problem.center.mean(axis=0)
    for k, axis in enumerate("xy"):
        with card(8.2, 2.9) as (figure, ax):
            lines = (
                ("measured", 0 * cad, "black", 2.2, "-"),
                ("CAD with offset", cad, GREY, 1.4, "--"),
                ("identified with corrections", corrected, X, 1.4, "-"),
            )
            for name, error, colour, width, style in lines:
                rms = float(np.sqrt((error[:, k] ** 2).mean()))
                label = f"{name}, off by {1e3 * rms:.1f} mm" if rms else name
                values = 1e3 * (measured - error)[order, k]
                ax.plot(m.time[order], values, style, color=colour, linewidth=width, label=label)
            ax.set(xlabel="time, s", ylabel=f"centre of pressure, {axis}, mm")
            figure.legend(loc="outside upper left", ncols=3)
            print(save_svg(figure, DOCS / f"real-robot-{axis}.svg"))


if source := os.environ.get(ICUB):
    main(Path(source))
else:
    sys.exit(f"{ICUB} names no folder; docs/studies/real-robots.md says where the data are from")
