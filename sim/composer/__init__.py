"""The laboratory for one's own controller or learning code, as a `dm_env` environment.

Importing this sets MUJOCO_GL to "disable" unless it is set: without a display dm_control would warn.
"""

import os

os.environ.setdefault("MUJOCO_GL", "disable")

from tulip_testbed.sim.composer.environment import laboratory_environment

__all__ = ["laboratory_environment"]
