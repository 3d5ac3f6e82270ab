"""WebDataset: tar files of samples for streaming, one sample per frame.

    https://github.com/webdataset/webdataset

`<scene>-<frame>.rgb.png`, `.force.npy`, `.pose.npy`, `.grasp_object.npy`, ... : every dataset of /frames by its name,
except quality, and `.json`: scene, sensor, task, split, frame, segment, varied values, units, and the contact events
if the bundle has them. The task tells the movements, none of the labels. A contact on several sensors, or of the two
fingers of a grasp, is one sample: `.left.rgb.png`, `.right.force.npy`, and `sensors` of the `.json` has those of
each.

The scenes of each split, the same ones as of tacgen.torch, are in tar files of their own: `train-000000.tar`,
`val-000000.tar`, `test-000000.tar`; `splits.json` names them. The image of the untouched sensor is stored once per
scene, `reference/<scene>.png`: a copy in each sample would double the size.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tacgen.base.output_file import add
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.caption import EVENT_MODE_PATH, modes
from tacgen.bundle.image_file import encoded
from tacgen.bundle.schema import UNIT_SYSTEM
from tacgen.export import names, needs_package
from tacgen.export.episodes import SINGLE_SENSOR, Episode, episodes, split_ranges, write_splits

SHARD_BYTES = 1_000_000_000
EVENTS_GROUP = "/frames/events/"


def write(bundles: Sequence[Bundle], out: Path) -> list[Path]:
    """`out/train-000000.tar` and on, each of about a gigabyte, those of the other splits, and the references."""
    webdataset = needs_package("webdataset", "WebDataset")
    every = episodes(bundles)
    # no time and no user in the headers, so that the same bundles give the same bytes
    plain = {"mtime": 0, "user": "tacgen", "group": "tacgen", "verbose": 0}
    for split, (first, end) in split_ranges(every).items():
        pattern = str(out / split).replace("%", "%%") + "-%06d.tar"  # the writer's format string
        with webdataset.ShardWriter(pattern, maxcount=10**9, maxsize=SHARD_BYTES, **plain) as writer:
            for episode in every[first:end]:
                for sample in samples(episode):
                    writer.write(sample)
    made = [*sorted(out.glob("*.tar")), write_splits(every, out)]
    for name, bundle in zip(names(bundles), bundles, strict=True):
        if "/reference/rgb" in bundle:
            made.append(add(out / "reference" / f"{name}.png", encoded(bundle["/reference/rgb"], "PNG")))
    return made


def samples(episode: Episode) -> Iterator[dict[str, Any]]:
    """The samples of an episode, frame by frame, as WebDataset's writer takes them."""
    varied = json.loads(episode.first.attrs.get("values", "{}"))  # by their paths in the recipe
    known = {"scene": episode.name, "task": episode.task, "split": episode.split, "values": varied}
    for k in range(episode.frames):
        about = {**known, "frame": k, "segment": episode.first.segments[k], "units": UNIT_SYSTEM}
        each = {role: _labels(bundle, k) for role, bundle in episode.scenes.items()}
        about |= each.get(SINGLE_SENSOR, {"sensors": each})
        sample: dict[str, Any] = {"__key__": f"{episode.name}-{k:05d}", "json": about}
        for role, bundle in episode.scenes.items():
            prefix = "" if role == SINGLE_SENSOR else f"{role}."
            sample |= {f"{prefix}{name}": array for name, array in _arrays(bundle, k).items()}
        yield sample


def _labels(bundle: Bundle, k: int) -> dict[str, Any]:
    """The sensor of a scene, and its contact events in a frame if they are in the bundle."""
    about: dict[str, Any] = {"sensor": bundle.attrs["sensor"]}
    if EVENT_MODE_PATH in bundle:
        paths = [path for path in bundle.shapes if path.startswith(EVENTS_GROUP)]
        events = {path.removeprefix(EVENTS_GROUP): bundle.frame(path, k).tolist() for path in paths}
        about["events"] = events | {"mode": modes(bundle)[k]}
    return about


def _arrays(bundle: Bundle, k: int) -> dict[str, Any]:
    """Every dataset of a frame by its name and the kind of its file."""
    apart = ("/frames/quality/", EVENTS_GROUP)
    made = {}
    for path in bundle.shapes:
        if path.startswith("/frames/") and not path.startswith(apart):
            kind = "png" if path == "/frames/rgb" else "npy"
            made[f"{path.removeprefix('/frames/').replace('/', '_')}.{kind}"] = bundle.frame(path, k)
    return made
