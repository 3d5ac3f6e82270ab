"""OpenEXR: one 32-bit multi-channel image per frame, with linear light and geometry behind each pixel.

R, G, B (`radiance`), Z (`height` [mm], z out of the gel), N.X, N.Y, N.Z (`normals`), P.X, P.Y (`material` [mm]):
those that the bundle holds in the size of the images.
"""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacgen.base.output_file import add
from tacgen.bundle.bundle import Bundle
from tacgen.export import names, needs

EXR_CHANNELS = {"radiance": "R G B", "height": "Z", "normals": "N.X N.Y N.Z", "material": "P.X P.Y"}


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """`out/<scene>_<frame>.exr`. Raises UserError: a bundle has no radiance."""
    for bundle in bundles:
        needs(bundle, ("/frames/radiance",), "radiance")
    made = []
    for name, bundle in zip(names(bundles), bundles, strict=True):
        for k in range(bundle.frames):
            made.append(add(out / f"{name}_{k:05d}.exr", encoded(channels(bundle, k))))
    return made


def encoded(layers: dict[str, np.ndarray]) -> bytes:
    """Channels (H, W) by name as the bytes of a file.

    OpenEXR writes into memory: where a disk is full, it says nothing as it closes a small file, and gives no errno for
    a larger one.
    """
    import OpenEXR

    header, memory = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, os.memfd_create("exr")
    with os.fdopen(memory, "rb") as file, OpenEXR.File(header, layers) as picture:
        picture.write(f"/proc/self/fd/{memory}")
        return file.read()


def channels(bundle: Bundle, frame: int) -> dict[str, np.ndarray]:
    """The channels (H, W) of a frame by name."""
    channel: dict[str, np.ndarray] = {}
    for field, called in EXR_CHANNELS.items():
        if bundle.shapes.get(path := f"/frames/{field}", ())[:3] == bundle.shapes["/frames/radiance"][:3]:
            values = bundle.frame(path, frame)
            layers = np.atleast_3d(values).astype(np.float32)
            channel |= {c: np.ascontiguousarray(layers[..., i]) for i, c in enumerate(called.split())}
    return channel
