"""Make the meshes in objects/: plain solids with the details that touch research presses, each one closed body.

    python scripts/make_objects.py        # writes objects/<name>/<name>.stl, the same bytes each time

Lengths in mm; z up, the side that meets the gel down at z = 0 (recipes turn others with `up`).
"""

from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent / "objects"
Array = np.ndarray
Ring = list[Array]  # loops (n, 3) of equally many points


def loft(sections: Ring, *, closed: bool = False, middle: Array | None = None) -> tuple[Array, Array]:
    """A skin over sections of equally many points each; ends are closed by fans unless the last joins the first.

    A fan's point is the mean of its section, or that at x of `middle` (y, z).

    Returns:
        vertices (v, 3), triangles (t, 3), wound outward where sections turn left seen from the last to the first.
    """
    n, m = len(sections[0]), len(sections)
    vertices = np.concatenate(sections)
    around = np.arange(n)
    triangles = []
    for k in range(m if closed else m - 1):
        a, b = k * n, (k + 1) % m * n
        i, j = around, (around + 1) % n
        triangles += [np.stack([a + i, a + j, b + j], 1), np.stack([a + i, b + j, b + i], 1)]
    if not closed:
        low, high = sections[0].mean(0), sections[-1].mean(0)
        if middle is not None:  # the whole section must be seen from it
            low[1:], high[1:] = middle, middle
        vertices = np.concatenate([vertices, [low, high]])
        last = (m - 1) * n
        triangles.append(np.stack([(around + 1) % n, around, np.full(n, m * n)], 1))
        triangles.append(np.stack([last + around, last + (around + 1) % n, np.full(n, m * n + 1)], 1))
    return vertices, np.concatenate(triangles)


def circle(radius: float, z: float, n: int) -> Array:
    t = np.arange(n) * 2 * np.pi / n
    return np.stack([radius * np.cos(t), radius * np.sin(t), np.full(n, z)], 1)


def level(outline: Array, z: float) -> Array:
    return np.column_stack([outline, np.full(len(outline), z)])


def hexagon(across_flats: float, rounding: float, n: int = 8) -> Array:
    """A hexagon (6 n, 2) whose corners are arcs of n points."""
    inner = across_flats / 2 - rounding
    loops = []
    for k in range(6):
        middle = np.radians(60 * k + 30)
        corner = inner / np.cos(np.pi / 6) * np.array([np.cos(middle), np.sin(middle)])
        t = middle + np.linspace(-np.pi / 6, np.pi / 6, n)
        loops.append(corner + rounding * np.stack([np.cos(t), np.sin(t)], 1))
    return np.concatenate(loops)


def hex_bolt() -> tuple[Array, Array]:
    """The head of an M5 bolt, 8 mm across flats and 3.5 mm high, edges rounded by 0.3 mm, with a dished face."""
    sections = [level(hexagon(8.0, 0.5) * s, 0.35) for s in (0.15, 0.3)]  # the dish's floor
    sections += [level(hexagon(8.0, 0.5) * s, z) for s, z in ((0.45, 0.35), (0.55, 0.1), (0.62, 0.0))]
    for t in np.linspace(0, np.pi / 2, 7):
        sections.append(level(hexagon(8.0 - 0.6 * (1 - np.sin(t)), 0.5 - 0.3 * (1 - np.sin(t))), 0.3 * (1 - np.cos(t))))
    sections.append(level(hexagon(8.0, 0.5), 3.5))
    return loft(sections)


def gear() -> tuple[Array, Array]:
    """A spur gear lying flat: 12 teeth, 10 mm across, bore of 3 mm, 3 mm thick, edges broken by 0.15 mm."""
    n = 16
    t = np.arange(12 * n) * 2 * np.pi / (12 * n)
    wave = np.clip(1.6 * np.cos(12 * t), -1, 1)
    outer, inner = 4.3 + 0.7 * wave, np.full(len(t), 1.5)
    ray = np.stack([np.cos(t), np.sin(t)], 1)
    profile = [(inner, 0.15, 0), (inner + 0.15, 0.0, 0), (outer, 0.0, -0.15), (outer, 0.15, 0), (outer, 2.85, 0)]
    profile += [(outer, 3.0, -0.15), (inner + 0.15, 3.0, 0), (inner, 2.85, 0)]
    return loft([level(ray * (r + more)[:, None], z) for r, z, more in profile], closed=True)


def ring() -> tuple[Array, Array]:
    """A finger ring lying flat: 9 mm across the middle of a band 1.6 mm wide and 2.4 mm high, with an oval section."""
    t = np.arange(24) * 2 * np.pi / 24 - np.pi
    return loft([circle(4.5 - 0.8 * np.cos(a), 1.2 + 1.2 * np.sin(a), 76) for a in t[::-1]], closed=True)


def key() -> tuple[Array, Array]:
    """The blade of a key lying flat, 14 mm long and 2 mm thick: five cuts along one side, a groove along the face."""
    x = np.linspace(0, 14, 113)
    depth = np.interp(x, [0, 1.0, 2, 2.6, 3.6, 4.2, 5, 5.4, 6.4, 7.4, 8, 8.6, 9.4, 10, 14],
                      [2.2, 3, 1.8, 1.8, 3.0, 2.3, 2.3, 2.7, 1.3, 1.3, 2.4, 2.4, 1.6, 2.8, 3.0])  # fmt: skip
    sections = []
    for u, top in zip(x, depth, strict=True):
        y = [-3.0, -2.85, -1.6, -1.3, -0.5, -0.2, top - 0.15, top, top, top - 0.15, -2.85, -3.0]
        z = [0.15, 0, 0, 0.4, 0.4, 0, 0, 0.15, 1.85, 2, 2, 1.85]
        sections.append(np.column_stack([np.full(12, u - 7), y, z]))
    return loft(sections, middle=np.array([-0.9, 1.4]))


LETTERS = {
    "T": ["#####", "..#..", "..#..", "..#..", "..#..", "..#..", "..#.."],
    "A": [".###.", "#...#", "#...#", "#####", "#...#", "#...#", "#...#"],
    "C": [".####", "#....", "#....", "#....", "#....", "#....", ".####"],
}


def letters() -> tuple[Array, Array]:
    """TAC in relief on a plate of 11.3 x 5.3 mm: strokes 0.6 mm wide and 0.5 mm high, their sides 0.1 mm across.

    They read from left to right in the image."""
    pixel, side, relief, plate = 0.6, 0.05, 0.5, 1.5
    rows = [".".join(LETTERS[c][k] for c in "TAC") for k in range(7)]
    stamp = np.pad(np.array([[c == "#" for c in row] for row in rows]), 1)
    ny, nx = stamp.shape

    def lines(n: int) -> Array:  # two to a pixel, so that all of a side's slope is between pixels
        edges = (np.arange(n + 1) - n / 2) * pixel
        return np.stack([edges[:-1] + side, edges[1:] - side], 1).ravel()

    depth = relief * ~stamp.repeat(2, 0).repeat(2, 1)
    return plate_with(lines(nx), lines(ny), depth, relief + plate)


def plate_with(x: Array, y: Array, z: Array, top: float) -> tuple[Array, Array]:
    """A block up to `top` whose underside has height z (rows along y) over the grid x, y."""
    ny, nx = z.shape
    X, Y = np.meshgrid(x, y)
    number = np.arange(nx * ny).reshape(ny, nx)
    a, b, c, d = number[:-1, :-1].ravel(), number[:-1, 1:].ravel(), number[1:, 1:].ravel(), number[1:, :-1].ravel()
    vertices = np.column_stack([X.ravel(), Y.ravel(), z.ravel()])
    under = np.concatenate([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])
    rim = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    upper = vertices[rim] * [1, 1, 0] + [0, 0, top]
    k, n, base = np.arange(len(rim)), len(rim), len(vertices)
    j = (k + 1) % n
    sides = np.concatenate([np.stack([rim[k], rim[j], base + j], 1), np.stack([rim[k], base + j, base + k], 1)])
    lid = np.stack([base + k, base + j, np.full(n, base + n)], 1)
    vertices = np.concatenate([vertices, upper, [[x.mean(), y.mean(), top]]])
    return vertices, np.concatenate([under, sides, lid])


OBJECTS = {"hex_bolt": hex_bolt, "gear": gear, "ring": ring, "key": key, "letters": letters}


def write(name: str) -> Path:
    """objects/<name>/<name>.stl, binary."""
    import trimesh

    vertices, triangles = OBJECTS[name]()
    mesh = trimesh.Trimesh(vertices, triangles, process=True)
    assert mesh.is_watertight, name
    assert mesh.is_winding_consistent, name
    assert mesh.volume > 0, name
    path = ROOT / name / f"{name}.stl"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(mesh.export(file_type="stl"))
    return path


if __name__ == "__main__":
    for made in OBJECTS:
        print(write(made))
