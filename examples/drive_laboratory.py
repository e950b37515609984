"""Drive the laboratory by a controller of one's own: shift the load until both plates carry half.

Run it: python examples/drive_laboratory.py. The controller knows what a real one would know, the nominal
model and the cells: where one plate carries too much, it moves the commanded centre of mass away from it.
"""

import numpy as np

from tulip_testbed.identification.inverse_kinematics import InverseKinematics
from tulip_testbed.sim.composer import laboratory_environment
from tulip_testbed.sim.rig import preset_rig

SWING_FOOT = np.array([0.0, 0.16, 0.0])  # m, m, rad, beside the stance foot
FORWARD, HEIGHT = 0.02, 0.66  # m, of the centre of mass
START = 0.3  # of the way from the stance foot to the swing foot
RATE = 0.1  # m/s per share of the load
ENOUGH = 0.01  # of the load: within it the controller rests
REST = 1.0  # s, in which the robot comes to rest first
DURATION = 10.0  # s


def main() -> None:
    rig = preset_rig("force-plate")
    model = rig.robot.model
    kinematics = InverseKinematics(rig.robot, model)
    guess = model.key("stand").qpos.copy()

    def posture(sideways: float) -> np.ndarray:
        angles = kinematics.solve(SWING_FOOT, np.array([FORWARD, sideways, HEIGHT]), np.zeros(3), guess)
        if angles is None:
            raise SystemExit(f"no posture has its centre of mass {1e3 * sideways:.0f} mm to the left")
        return angles

    sideways = START * SWING_FOOT[1]
    environment = laboratory_environment(
        rig,
        posture(sideways),
        time_limit=DURATION,
        seed=1,
        # Each cell as the mean of its last 20 samples, 0.2 s.
        observable_options={"cells": {"buffer_size": 20, "aggregator": "mean"}},
    )
    period = environment.control_timestep()
    steps, balanced = 0, None
    step = environment.reset()
    print("time (s)   right (N)   left (N)   left's share   commanded centre of mass (mm to the left)")
    while not step.last():
        step = environment.step(posture(sideways))
        steps += 1
        right, left = (step.observation[f"{side}_plate/cells"].sum() for side in ("right", "left"))
        excess = left / (right + left) - 0.5
        if abs(excess) > ENOUGH:
            balanced = None
            if steps * period > REST:
                sideways -= RATE * excess * period
        elif balanced is None:
            balanced = steps * period
        if steps % round(1.0 / period) == 0:
            forces = f"{right:11.1f} {left:10.1f} {0.5 + excess:14.3f}"
            print(f"{steps * period:8.1f} {forces} {1e3 * sideways:11.1f}")
    if steps < round(DURATION / period):
        print(f"the robot tipped after {steps * period:.1f} s")
    elif balanced is None:
        print(f"not balanced after {DURATION:.0f} s")
    else:
        print(f"both plates carry half of the load, to {100 * ENOUGH:.0f} % of it, from {balanced:.1f} s on")


if __name__ == "__main__":
    main()
