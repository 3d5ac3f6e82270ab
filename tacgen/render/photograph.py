"""Photographs, read with Pillow."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from tacgen.base import regular_file
from tacgen.base.errors import UserError, why

if TYPE_CHECKING:
    import numpy as np

MAX_PHOTO_BYTES = 200_000_000  # largest file [bytes]
MAX_PHOTO_PIXELS = 50_000_000
PHOTO_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP")  # some of Pillow's other readers start programs


def read(path: Path) -> "np.ndarray":
    """The picture (H, W, 3), 8 bit. Raises UserError: it cannot be read, or has more than MAX_PHOTO_PIXELS."""
    import io

    import numpy as np
    from PIL import Image

    try:
        content = regular_file.read_bytes(path, MAX_PHOTO_BYTES)
    except FileNotFoundError:
        raise UserError(f"{path}: cannot be read: no such file") from None
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {why(error)}") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about the size, which is checked below
            with Image.open(io.BytesIO(content), formats=PHOTO_FORMATS) as picture:
                if picture.width * picture.height > MAX_PHOTO_PIXELS:
                    size = f"{picture.width} x {picture.height}"
                    raise UserError(
                        f"{path}: is {size} pixels, at most {MAX_PHOTO_PIXELS / 1e6:.0f} million can be read: scale it "
                        f"down"
                    )
                return np.asarray(picture.convert("RGB"))
    except UserError:
        raise
    except Exception as error:  # Pillow's readers raise many types of errors for a damaged file
        raise UserError(f"{path}: is no picture that can be read: save it as PNG or JPEG") from error


def shrunk(light: "np.ndarray", width: int, height: int) -> "np.ndarray":
    """A picture of linear light (H, W, 3) averaged over larger pixels (height, width, 3)."""
    import numpy as np
    from PIL import Image

    channels = [Image.fromarray(c) for c in np.moveaxis(light.astype(np.float32), -1, 0)]
    return np.stack([np.asarray(c.resize((width, height), Image.Resampling.BOX), dtype=float) for c in channels], -1)
