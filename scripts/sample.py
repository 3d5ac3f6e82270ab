"""The sample data set as it is published: recipes/sample.yaml with small pictures, packed with card, splits and scores.

    make sample WORKERS=2                                  # the same command goes on with a run that was stopped
    python scripts/sample.py -o out/sample --workers 2 --set vary.samples=9    # a part of it

In `out/sample`: `sample.yaml` and `sensors` (the recipe, and its sensors with pictures of about 96 x 72 pixels,
which the maps share), `data` (the bundles), and `published`: README.md (a page for a data hub), shard-*.h5 and
index.json (as `tacgen pack` writes them), splits.json (the scenes of each split) and baseline.json (the scores).
Nine contacts, 216 frames, took 270 s on two cores and has 35 MB: 2.0 s of a core and 0.16 MB a frame.

The baseline is linear: ridge regression from the image less the untouched one, in 12 x 16 cells, to the force and to
the contact's mode (one number for each, of which the largest counts). It is trained for each sensor on `train`, its
penalty is chosen on `val`, and it is judged on `test`. `guess` is the mean, or the most frequent mode, of `train`. For
networks see examples/baselines.py.
"""

import argparse
import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacgen.base.errors import UserError
from tacgen.bundle import dataset
from tacgen.bundle.bundle import Bundle
from tacgen.bundle.pack import pack
from tacgen.bundle.splits import SPLITS, assigned
from tacgen.export.feats import shares
from tacgen.outputs.contact_modes import CONTACT_MODES
from tacgen.recipe import assets, loading
from tacgen.report import dataset_summary, hub_card
from tacgen.sensor.yaml_source import dumped, edited
from tacgen.torch import TactileDataset

LICENCE = "cc-by-4.0"
COARSER = {"gelsight_mini": 10 / 3, "digit": 10 / 3, "ninedtact": 5.0}  # pixels of a sensor's picture in one of ours
CELLS = (12, 16)  # of the image, about square in each sensor
PENALTIES = 10.0 ** np.arange(-4, 4)  # of the ridge, per frame
Frames = dict[str, np.ndarray]  # cells (n, 576), force (n, 3) [N], mode (n,)


def small_recipe(out: Path) -> Path:
    """Write the recipe with sensors of smaller pictures of the same view into a folder, and return its file.

    It names the sensors by paths relative to itself: the bundles, which hold the recipe, are the same in every folder.
    """
    (out / "sensors").mkdir(parents=True, exist_ok=True)
    for name, factor in COARSER.items():
        shipped = assets.sensor_path(name)
        eye = loading.read_sensor(shipped)[0].camera
        size = {"width_px": round(eye.width_px / factor), "height_px": round(eye.height_px / factor)}
        values = {("camera", key): value for key, value in {**size, "mm_per_px": eye.mm_per_px * factor}.items()}
        (out / "sensors" / f"{name}.yaml").write_text(edited(shipped, values), encoding="utf-8")
    changes = {"extends": "sample", "sensors": [f"sensors/{name}.yaml" for name in COARSER]}
    (out / "sample.yaml").write_text(dumped(changes), encoding="utf-8")
    return out / "sample.yaml"


def run(out: Path, workers: int, changes: Sequence[str]) -> None:
    """Make the bundles in `out/data`. Raises SystemExit: the run failed, other than in single scenes."""
    recipe, settings = small_recipe(out), [word for change in changes for word in ("--set", change)]
    command = [sys.executable, "-m", "tacgen", "run", str(recipe), "-o", str(out / "data"), "--workers", str(workers)]
    if (code := subprocess.run([*command, *settings]).returncode) not in (0, 1):  # 1: some scenes were rejected
        raise SystemExit(code)


def frames(data: Path, split: str) -> dict[str, Frames]:
    """The frames of a split by sensor."""
    items: dict[str, list[tuple[np.ndarray, ...]]] = {}
    part = TactileDataset(data, ("rgb", "force", "events/mode"), split=split, subtract_reference=True)
    for k in range(len(part)):
        item = part[k]
        image = item["rgb"] / 255.0
        grid = CELLS if image.shape[0] <= image.shape[1] else CELLS[::-1]  # more along the longer side
        rows, columns = (shares(n, cells) / (n / cells) for n, cells in zip(image.shape, grid, strict=False))
        cells = np.einsum("ri,ijx,cj->rcx", rows, image, columns, optimize=True).astype(np.float32).ravel()
        sensor = part.scenes[item["scene"]].attrs["sensor"]
        items.setdefault(sensor, []).append((cells, item["force"], item["events/mode"]))
    names = ("cells", "force", "mode")
    return {
        sensor: dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True)) for sensor, rows in items.items()
    }


def targets(part: Frames) -> np.ndarray:
    """Force and the modes as ones and zeros (n, 3 + modes)."""
    return np.hstack([part["force"], np.eye(len(CONTACT_MODES))[part["mode"]]])


def fitted(part: Frames, penalty: float) -> np.ndarray:
    """Weights (cells + 1, 3 + modes) of the ridge; the constant is not penalised."""
    wide = np.column_stack([part["cells"], np.ones(len(part["cells"]))]).astype(float)
    ridge = penalty * len(wide) * np.diag([*np.ones(wide.shape[1] - 1), 0.0])
    return np.linalg.solve(wide.T @ wide + ridge, wide.T @ targets(part))


def said(weights: np.ndarray, part: Frames) -> np.ndarray:
    return part["cells"] @ weights[:-1] + weights[-1]


def errors(values: np.ndarray, part: Frames) -> dict[str, float]:
    """Root mean square of each force component [N], and the share of modes that are right."""
    off = np.sqrt(np.mean((values[:, :3] - part["force"]) ** 2, axis=0))
    right = np.mean(values[:, 3:].argmax(1) == part["mode"])
    return {f"force {axis} [N]": float(e) for axis, e in zip("xyz", off, strict=True)} | {"mode, right": float(right)}


def baseline(data: Path) -> dict[str, dict[str, dict[str, float]]]:
    """Scores by sensor of the linear baseline and of a guess. Raises UserError: a split without scenes."""
    train, val, test = (frames(data, split) for split in SPLITS)
    scores = {}
    if missing := [sensor for sensor in train if sensor not in val or sensor not in test]:
        raise UserError(f"{data}: no scene of {' and '.join(missing)} in val or test: make more scenes")
    for sensor, known in train.items():
        off = {float(p): np.mean((said(fitted(known, p), val[sensor]) - targets(val[sensor])) ** 2) for p in PENALTIES}
        weights = fitted(known, min(off, key=lambda p: off[p]))
        guess = np.broadcast_to(targets(known).mean(0), (len(test[sensor]["force"]), 3 + len(CONTACT_MODES)))
        scores[sensor] = {
            "linear": errors(said(weights, test[sensor]), test[sensor]),
            "guess": errors(guess, test[sensor]),
        }
    return scores


def table(scores: dict[str, dict[str, dict[str, float]]]) -> str:
    """The scores in Markdown."""
    names = [*next(iter(scores.values()))["linear"]]
    lines = ["| sensor | method | " + " | ".join(names) + " |", "|---" * (len(names) + 2) + "|"]
    for sensor, methods in scores.items():
        for method, found in methods.items():
            lines.append(f"| {sensor} | {method} | " + " | ".join(f"{found[name]:.3f}" for name in names) + " |")
    return "\n".join(lines)


def listed(bundles: Sequence[Bundle]) -> dict[str, list[str]]:
    """Split -> the names of its scenes in index.json."""
    parts = assigned(bundles)
    return {name: [b.group[1:] for b, part in zip(bundles, parts, strict=True) if part == name] for name in SPLITS}


def publish(data: Path, out: Path) -> str:
    """Write the folder `out` from the bundles of `data`, and return the table of scores."""
    scores = baseline(data)
    if out.exists():
        shutil.rmtree(out)
    pack(dataset.scenes(data), out)
    bundles = dataset.scenes(out)
    for name, content in (("splits", listed(bundles)), ("baseline", scores)):
        (out / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    about = "Linear regression from the image in 12 x 16 cells; errors on `test` (`scripts/sample.py` of tacgen)."
    more = f"## Baseline\n\n{about} `guess` ignores the image.\n\n{table(scores)}"
    page = hub_card.text("pack", "make sample", bundles, out, dataset_summary.look(data), LICENCE, more)
    (out / "README.md").write_text(page, encoding="utf-8")
    return table(scores)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/sample"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--set", action="append", default=[], metavar="PATH=VALUE", help="override a value of the recipe"
    )
    args = parser.parse_args()
    published = args.out / "published"
    run(args.out, args.workers, args.set)
    try:
        print(publish(args.out / "data", published))
    except UserError as error:
        raise SystemExit(str(error)) from None
    size = sum(path.stat().st_size for path in published.rglob("*") if path.is_file())
    print(f"{published}: {size / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
