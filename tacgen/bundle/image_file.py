"""Pixels as the bytes of an image file, for exports and pages."""

import io
from typing import Any

import numpy as np


def encoded(pixels: np.ndarray, kind: str, width: int | None = None, **options: Any) -> bytes:
    """Pixels (H, W) or (H, W, 3) of 8 or 16 bits as an image file.

    Args:
        kind: Pillow's name of the format, such as PNG.
        width: of the file's image [px], its shape kept; None: as it is.
        options: Pillow's, for this format.
    """
    from PIL import Image

    image, file = Image.fromarray(pixels), io.BytesIO()
    if width is not None:
        image = image.resize((width, max(1, round(width * image.height / image.width))), Image.Resampling.BILINEAR)
    image.save(file, kind, **options)
    return file.getvalue()
