"""Provide the laboratory as a `dm_env` environment for controllers and learning code.

Importing this package sets MUJOCO_GL to "disable" unless it is set; dm_control warns without a display.
"""

import os

os.environ.setdefault("MUJOCO_GL", "disable")

from tulip_testbed.sim.composer.environment import laboratory_environment

__all__ = ["laboratory_environment"]
