"""The sum over strips at the pace of a picture: connections from a table, and one horizon for all that comes along it.

How light travels from a strip's point to a face depends on how far aside and how high each is, and on nothing else:
once per sensor it is tabulated (transport.arrive), between flat layers smooth as one over the square of the distance.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tacgen.compiled import njit, prange
from tacgen.optics.shadows import Terrain, horizon
from tacgen.optics.strip_light import Panels, Points, Slab, arrive, ggx, layer, shaded
from tacgen.optics.surface_grid import Sheet, Untouched

if TYPE_CHECKING:
    from tacgen.optics.description import LitSensor

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

ASIDE, DEEP = 0.1, 0.1  # [mm] between entries of the table
RISE = 1.0  # [mm] by which a bulging face may be higher than untouched
LATTICE = 1.0  # [mm] between places of the face for which it is known how the strips shade each other
WITHIN = (-0.75, -0.25, 0.25, 0.75)  # places up a point's piece of strip, in halves of it, that are tried for that


class Beams(NamedTuple):
    """A sensor's strips, columns of `up` points each, and the table of their connections."""

    points: Points
    up: int  # points in a column
    middle: Floats  # of each column [mm], (columns, 2)
    level: NDArray[np.int64]  # which height of the table a point has, (p,)
    bend: Floats  # sine at the point for one of 1 at the face, (p,)
    table: Singles  # transport.arrive's four, straight and mirrored, (levels, heights, ways aside, 8)
    floor: float  # lowest height in the table [mm]
    passed: Singles  # share that strips let pass to the untouched face, (rows, columns, p, 2: straight and mirrored)
    shade: NDArray[np.bool_]  # whether any of it is less than 1 around a cell, (rows - 1, columns - 1)
    size: Floats  # of the rectangle over which they lie [mm], (2,)

    @classmethod
    def of(cls, sensor: "LitSensor", points: Points, up: int, sheet: Sheet) -> "Beams":
        """For faces of a sheet, anywhere in the outermost layer."""
        slab, at, (x, y) = Slab.of(sensor), points.at, np.array(sheet.size) / 2
        middle = at[:, :2].reshape(-1, up, 2).mean(axis=1)
        corners = np.array([[x, y], [x, -y], [-x, y], [-x, -y]])
        reach = np.linalg.norm(at[:, None, :2] - corners, axis=2).max() + 1.0
        heights, level = np.unique(at[:, 2].round(6), return_inverse=True)
        home = np.array([layer(z, slab.tops) for z in heights])
        floor = float(slab.bottoms[-1]) + 0.5 * DEEP
        z, aside = np.arange(floor, RISE + DEEP, DEEP), np.arange(0.0, reach + ASIDE, ASIDE)
        aside[0] = 1e-3 * ASIDE
        table = tabulate(z, aside, heights, home, slab)
        lattice = Sheet.over(sensor.gel, LATTICE)
        face = np.column_stack([lattice.rest, Untouched.of(sensor.gel).at(lattice.rest)[:, 2]])
        passed = sift(face, points, home[level], Panels.of(sensor.leds), slab).reshape(*lattice.shape, -1, 2)
        least = passed.min(axis=(2, 3))
        around = np.minimum(np.minimum(least[1:, 1:], least[:-1, 1:]), np.minimum(least[1:, :-1], least[:-1, :-1]))
        bend = slab.indices[-1] / slab.indices[home][level]
        return cls(points, up, middle, level, bend, table, floor, passed, around < 1.0, np.array(sheet.size))


@njit(cache=True, parallel=True)
def tabulate(z: Floats, aside: Floats, sources: Floats, home: NDArray[np.int64], slab: Slab) -> Singles:
    """transport.arrive for every source, height, way aside and image: (sources, heights, ways, 8)."""
    out = np.empty((len(sources), len(z), len(aside), 8), np.float32)
    for s in prange(len(sources)):
        for i in range(len(z)):
            for r in range(len(aside)):
                for image in range(2):
                    found = arrive(aside[r], z[i], sources[s], home[s], image, slab)
                    for c in range(4):
                        out[s, i, r, 4 * image + c] = found[c]
    return out


@njit(cache=True, parallel=True)
def sift(face: Floats, points: Points, home: NDArray[np.int64], panels: Panels, slab: Slab) -> Singles:
    """Share of the light from each point's piece, straight and mirrored, that strips let pass to places of the face
    (n, 3): (n, p, 2)."""
    out = np.zeros((len(face), len(points.at), 2), np.float32)
    for s in prange(len(face)):
        p = face[s]
        for q in range(len(points.at)):
            up = panels.up[points.strip[q]]
            rise = up / max(np.sqrt((up * up).sum()), 1e-9) * points.half[q]
            for t in WITHIN:
                at = points.at[q] + t * rise
                rho = max(np.sqrt((at[0] - p[0]) ** 2 + (at[1] - p[1]) ** 2), 1e-9)
                for image in range(2):
                    k = arrive(rho, p[2], at[2], home[q], image, slab)[0] * slab.indices[-1]
                    if not shaded(panels, p, at, home[q], image, k, slab):
                        out[s, q, image] += 1.0 / len(WITHIN)
    return out


@njit(cache=True, parallel=True, error_model="numpy", fastmath={"contract", "nsz", "arcp", "reassoc"})
def shine(p: Floats, n: Floats, view: Floats, beams: Beams, strips: int, alpha: float, terrain: Terrain) -> Floats:
    """What transport.gather gives, (samples, strips, 2); alpha 0 leaves out the mirror-rough coat."""
    points, _, middle, level, bend, table, floor, passed, shady, size = beams  # loops in parallel take no nested tuples
    at, light_normal, area, half, strip, lobe = points
    out, up = np.zeros((len(p), strips, 2)), len(at) // len(middle)
    for s in prange(len(p)):
        if np.isnan(p[s, 0]):
            continue
        x, y, z = p[s]
        nx, ny, nz = n[s]
        vx, vy, vz = view[s]
        got = np.empty(8, np.float32)
        ray = np.empty((2 * up, 5))  # its cosine at the face, weight, slope, shadow's softness, cosine to the camera's
        ci = max(nx * vx + ny * vy + nz * vz, 0.05)
        deep = min(max((z - floor) / DEEP, 0.0), table.shape[1] - 1.001)
        i = int(deep)
        a = np.float32(deep - i)
        across = (x / size[0] + 0.5) * (passed.shape[1] - 1)
        down = (y / size[1] + 0.5) * (passed.shape[0] - 1)
        across = min(max(across, 0.0), passed.shape[1] - 1.001)
        down = min(max(down, 0.0), passed.shape[0] - 1.001)
        g, h = int(across), int(down)
        e, f = np.float32(across - g), np.float32(down - h)
        shade = shady[h, g]
        for c in range(len(middle)):
            rays, above, below = 0, (1e9, -1e9), (1e9, -1e9)
            for q in range(c * up, (c + 1) * up):
                dx, dy = at[q, 0] - x, at[q, 1] - y
                rho = max(np.sqrt(dx * dx + dy * dy), 1e-9)
                dx, dy = dx / rho, dy / rho
                way = min(rho / ASIDE, table.shape[2] - 1.001)
                r = int(way)
                u = level[q]
                b = np.float32(way - r)
                for k in range(8):
                    near = table[u, i, r, k] + a * (table[u, i + 1, r, k] - table[u, i, r, k])
                    far = table[u, i, r + 1, k] + a * (table[u, i + 1, r + 1, k] - table[u, i, r + 1, k])
                    got[k] = near + b * (far - near)
                turned = bend[q] * (light_normal[q, 0] * dx + light_normal[q, 1] * dy)
                onto, back, soft = nx * dx + ny * dy, vx * dx + vy * dy, half[q] / rho
                for k in range(0, 8, 4):
                    sg, cg = got[k], got[k + 1]
                    co = onto * sg + nz * cg
                    facing = got[k + 2] * light_normal[q, 2] - sg * turned
                    if co <= 0.0 or facing <= 0.0 or got[k + 3] <= 0.0:
                        continue
                    slope = cg / sg
                    if k == 0:
                        above = min(above[0], slope - soft), max(above[1], slope + soft)
                    else:
                        below = min(below[0], slope - soft), max(below[1], slope + soft)
                    weight = got[k + 3] * facing ** (1 + lobe[q]) * area[q]
                    if shade:
                        m = k // 4
                        near = passed[h, g, q, m] + e * (passed[h, g + 1, q, m] - passed[h, g, q, m])
                        far = passed[h + 1, g, q, m] + e * (passed[h + 1, g + 1, q, m] - passed[h + 1, g, q, m])
                        weight *= near + f * (far - near)
                    ray[rays, 0], ray[rays, 1], ray[rays, 2] = co, weight, slope
                    ray[rays, 3], ray[rays, 4] = soft, back * sg + vz * cg
                    rays += 1
            if rays == 0:
                continue
            above = above if above[0] <= above[1] else below
            below = below if below[0] <= below[1] else above
            dx, dy = middle[c, 0] - x, middle[c, 1] - y
            rho = max(np.sqrt(dx * dx + dy * dy), 1e-9)
            edge = horizon(terrain, x, y, z, dx / rho, dy / rho, rho, above, below)
            matt, gloss = 0.0, 0.0
            for k in range(rays):
                weight = ray[k, 1] * min(max(0.5 + 0.5 * (edge - ray[k, 2]) / ray[k, 3], 0.0), 1.0)
                matt += weight * ray[k, 0]
                if alpha > 0.0 and weight > 0.0:
                    gloss += weight * ggx(ray[k, 4], ci, ray[k, 0], alpha)
            out[s, strip[c * up], 0] += matt / np.pi
            out[s, strip[c * up], 1] += gloss
    return out
