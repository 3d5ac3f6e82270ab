"""Camera images of a key on three sensors, less the untouched image. python examples/camera_image.py [FOLDER]"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import tacgen


def main(
    folder: Path, quality: object = "draft", sensors: tuple[str, ...] = ("gelsight_mini", "digit", "ninedtact")
) -> None:
    figure, axes = plt.subplots(2, len(sensors), figsize=(3 * len(sensors), 6), squeeze=False, layout="constrained")
    for column, name in zip(axes.T, sensors, strict=True):
        press = tacgen.Press(depth_mm=0.5, frames=1)
        frames = tacgen.simulate(name, "key", press, outputs=("rgb",), quality=quality)
        column[0].imshow(frames.image[-1])
        change = frames.image[-1].astype(int) - frames["/reference/rgb"]
        column[1].imshow((change + 128).clip(0, 255).astype("uint8"))
        column[0].set_title(name)
    for panel in axes.flat:
        panel.set_axis_off()
    figure.savefig(folder / "camera_image.png")


if __name__ == "__main__":
    main(Path(*sys.argv[1:]))
