"""Draw the gels of sensors that are solids of revolution: sensors/digit_pinki_gel.obj and sensors/tactip_gel.obj.

python scripts/make_gels.py -o sensors
"""

import argparse
from pathlib import Path

import numpy as np

AROUND = 64  # vertices of a ring
RING_DEG = 3.75  # between two rings of a half ball [deg]
GELS = {  # radius of the half ball, height of the cylinder below it [mm]
    "digit_pinki": (7.5, 4.8),
    "tactip": (20.0, 0.0),
}


def solid(radius: float, below: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) [mm] and triangles (m, 3), seen from outside in anticlockwise order, of a half ball on a
    cylinder; the base is at z = 0."""
    angles = np.radians(np.arange(0, 90, RING_DEG))
    rings = [(radius, z) for z in np.linspace(0, below, int(np.ceil(below)) + 1)[:-1]] if below else []
    rings += [(radius * np.cos(a), below + radius * np.sin(a)) for a in angles]
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    points = [np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(AROUND, z)]) for r, z in rings]
    ends = [[0, 0, 0], [0, 0, below + radius]]
    k, after = np.arange(AROUND), np.roll(np.arange(AROUND), -1)
    base, crown = len(rings) * AROUND + np.arange(2)
    last = (len(rings) - 1) * AROUND
    faces = [np.stack([after, k, np.full(AROUND, base)], 1)]
    faces.append(np.stack([last + k, last + after, np.full(AROUND, crown)], 1))
    for low in range(0, last, AROUND):
        high = low + AROUND
        faces += [np.stack([low + k, low + after, high + after], 1), np.stack([low + k, high + after, high + k], 1)]
    return np.concatenate([*points, ends]), np.concatenate(faces)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("sensors"))
    out = parser.parse_args().out
    for name, sizes in GELS.items():
        points, triangles = solid(*sizes)
        lines = ["v {:.4f} {:.4f} {:.4f}".format(*point) for point in points]
        lines += ["f {} {} {}".format(*triangle) for triangle in triangles + 1]
        (out / f"{name}_gel.obj").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
