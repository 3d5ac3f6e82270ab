"""The photometric-stereo network that users of such sensors train: change of colour and pixel position -> normal.

Three hidden layers of 64 rectified units, as in the SDK of the Mini's maker (gelsightinc/gsrobotics, RGB2NormNet), for
pictures smoothed by a Gaussian, over the untouched picture: power of the lamps and gain of the camera, in which units
differ, cancel; fitted by L-BFGS to least squares with weight decay. Small enough for NumPy, and the same bytes for the
same samples. One network alone depends on its start, so the normals are the mean of several, each with a start and
samples of its own (bagging, Breiman 1996). The decay is inversely proportional to the number of presses: pixels of one
press are alike, so presses, not pixels, are what a prior of the weights is weighed against. Noise is added to the
colours in training, as a unit is never quite like its file; it makes the network smoother (Bishop 1995). All settings
were chosen on rendered dents that the network had not seen (docs/OPTICS.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize

Array = np.ndarray
HIDDEN_UNITS = (64, 64, 64)  # units of the hidden layers
CHANGE_BLUR_PX = 2.0  # standard deviation of the Gaussian by which a change is smoothed [px]
CHANGE_PER_INPUT_UNIT = 0.4  # change of colour that is scaled to 1 at the input, over the untouched colour [-]
MIN_UNTOUCHED_COUNTS = 8.0  # untouched colour at least by which a change is divided: below is noise [counts]
WEIGHT_DECAY = 0.01  # factor of the squared weights in the loss, times the number of presses
TRAINING_NOISE = 0.01  # standard deviation of the noise on smoothed relative changes in training [-]
MAX_LBFGS_STEPS = 300  # iterations of L-BFGS at most
ENSEMBLE_SIZE = 4  # networks whose outputs are averaged
TRAINING_SAMPLES = 2000  # training samples of each, about

Layers = tuple[tuple[Array, Array], ...]


@dataclass(frozen=True)
class NormalNet:
    """Weights and biases of the layers of each member."""

    members: tuple[Layers, ...]

    @classmethod
    def trained(cls, presses: Sequence[tuple[Array, Array]]) -> "NormalNet":
        """Train on presses: features (n, 5) of each, see `features`, and x and y of unit normals (n, 2)."""
        return cls(tuple(_member(presses, np.random.default_rng(seed)) for seed in range(ENSEMBLE_SIZE)))

    def normals(self, features: Array) -> Array:
        """x and y of the unit normals (n, 2) of samples (n, 5)."""
        return np.asarray(np.mean([_output(layers, features) for layers in self.members], axis=0))


def _output(layers: Layers, values: Array) -> Array:
    for weight, bias in layers[:-1]:
        values = np.maximum(values @ weight + bias, 0)
    weight, bias = layers[-1]
    return np.asarray(values @ weight + bias)


def _member(presses: Sequence[tuple[Array, Array]], random: np.random.Generator) -> Layers:
    """One network, trained on the same number of pixels of each press."""
    each, decay = -(-TRAINING_SAMPLES // len(presses)), WEIGHT_DECAY / len(presses)
    chosen = [
        [part[some] for part in press] for press in presses for some in [random.permutation(len(press[0]))[:each]]
    ]
    x, wanted = (np.concatenate(part).astype(np.float32) for part in zip(*chosen, strict=True))
    x[:, :3] += random.normal(0, TRAINING_NOISE / CHANGE_PER_INPUT_UNIT, (len(x), 3))
    sizes = (x.shape[1], *HIDDEN_UNITS, 2)
    start = [random.standard_normal((a + 1, b)) / np.sqrt(a) for a, b in pairwise(sizes)]
    cuts = np.cumsum([w.size for w in start])[:-1]

    def weights(flat: Array) -> list[Array]:
        return [part.reshape(w.shape) for part, w in zip(np.split(flat, cuts), start, strict=True)]

    def loss(flat: Array) -> tuple[float, Array]:
        tables, values = weights(flat.astype(np.float32)), [x]
        for w in tables[:-1]:
            values.append(np.maximum(values[-1] @ w[:-1] + w[-1], 0))
        off = values[-1] @ tables[-1][:-1] + tables[-1][-1] - wanted
        back, slope = 2 * off / len(off), []
        for value, w in zip(values[::-1], tables[::-1], strict=True):
            slope.append(np.vstack([value.T @ back, back.sum(axis=0)]).ravel())
            back = (back @ w[:-1].T) * (value > 0)
        squares = float((off.astype(float) ** 2).sum())
        return squares / len(off) + decay * flat @ flat, np.concatenate(slope[::-1]) + 2 * decay * flat

    flat = np.concatenate([w.ravel() for w in start])
    best = weights(minimize(loss, flat, jac=True, method="L-BFGS-B", options={"maxiter": MAX_LBFGS_STEPS}).x)
    return tuple((w[:-1], w[-1]) for w in best)


def features(change: Array, untouched: Array, where: Array) -> Array:
    """Inputs (n, 5) for the pixels `where` (H, W) bool: the change of colour (H, W, 3) against the untouched picture
    (H, W, 3) over that [counts], both smoothed, and the position from -1 to 1 along the picture's width."""
    (h, w), (y, x) = where.shape, np.nonzero(where)
    change, level = (gaussian_filter(one.astype(float), (CHANGE_BLUR_PX, CHANGE_BLUR_PX, 0))[where]
                     for one in (change, untouched))  # fmt: skip
    relative = change / np.maximum(level, MIN_UNTOUCHED_COUNTS)
    return np.column_stack([relative / CHANGE_PER_INPUT_UNIT, 2 * (x + 0.5) / w - 1, (2 * y + 1 - h) / w])


def degrees_apart(a: Array, b: Array) -> Array:
    """Angles (n,) [deg] between unit normals given by x and y (n, 2), which are limited to length 1."""
    one, other = (s / np.maximum(1.0, np.linalg.norm(s, axis=1, keepdims=True)) for s in (a, b))
    up = np.prod([np.sqrt(np.maximum(1 - (s**2).sum(axis=1), 0)) for s in (one, other)], axis=0)
    return np.asarray(np.degrees(np.arccos(np.clip((one * other).sum(axis=1) + up, -1, 1))))
