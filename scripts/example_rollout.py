"""The pose table of recipes/replay.yaml: a ball that a robot lowers onto a sensor, rolls across it and lifts again.

    python scripts/example_rollout.py > recipes/rollout.csv

Written as a simulator would: poses of the ball's centre in the world, metres and quaternions, one row each 40 ms.
"""

import numpy as np
from scipy.spatial.transform import Rotation

RADIUS, DEPTH, WAY = 4.0, 0.8, 3.0  # mm
SENSOR = Rotation.from_euler("z", 90, degrees=True)  # of the sensor in the world
PLACE = np.array([0.35, 0.10, 0.02])  # m


def main() -> None:
    s = np.linspace(0, 1, 15)
    down = np.interp(s, [0, 0.3, 0.7, 1], [-0.3, 1, 1, -0.3]) * DEPTH  # below first touch [mm]
    x = np.interp(s, [0.2, 0.8], [-WAY / 2, WAY / 2])
    centre = np.column_stack([x, np.zeros_like(x), RADIUS - down])
    rolled = Rotation.from_rotvec(np.outer(x / RADIUS, [0.0, 1.0, 0.0]))  # about y, as x grows
    position = PLACE + SENSOR.apply(centre) / 1000
    print("time_s,x_m,y_m,z_m,qw,qx,qy,qz")
    for t, p, q in zip(0.04 * np.arange(len(s)), position, (SENSOR * rolled).as_quat(scalar_first=True), strict=True):
        print(",".join([f"{t:.2f}", *(f"{v:.7f}" for v in p), *(f"{v:.7f}" for v in q)]))


if __name__ == "__main__":
    main()
