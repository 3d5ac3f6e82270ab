"""MuJoCo: the pad as a flex of tetrahedra (flexcomp, dim 3) with its E and nu, and a rigid shape held on its path.

The shape is a mocap body, which contact does not move; forces are mj_contactForce at rest in each frame. The damping of
elasticity is large enough for rest; it does not matter at rest. Contact is convex: the ring is 32 capsules.
"""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.referee.case import DENSITY_KG_M3, PAD_MM, POISSONS, YOUNGS_MPA, Case, Pose
from benchmarks.referee.player import Answer, NotPlayed
from benchmarks.referee.players.mujoco_rigid import add_shape, contacts_on
from benchmarks.referee.playing import answer, between, missing, quaternion, versions

DEFAULT = {"young_factor": 1.0, "solref": (0.02, 1.0), "solimp": (0.9, 0.95, 0.001, 0.5, 2.0), "cell_mm": 2.0}
TUNED = DEFAULT
