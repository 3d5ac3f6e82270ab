"""JPEG compression of pictures, as in cameras that stream MJPEG."""

import io
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

JPEG_SUBSAMPLING = "4:2:2"  # colours at half the width, as cameras stream MJPEG over USB


def compressed(picture: "NDArray[np.uint8]", quality: int) -> "NDArray[np.uint8]":
    """A picture (H, W, 3) encoded as JPEG of a quality from 1 to 100, and decoded.

    The same bytes for the same version of Pillow and its libjpeg; other versions may round differently, by a count.
    """
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).save(file, "JPEG", quality=quality, subsampling=JPEG_SUBSAMPLING)
    with Image.open(file) as seen:
        return np.array(seen.convert("RGB"))
