"""A baseline to beat: force, contact mode, face and shape from one small picture, learned from the recipe `baseline`.

    tacgen run baseline -o out/baseline --workers 2
    python examples/baselines.py out/baseline -o out/baselines --workers 2

or forces up to 45 N on gels and lights that differ from scene to scene, from the recipe `baseline_force`.

A convolutional network of 0.25 million weights sees a frame's image less the untouched one, and where each pixel is.
It says

    force   on the gel, three components [N]
    mode    of the contact: apart, touching, sticking, partly slipping, sliding, turning, releasing
    face    behind each pixel: change of z [mm] and the unit normal
    shape   of the indenter: sphere, cylinder, box, capsule, torus

and is trained for all four at once, from scratch, for a fixed number of epochs. In two tests no scene is both learned
from and judged by: `scenes` holds back a fifth of the scenes, drawn three times; `indenter` holds back all scenes of
one indenter, each of the ten in turn. `guess` is the mean, or the most frequent, of what was learned from.

Errors of the normal force are also printed by its range, with the force from which predictions no longer grow: beyond
what was learned from, and where the picture no longer changes, no network can be right.

In the folder: `results.json`, `table.md`, `force_ranges.md`, and of the first draw the weights `network.pt` and the
plot `test.png`.
"""

import argparse
import json
import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from torch import nn
from torch.nn import functional as F

from tacgen.bundle.bundle import Bundle
from tacgen.bundle.splits import divide
from tacgen.outputs.contact_modes import CONTACT_MODES
from tacgen.report import force_ranges
from tacgen.torch import TactileDataset

FIELDS = ("rgb", "force", "events/mode", "height", "normals")
BATCH, RATE = 32, 2e-3
SHIFT = 3  # [px] up to which pictures are shifted in training: shapes are told better by it, shear force a little worse
COUNTS, LENGTH = 32.0, 0.2  # [counts], [mm]: about 1 at the network's ends
MOVED = 0.02  # [mm]: the face's errors are taken where it moved by more
DPI = 110  # of the plot
Frames = dict[str, torch.Tensor]


class Network(nn.Module):
    """Image (n, 5, h, w) -> what FIELDS name, scaled to about 1; h and w are multiples of 8."""

    def __init__(self, shapes: int) -> None:
        super().__init__()
        self.down = nn.ModuleList(nn.Conv2d(a, b, 3, 2, 1) for a, b in ((5, 16), (16, 32), (32, 64)))
        self.up = nn.ModuleList(nn.Conv2d(a, b, 3, 1, 1) for a, b in ((64 + 32, 16), (16 + 16, 8), (8, 3)))
        self.flat = nn.Sequential(nn.Flatten(), nn.Dropout(0.3), nn.LazyLinear(64))
        self.all = nn.Sequential(nn.Linear(3 * 64, 96), nn.ReLU(), nn.Dropout(0.2))
        self.heads = nn.ModuleDict({"force": nn.Linear(96, 3), "mode": nn.Linear(96, len(CONTACT_MODES))})
        self.heads["shape"] = nn.Linear(96, shapes)

    def forward(self, image: torch.Tensor) -> Frames:
        seen = [image]
        for layer in self.down:
            seen.append(F.relu(layer(seen[-1])))
        x = seen[-1]
        together = self.all(torch.cat([x.mean((2, 3)), x.amax((2, 3)), self.flat(x)], 1))
        for layer, beside in zip(self.up, (seen[2], seen[1], None), strict=True):
            x = F.interpolate(x, scale_factor=2.0)
            x = layer(x if beside is None else torch.cat([x, beside], 1))
            x = x if beside is None else F.relu(x)
        return {"face": x} | {name: head(together) for name, head in self.heads.items()}


def loss(said: Frames, true: Frames, spread: torch.Tensor) -> torch.Tensor:
    """The sum of the four tasks', each about 1 at the start."""
    shaped = true["mode"] > 0  # there is no shape to be seen in the air
    wrong = F.mse_loss(said["force"], true["force"] / spread) + F.cross_entropy(said["mode"], true["mode"])
    wrong = wrong + 10 * F.mse_loss(said["face"], true["face"])
    told = F.cross_entropy(said["shape"][shaped], true["shape"][shaped], reduction="sum")
    return wrong + told / shaped.sum().clamp(min=1)


def trained(frames: Frames, shapes: int, seed: int, epochs: int) -> tuple[Network, torch.Tensor]:
    """A network, and the spread (3,) of the forces [N] that scales its own."""
    torch.manual_seed(seed)
    network, spread = Network(shapes), frames["force"].std(0)
    network(frames["image"][:1])  # sizes
    optimiser = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=1e-3)
    count = len(frames["image"])
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, RATE, total_steps=epochs * -(-count // BATCH))
    for _ in range(epochs):
        for some in torch.randperm(count).split(BATCH):
            batch = {name: values[some] for name, values in frames.items()}
            moved = torch.randint(-SHIFT, SHIFT + 1, (2,)).tolist()  # pixels: nothing is at a picture's rim
            batch["image"][:, :3] = batch["image"][:, :3].roll(moved, (2, 3))
            batch["face"] = batch["face"].roll(moved, (2, 3))
            optimiser.zero_grad()
            loss(network(batch["image"]), batch, spread).backward()
            optimiser.step()
            schedule.step()
    return network.eval(), spread


@torch.no_grad()
def predicted(network: Network, spread: torch.Tensor, frames: Frames) -> Frames:
    """For the frames, in the units of their labels; modes and shapes as numbers."""
    parts = [network(image) for image in frames["image"].split(64)]
    said = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
    return said | {"force": said["force"] * spread} | {name: said[name].argmax(1) for name in ("mode", "shape")}


def guessed(known: Frames, frames: Frames) -> Frames:
    """By one who does not look: the mean, or the most frequent, of the frames known."""
    count = len(frames["image"])
    said = {name: known[name].mean(0).expand(count, *known[name].shape[1:]) for name in ("force", "face")}
    return said | {name: known[name].mode().values.expand(count) for name in ("mode", "shape")}


def scores(said: Frames, true: Frames) -> dict[str, float]:
    """Errors and hit rates; those of the face where it moved, of the shape where the gel is touched."""
    off = (said["force"] - true["force"]).square().mean(0).sqrt()
    moved, touched = true["face"][:, 0].abs() * LENGTH > MOVED, true["mode"] > 0
    a, b = (unit(frames["face"].movedim(1, -1)[moved]) for frames in (said, true))
    hit = (said["mode"] == true["mode"]).float()
    by_mode = [hit[true["mode"] == k].mean() for k in true["mode"].unique()]
    return {
        "force x [N]": float(off[0]),
        "force y [N]": float(off[1]),
        "force z [N]": float(off[2]),
        "mode, right": float(hit.mean()),
        "mode, right, mean over modes": float(np.mean(by_mode)),
        "depth [mm]": LENGTH * float((said["face"] - true["face"])[:, 0][moved].square().mean().sqrt()),
        "normal [deg]": float(torch.rad2deg(torch.acos((a * b).sum(-1).clamp(-1, 1))).mean()),
        "shape, right": float((said["shape"] == true["shape"])[touched].float().mean()),
    }


def unit(face: torch.Tensor) -> torch.Tensor:
    """Normals (..., 3) of faces (..., 3), which hold their sideways parts."""
    sideways = face[..., 1:] / face[..., 1:].norm(dim=-1, keepdim=True).clamp(min=1)
    return torch.cat([sideways, (1 - sideways.square().sum(-1, keepdim=True)).clamp(min=0).sqrt()], -1)


class Data(NamedTuple):
    """All frames, in memory."""

    frames: Frames
    scene: np.ndarray  # (n,) of each frame
    scenes: tuple[Bundle, ...]
    indenters: list[str]  # of each scene
    shapes: list[str]

    def part(self, chosen: np.ndarray) -> Frames:
        """The frames of the scenes chosen (s,) bool."""
        here = torch.from_numpy(chosen[self.scene])
        return {name: values[here] for name, values in self.frames.items()}


def read(folder: Path) -> Data:
    """Every frame of a folder of bundles. Raises UserError: bundles without one of FIELDS."""
    data = TactileDataset(folder, FIELDS, subtract_reference=True)
    items = [data[i] for i in range(len(data))]
    column = {name: torch.from_numpy(np.stack([item[name] for item in items])) for name in FIELDS}
    scene = np.array([item["scene"] for item in items])
    image = column["rgb"].movedim(-1, 1) / COUNTS
    h, w = image.shape[2:]
    place = torch.stack(torch.meshgrid(torch.linspace(-1, 1, h), torch.linspace(-1, 1, w), indexing="ij"))
    indenters = [json.dumps(bundle.recipe["indenter"]) for bundle in data.scenes]
    of_scene = [str(bundle.recipe["indenter"]["shape"]) for bundle in data.scenes]
    shapes = sorted(set(of_scene))
    frames = {
        "image": torch.cat([image, place.expand(len(image), -1, -1, -1)], 1),
        "force": column["force"].float(),
        "mode": column["events/mode"].long(),
        "face": torch.cat([column["height"][:, None] / LENGTH, column["normals"].movedim(-1, 1)[:, :2]], 1).float(),
        "shape": torch.tensor([shapes.index(of_scene[k]) for k in scene]),
    }
    return Data(frames, scene, data.scenes, indenters, shapes)


class Fold(NamedTuple):
    """A network to be trained: on all scenes but those held back."""

    test: str  # a column of the table
    seed: int
    held_back: np.ndarray  # (s,) bool


def folds(data: Data, seeds: int) -> list[Fold]:
    """All of both tests."""
    found = []
    for seed in range(seeds):
        test = {bundle.path for bundle in divide(data.scenes, "test", (0.8, 0.0, 0.2), seed)}
        found.append(Fold("scenes", seed, np.array([bundle.path in test for bundle in data.scenes])))
    names = np.array(data.indenters)
    return found + [Fold("indenter", 0, names == name) for name in sorted(set(names))]


def judged(folder: Path, fold: Fold, epochs: int, out: Path | None) -> dict[str, dict[str, Any]]:
    """The scores of a network and of a guess, and its seconds of processor; weights and plot into `out`. `normal` has
    the normal forces [N]: true, predicted and learned from."""
    torch.set_num_threads(1)
    data = read(folder)
    known, true, start = data.part(~fold.held_back), data.part(fold.held_back), time.process_time()
    network, spread = trained(known, len(data.shapes), fold.seed, epochs)
    said = predicted(network, spread, true)
    spent = time.process_time() - start
    if out:
        scales = {"shapes": data.shapes, "counts": COUNTS, "length_mm": LENGTH}
        torch.save({"weights": network.state_dict(), "spread": spread, **scales}, out / "network.pt")
        plot(said, true, data.shapes, out / "test.png")
    every = {"true": true, "said": said, "learned": known}
    normal = {name: (-frames["force"][:, 2]).tolist() for name, frames in every.items()}
    score = {"network": scores(said, true), "guess": scores(guessed(known, true), true)}
    return score | {"cost": {"processor_s": spent}, "normal": normal}


def by_range(found: list[dict[str, Any]]) -> str:
    """Errors of the normal force by its range, each test's networks together."""
    lines = []
    for test in dict.fromkeys(one["test"] for one in found):
        normal = [one["normal"] for one in found if one["test"] == test]
        parts = [np.concatenate([one[name] for one in normal]) for name in ("true", "said", "learned")]
        lines += [f"{test}: normal force by range", *force_ranges.lines(*parts), ""]
    return "\n".join(lines)


def table(tests: list[str], found: list[dict[str, Any]]) -> str:
    """Mean and standard deviation of each score over the networks of each test."""
    columns = [(test, who) for test in dict.fromkeys(tests) for who in ("network", "guess")]
    lines = ["| | " + " | ".join(f"{test}: {who}" for test, who in columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for score in found[0]["network"]:
        cells = []
        for test, who in columns:
            runs = np.array([one[who][score] for of, one in zip(tests, found, strict=True) if of == test])
            cells.append(f"{runs.mean():.3f} ± {runs.std(ddof=min(1, len(runs) - 1)):.3f}")
        lines.append(f"| {score} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def plot(said: Frames, true: Frames, shapes: list[str], out: Path) -> None:
    """Predicted over true force, who takes which mode and shape for which, and one face."""
    with rc_context({"font.size": 8, "axes.titlesize": 9}):
        sheet = Figure(figsize=(8.6, 6), layout="constrained")
        grid = sheet.add_gridspec(4, 3)
        places = [*(grid[:2, k] for k in range(3)), grid[2:, 0], grid[2:, 1], grid[2, 2], grid[3, 2]]
        draw(sheet, [sheet.add_subplot(place) for place in places], said, true, shapes)
        sheet.savefig(out, dpi=DPI)


def draw(sheet: Figure, panels: list[Axes], said: Frames, true: Frames, shapes: list[str]) -> None:
    """The seven panels of the plot."""
    for k, name in enumerate("xyz"):
        panels[k].plot(true["force"][:, k], said["force"][:, k], ".", color="#0072b2", markersize=3)
        panels[k].axline((0, 0), slope=1, color="#808080", linewidth=0.8)
        panels[k].set(title=f"$F_{name}$", xlabel="true [N]", ylabel="predicted [N]")
    for panel, name, words in ((panels[3], "mode", CONTACT_MODES), (panels[4], "shape", shapes)):
        here = true["mode"] > 0 if name == "shape" else slice(None)
        count = np.zeros((len(words), len(words)))
        np.add.at(count, (true[name][here].numpy(), said[name][here].numpy()), 1)
        share = count / np.maximum(count.sum(1, keepdims=True), 1)
        panel.imshow(share, cmap="viridis", vmin=0, vmax=1)
        for row, column in np.argwhere(share >= 0.005):
            colour = "black" if share[row, column] > 0.6 else "white"
            panel.text(column, row, f"{share[row, column]:.2f}", ha="center", va="center", fontsize=6, color=colour)
        panel.set_xticks(range(len(words)), words, rotation=60, ha="right")
        panel.set_yticks(range(len(words)), words)
        panel.set(title=f"{name}: share of the true", xlabel="predicted", ylabel="true")
    deepest = int(true["face"][:, 0].amin((1, 2)).argmin())
    low = LENGTH * float(true["face"][deepest, 0].min())
    for panel, name, frames in ((panels[5], "true", true), (panels[6], "predicted", said)):
        drawn = panel.imshow(LENGTH * frames["face"][deepest, 0], cmap="cividis", vmin=low, vmax=0.1)
        panel.set(title=f"face: {name}", xticks=[], yticks=[])
    sheet.colorbar(drawn, ax=panels[5:7], label="change of z [mm]")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="a folder of bundles of recipes/baseline.yaml")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/baselines"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--epochs", type=int, default=30)
    parser.add_argument("--workers", type=int, default=2, help="networks trained at a time, a core each")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    data = read(args.data)
    print(f"{len(data.scenes)} scenes, {len(data.scene)} frames", flush=True)
    todo, found = folds(data, args.seeds), []
    with ProcessPoolExecutor(args.workers, multiprocessing.get_context("spawn")) as pool:
        made = [
            pool.submit(judged, args.data, fold, args.epochs, None if k else args.out) for k, fold in enumerate(todo)
        ]
        for fold, one in zip(todo, (future.result() for future in made), strict=True):
            print(f"{fold.test}, {fold.held_back.sum()} scenes held back: {one['network']}", flush=True)
            found.append({"test": fold.test, "held_back": np.flatnonzero(fold.held_back).tolist()} | one)
            (args.out / "results.json").write_text(json.dumps(found, indent=1))
    shown = table([fold.test for fold in todo], found)
    (args.out / "table.md").write_text(shown + "\n", encoding="utf-8")
    (args.out / "force_ranges.md").write_text(by_range(found), encoding="utf-8")
    print(shown, by_range(found), sep="\n\n")


if __name__ == "__main__":
    main()
