"""A rod with a flange, most of which is beside a pad."""

import numpy as np
import trimesh


def flanged(rod: float = 4.0, flange: float = 9.0, length: float = 60.0, width: float = 6.0) -> trimesh.Trimesh:
    """A rod along x with a flange at its end, of 24 sides, each of which has a side below."""
    angle = (np.arange(24) + 0.5) * 2 * np.pi / 24
    rings = [(-length / 2, rod), (length / 2 - width, rod), (length / 2 - width, flange), (length / 2, flange)]
    ends = [(x, r / np.cos(np.pi / 24)) for x, r in rings]
    points = [np.column_stack([np.full(24, x), -r * np.sin(angle), r * np.cos(angle)]) for x, r in ends]
    k, after = np.arange(24), np.roll(np.arange(24), -1)
    faces = [np.stack([k, after, np.full(24, 96)], 1), np.stack([after + 72, k + 72, np.full(24, 97)], 1)]
    for i in range(3):
        faces += [np.stack([k + 24 * i, k + 24 * (i + 1), after + 24 * i], 1),
                  np.stack([after + 24 * i, k + 24 * (i + 1), after + 24 * (i + 1)], 1)]  # fmt: skip
    caps = np.array([[-length / 2, 0.0, 0.0], [length / 2, 0.0, 0.0]])
    made = trimesh.Trimesh(np.concatenate([*points, caps]), np.concatenate(faces), process=False)
    made.invert()
    assert made.is_watertight
    assert made.volume > 0
    return made
