"""Gaussian filter of pictures."""

from typing import TYPE_CHECKING

import numpy as np

from tacgen.physics import filters, runtime

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def blur(picture: "Floats", sd: float, truncate: float = 4.0, across: float | None = None) -> "Floats":
    """A picture (H, W, c) averaged by a Gaussian of standard deviation `sd` [px], cut off at `truncate` of these; its
    edge goes on beyond it. `across`: another deviation across the picture than down.

    As scipy.ndimage.gaussian_filter(picture, (sd, sd, 0), mode="nearest"), in a quarter of the time: values of a row
    are averaged together.
    """
    picture = np.ascontiguousarray(picture, dtype=np.float64)
    (h, w, count), down = picture.shape, weights(sd, truncate)
    along = down if across is None else weights(across, truncate)
    out, line = np.empty(picture.shape), np.empty(h * (w + 2 * len(along) - 2) * count)
    runtime.call(filters.blurred, (h,), picture.reshape(-1), down, along, h, w * count, count, line, out.reshape(-1))
    return out


def weights(sd: float, truncate: float = 4.0) -> "Floats":
    """Weights (n,) of the distances 0 to n - 1 [px] in a Gaussian of standard deviation `sd` [px], as in `blur`."""
    x = np.arange(int(truncate * sd + 0.5) + 1)
    each = np.exp(-0.5 * (x / sd) ** 2)
    return np.asarray(each / (2 * each.sum() - each[0]))
