"""Newtons from pictures of one real unit, by networks that have seen rendered presses, a few real ones, or both.

    tacgen calibrate unit --sensor start.yaml --images few -o unit.yaml
    tacgen run unit_forces -o out/unit --set sensor=unit.yaml
    python examples/force_transfer.py out/unit --few few --judge others -o out/transfer

`few` and `others` are folders of photographs as `calibrate unit` takes them: presses.csv with the columns file and
force_n and, if there is no background.png, `untouched`. What is pressed need not be known. The network sees a picture
less the untouched one at 40 x 32 pixels, and says the normal force. Each picture keeps its contrast, which tells the
force. One factor for all photographs, with which the first network suits the few best, takes them to the contrast of
rendered pictures. Mean absolute errors on `others`:

    mean of the few            the floor: the mean force of the few pictures, whatever is seen
    rendered alone             no real picture was learned from
    rendered, one contrast     the same network, with the factor found from the few
    the few alone              from scratch
    rendered, then the few     the first network goes on with the few pictures, with that factor
    others, each left out      the ceiling: learned from all other pictures of `others`

Given `time_s` and `recording`, errors are also printed without the gauge's lag: each recording's predictions are
shifted in time as suits its forces best. In the folder: `results.json`, `table.md` and the plot `forces.png`.
"""

import argparse
import csv
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from matplotlib.figure import Figure
from PIL import Image
from torch import nn
from torch.nn import functional as F

import tacgen
from tacgen.torch import TactileDataset

Array = np.ndarray
HEIGHT, WIDTH = 32, 40  # [px] of the network's pictures
COUNTS = 10.0  # [counts]: about 1 at the network's start
BATCH, SHIFT = 32, 3  # SHIFT [px]: up to which pictures are moved in training
GAIN, NOISE = 0.05, 0.05  # standard deviations of each colour's factor and of each pixel in training [-]
CONTRASTS = np.geomspace(0.5, 2.0, 41)  # tried for all photographs [-]
STEPS, FEW_STEPS = 1500, 400  # with rendered presses, and with a few photographs
RATE, GENTLE = 2e-3, 5e-4  # from scratch, and of a network that goes on with a few pictures
FORCE = 10.0  # [N]: about 1 at the network's end
LAGS = np.linspace(-0.15, 0.15, 61)  # [s]


class Presses(NamedTuple):
    """Pictures (n, 3, h, w) over COUNTS with the normal forces (n,) [N]; photographs also have the name (n,) of their
    recording and the time (n,) [s], nan if it is not given."""

    picture: torch.Tensor
    force: torch.Tensor
    recording: Array | None = None
    time: Array | None = None

    def only(self, chosen: Array) -> "Presses":
        """The presses chosen (n,) bool."""
        return Presses(self.picture[torch.from_numpy(chosen)], self.force[torch.from_numpy(chosen)])

    def times(self, contrast: float) -> "Presses":
        """The same with all pictures times a factor."""
        return self._replace(picture=contrast * self.picture)


def seen(change: torch.Tensor) -> torch.Tensor:
    """Changes (n, 3, H, W) [counts] against the untouched picture, as the network sees them (n, 3, h, w)."""
    return F.interpolate(change.float(), (HEIGHT, WIDTH), mode="area") / COUNTS


def rendered(folder: Path) -> Presses:
    """All frames of a folder of bundles."""
    data = TactileDataset(folder, ("rgb", "force"), subtract_reference=True)
    pictures, forces = [], []
    for item in map(data.__getitem__, range(len(data))):
        pictures.append(seen(torch.from_numpy(item["rgb"]).movedim(-1, 0)[None]))
        forces.append(-float(item["force"][2]))
    return Presses(torch.cat(pictures), torch.tensor(forces))


def number(text: str | None) -> float:
    """A cell as a number; nan if it is none."""
    try:
        return float(text or "nan")
    except ValueError:
        return float("nan")


def photographed(folder: Path) -> Presses:
    """The photographs of a folder. Raises tacgen.UserError: a table or a picture that cannot be read."""
    try:
        with (folder / "presses.csv").open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise tacgen.UserError(f"{folder / 'presses.csv'}: cannot be read as a table: {error}") from None
    if not rows or not {"file", "force_n"} <= rows[0].keys():
        raise tacgen.UserError(f"{folder / 'presses.csv'}: needs the columns file and force_n, and a press")

    def pixels(name: str) -> torch.Tensor:
        try:
            with Image.open(folder / name) as picture:
                return torch.from_numpy(np.asarray(picture.convert("RGB"), np.float32)).movedim(-1, 0)
        except OSError as error:
            raise tacgen.UserError(f"{folder / name}: cannot be read as a picture: {error}") from None

    changes = [pixels(row["file"]) - pixels(row.get("untouched") or "background.png") for row in rows]
    force, time = (np.array([number(row.get(key)) for row in rows]) for key in ("force_n", "time_s"))
    if not np.isfinite(force).all():
        raise tacgen.UserError(f"{folder / 'presses.csv'}: force_n: must be numbers")
    recording = np.array([row.get("recording", "") for row in rows])
    return Presses(seen(torch.stack(changes)), torch.from_numpy(force).float(), recording, time)


def network() -> nn.Sequential:
    """Pictures (n, 3, h, w) -> normal forces (n, 1) over FORCE."""
    parts: list[nn.Module] = []
    for a, b in ((3, 16), (16, 32), (32, 48), (48, 64)):
        parts += [nn.Conv2d(a, b, 3, 2, 1), nn.ReLU()]
    size = 64 * -(-HEIGHT // 16) * -(-WIDTH // 16)
    return nn.Sequential(*parts, nn.Flatten(), nn.Dropout(0.2), nn.Linear(size, 64), nn.ReLU(), nn.Linear(64, 1))


def learned(known: Presses, seed: int, steps: int, start: nn.Module | None = None) -> nn.Module:
    """A network from scratch, or `start` going on more gently with the presses known."""
    torch.manual_seed(seed)
    net, rate = network(), RATE if start is None else GENTLE
    if start is not None:
        net.load_state_dict(start.state_dict())
    optimiser = torch.optim.AdamW(net.parameters(), lr=rate, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, rate, total_steps=steps)
    for _ in range(steps):
        some = torch.randint(len(known.force), (BATCH,))
        moved = torch.randint(-SHIFT, SHIFT + 1, (2,)).tolist()
        picture = known.picture[some].roll(moved, (2, 3))  # nothing is at a picture's rim
        picture = picture * (GAIN * torch.randn(BATCH, 3, 1, 1)).exp() + NOISE * torch.randn_like(picture)
        optimiser.zero_grad()
        F.smooth_l1_loss(net(picture)[:, 0], known.force[some] / FORCE, beta=0.1).backward()
        optimiser.step()
        schedule.step()
    return net.eval()


@torch.no_grad()
def predicted(net: nn.Module, presses: Presses) -> Array:
    """Normal forces (n,) [N]."""
    return np.asarray(FORCE * net(presses.picture)[:, 0]).clip(0)


def contrast(net: nn.Module, few: Presses) -> float:
    """The factor on all pictures for which the network's forces suit those of the few best."""
    errors = [np.abs(predicted(net, few.times(k)) - few.force.numpy()).mean() for k in CONTRASTS]
    return float(CONTRASTS[int(np.argmin(errors))])


def left_out(presses: Presses, seed: int) -> Array:
    """Forces (n,) [N], each by a network that has learned from all other pictures."""
    every = np.arange(len(presses.force))
    return np.array(
        [predicted(learned(presses.only(every != k), seed, FEW_STEPS), presses.only(every == k))[0] for k in every]
    )


def without_lag(said: Array, presses: Presses) -> Array:
    """Predictions (n,) [N] shifted in time, each recording's by the gauge's lag for which they suit its forces best."""
    out, true = said.copy(), presses.force.numpy()
    assert presses.recording is not None
    assert presses.time is not None
    for name in set(presses.recording[np.isfinite(presses.time)]):
        here = np.flatnonzero(presses.recording == name)
        here = here[np.argsort(presses.time[here])]
        time = presses.time[here]
        shifted = [np.interp(time - lag, time, said[here]) for lag in LAGS]
        out[here] = min(shifted, key=lambda one: float(np.abs(one - true[here]).mean()))
    return out


def judged(train: Presses, few: Presses, others: Presses, seed: int) -> Iterator[tuple[str, Array]]:
    """Each way of knowing, and the forces (n,) [N] that it says of `others`."""
    yield "mean of the few", np.full(len(others.force), float(few.force.mean()))
    first = learned(train, seed, STEPS)
    yield "rendered alone", predicted(first, others)
    k = contrast(first, few)
    yield "rendered, one contrast", predicted(first, others.times(k))
    yield "the few alone", predicted(learned(few, seed, FEW_STEPS), others)
    yield "rendered, then the few", predicted(learned(few.times(k), seed, FEW_STEPS, first), others.times(k))
    if seed == 0:  # as many networks as pictures
        yield "others, each left out", left_out(others, seed)


def scores(said: Array, others: Presses) -> dict[str, Any]:
    """Mean absolute errors as recorded and without the gauge's lag, mean error, all [N]; correlation; forces said."""
    true = others.force.numpy()
    timely = without_lag(said, others)
    return {
        "mae_n": float(np.abs(said - true).mean()), "mae_without_lag_n": float(np.abs(timely - true).mean()),
        "bias_n": float((said - true).mean()), "r": float(np.corrcoef(said, true)[0, 1]) if said.std() > 0 else None,
        "said_n": said.tolist(),
    }  # fmt: skip


def table(found: dict[str, list[dict[str, Any]]]) -> str:
    """Means over the seeds, with the standard deviation of the error, as Markdown."""
    lines = ["| learned from | error [N] | without the gauge's lag [N] | mean error [N] | r |", "|---|---|---|---|---|"]
    for name, runs in found.items():
        mae, timely, bias = (np.array([one[key] for one in runs]) for key in ("mae_n", "mae_without_lag_n", "bias_n"))
        r = [one["r"] for one in runs if one["r"] is not None]
        lines.append(f"| {name} | {mae.mean():.2f} ± {mae.std():.2f} | {timely.mean():.2f} ± {timely.std():.2f} |"
                     f" {bias.mean():+.2f} | {f'{np.mean(r):.2f}' if r else ''} |")  # fmt: skip
    return "\n".join(lines) + "\n"


def plot(found: dict[str, list[dict[str, Any]]], others: Presses, out: Path) -> None:
    """Forces said, of the first seed, over measured ones."""
    sheet = Figure(figsize=(2.4 * len(found), 2.6), layout="constrained")
    axes = sheet.subplots(1, len(found), sharex=True, sharey=True)
    for panel, (name, runs) in zip(axes, found.items(), strict=True):
        panel.plot(others.force, runs[0]["said_n"], ".", color="#0072b2")
        panel.axline((0, 0), slope=1, color="#808080", linewidth=0.8)
        panel.set_title(f"{name}\n{runs[0]['mae_n']:.2f} N", fontsize=8)
        panel.set_xlabel("measured [N]")
    axes[0].set_ylabel("predicted [N]")
    sheet.savefig(out, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="a folder of bundles rendered with the unit's sensor file")
    parser.add_argument("--few", type=Path, required=True, help="a folder of photographs to learn from")
    parser.add_argument("--judge", type=Path, required=True, help="a folder of photographs of the same unit")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/force_transfer"))
    parser.add_argument("--largest", type=float, default=35.0, help="rendered frames above are left out [N]")
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    torch.set_num_threads(1)
    train, few, others = rendered(args.data), photographed(args.few), photographed(args.judge)
    train = train.only((train.force <= args.largest).numpy())
    print(f"{len(train.force)} rendered frames, {len(few.force)} and {len(others.force)} photographs", flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, list[dict[str, Any]]] = {}
    for seed in range(args.seeds):
        for name, said in judged(train, few, others, seed):
            found.setdefault(name, []).append(scores(said, others))
        (args.out / "results.json").write_text(json.dumps({"true_n": others.force.tolist()} | found, indent=1))
        (args.out / "table.md").write_text(table(found), encoding="utf-8")
    plot(found, others, args.out / "forces.png")
    print(table(found))


if __name__ == "__main__":
    try:
        main()
    except tacgen.UserError as error:
        print(error, file=sys.stderr)
        raise SystemExit(2) from None
