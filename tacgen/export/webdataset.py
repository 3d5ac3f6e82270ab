"""WebDataset: tar files of samples for streaming, one sample per frame.

    https://github.com/webdataset/webdataset

`<scene>-<frame>.rgb.png`, `.force.npy`, `.pose.npy`, `.grasp_object.npy`, ... : every dataset of /frames by its name,
except quality, and `.json`: scene, sensor, caption, frame, segment, varied values, units, and if the bundle has them
the contact events and the number of the contact on several sensors (`pair`) or the `finger` of a grasp. The image of
the untouched sensor is stored once per scene, `reference/<scene>.png`: a copy in each sample would double the size.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import caption, modes
from tacgen.bundle.image_file import encoded
from tacgen.bundle.schema import UNITS
from tacgen.errors import UserError
from tacgen.export import names

SHARD_BYTES = 1_000_000_000


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """`out/shard-000000.tar` and on, each of about a gigabyte."""
    try:
        from webdataset import ShardWriter
    except ImportError:
        raise UserError("export webdataset needs WebDataset: pip install 'tacgen[webdataset]'") from None
    (out / "reference").mkdir()
    made = []
    # no time and no user in the headers, so that the same bundles give the same bytes
    plain = {"mtime": 0, "user": "tacgen", "group": "tacgen", "verbose": 0}
    with ShardWriter(str(out / "shard-%06d.tar"), maxcount=10**9, maxsize=SHARD_BYTES, **plain) as writer:
        for name, bundle in zip(names(bundles), bundles, strict=True):
            for sample in samples(name, bundle):
                writer.write(sample)
            if "/reference/rgb" in bundle:
                made.append(out / "reference" / f"{name}.png")
                made[-1].write_bytes(encoded(bundle["/reference/rgb"], "PNG"))
    return [*sorted(out.glob("shard-*.tar")), *made]


def samples(name: str, bundle: Bundle) -> Iterator[dict[str, Any]]:
    """The samples of a bundle, frame by frame, as WebDataset's writer takes them."""
    apart = ("/frames/quality/", "/frames/events/")
    paths = [path for path in bundle.shapes if path.startswith("/frames/") and not path.startswith(apart)]
    events = {path.rpartition("/")[2]: bundle[path] for path in bundle.shapes if path.startswith("/frames/events/")}
    scene: dict[str, Any] = {"scene": name, "sensor": bundle.attrs["sensor"], "caption": caption(bundle)}
    scene["values"] = json.loads(bundle.attrs.get("values", "{}"))
    scene |= {name: bundle.attrs[name] for name in ("pair", "finger") if name in bundle.attrs}
    for k in range(bundle.frames):
        about = {**scene, "frame": k, "segment": bundle.segments[k], "units": UNITS}
        if events:
            contact = {name: values[k].tolist() for name, values in events.items()}
            about["events"] = contact | {"mode": modes(bundle)[k]}
        sample: dict[str, Any] = {"__key__": f"{name}-{k:05d}", "json": about}
        for path in paths:
            kind = "png" if path == "/frames/rgb" else "npy"
            sample[f"{path.removeprefix('/frames/').replace('/', '_')}.{kind}"] = bundle.frame(path, k)
        yield sample
