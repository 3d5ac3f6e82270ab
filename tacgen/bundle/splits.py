"""Division of the scenes of a data set into train, val and test: by whole contacts, or whole objects, the same on every
machine."""

import hashlib
from collections.abc import Sequence

from tacgen.base.errors import UserError
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.dataset import contacts

Shares = tuple[float, float, float]  # of train, val and test
SPLITS = ("train", "val", "test")
SPLIT_FRACTIONS = (0.8, 0.1, 0.1)  # shares of the contacts in each


def divide(
    scenes: Sequence[Bundle], split: str, fractions: Shares = SPLIT_FRACTIONS, seed: int = 0, *, by_object: bool = False
) -> tuple[Bundle, ...]:
    """The scenes of one part, in their original order: all are sorted by a hash of inputs and seed, and divided.

    Scenes of the same contact on several sensors, and the fingers of a grasp, stay together; with `by_object` also
    those of indenters that are the same mesh, or of the same shape, of whatever size.

    Raises:
        UserError: an unknown part, fractions that do not add up to 1, or no scene in the part.
    """
    if split == "all":
        return tuple(scenes)
    if split not in SPLITS:
        raise UserError(f"split {split!r}: must be all, {', '.join(SPLITS)}")
    chosen = [i for i, part in enumerate(assigned(scenes, fractions, seed, by_object=by_object)) if part == split]
    if not chosen:
        many = f", which are of {len(_together(scenes, by_object))} objects" if by_object else ""
        raise UserError(f"split {split!r}: holds none of {len(scenes)} scenes{many}")
    return tuple(scenes[i] for i in chosen)


def empty_parts(scenes: Sequence[Bundle]) -> list[str]:
    """A line on the parts that hold no scene, whose scores would be nan; none where every part holds some."""
    there = assigned(scenes)
    missing = [part for part in SPLITS if part not in there]
    text = f"no scene for the split {' and '.join(missing)}, of {len(scenes)}: make more before scores are compared"
    return [text] if missing else []


def assigned(
    scenes: Sequence[Bundle], fractions: Shares = SPLIT_FRACTIONS, seed: int = 0, *, by_object: bool = False
) -> list[str]:
    """The part of each scene, as `divide` chooses it: train, val or test. If there are few, a part may have none.

    Raises:
        UserError: fractions that do not add up to 1.
    """
    if min(fractions) < 0 or abs(sum(fractions) - 1) > 1e-6:
        raise UserError(f"fractions {fractions}: must be at least 0 and add up to 1")
    groups = _together(scenes, by_object)
    order = sorted(groups, key=lambda name: hashlib.sha256(f"{seed} {name}".encode()).hexdigest())
    ends = [round(len(order) * sum(fractions[: k + 1])) for k in range(3)]
    parts = [""] * len(scenes)
    for k, name in enumerate(order):
        for i in groups[name]:
            parts[i] = SPLITS[sum(k >= end for end in ends[:2])]
    return parts


def _together(scenes: Sequence[Bundle], by_object: bool) -> dict[str, list[int]]:
    """Indices of the scenes that stay together, by the inputs of the first of them or the name of their object."""
    if not by_object:
        return {f"{scenes[i].attrs['input_key']} {i}": [i, *more] for i, *more in contacts(scenes)}
    objects: dict[str, list[int]] = {}
    for i, scene in enumerate(scenes):
        indenter = scene.recipe["indenter"]
        objects.setdefault(indenter.get("sha256", indenter["shape"]), []).append(i)
    return objects
