"""Draw the looping picture of the README: a press, slide and twist on four sensors.

python scripts/readme_picture.py docs/loop.webp      # eight minutes on one core
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import tacgen

SENSORS = ("gelsight_mini", "gelsight_wedge", "digit", "ninedtact")
INDENTERS = (tacgen.Sphere(radius_mm=4), tacgen.Torus(radius_mm=3.5, tube_radius_mm=1), "hex_bolt", "letters")
MOVEMENTS = (("press", 6), ("slide", 8), ("twist", 8))  # with their frames
HEIGHT, GAP, TITLE = 220, 8, 20  # of a picture, between two, and of a line of text [px]
HOLD = 4  # times as long as the others the last frame of a movement is shown
FRAME_MS, QUALITY = 90, 80  # a frame's time [ms]; of WebP [%]


def pictures(sensor: str, indenter: object) -> np.ndarray:
    """The camera's pictures over the frames, uint8 (N, h, w, 3)."""
    steps = [
        tacgen.Press(depth_mm=0.8, frames=MOVEMENTS[0][1]),
        tacgen.Slide(x_mm=1.2, y_mm=0.4, frames=MOVEMENTS[1][1]),
        tacgen.Twist(angle_deg=20, frames=MOVEMENTS[2][1]),
    ]
    return np.asarray(tacgen.simulate(sensor, indenter, steps, friction=0.5, outputs=["rgb"]).rgb)


def sheet(panels: list[Image.Image], movement: str) -> Image.Image:
    """The sensors' pictures side by side, with their names and that of the movement."""
    font = ImageFont.load_default(14)
    wide = sum(panel.width for panel in panels) + GAP * (len(panels) + 1)
    drawn = Image.new("RGB", (wide, HEIGHT + 2 * TITLE + GAP), "white")
    write = ImageDraw.Draw(drawn)
    x = GAP
    for name, panel in zip(SENSORS, panels, strict=True):
        write.text((x, 2), name, "black", font)
        drawn.paste(panel, (x, TITLE))
        x += panel.width + GAP
    write.text((wide / 2, HEIGHT + TITLE + 3), movement, "black", font, anchor="ma")
    return drawn


def main(out: Path) -> None:
    """Write the animated picture."""
    shown = []
    for sensor, indenter in zip(SENSORS, INDENTERS, strict=True):
        made = pictures(sensor, indenter)
        shown.append([_panel(frame) for frame in made])
    names = [name for name, frames in MOVEMENTS for _ in range(frames)]
    last = np.cumsum([frames for _, frames in MOVEMENTS]) - 1
    sheets = [sheet([frames[k] for frames in shown], name) for k, name in enumerate(names)]
    times = [FRAME_MS * (HOLD if k in last else 1) for k in range(len(sheets))]
    sheets[0].save(out, save_all=True, append_images=sheets[1:], duration=times, loop=0, quality=QUALITY, kmax=1)


def _panel(frame: np.ndarray) -> Image.Image:
    image = Image.fromarray(frame)
    return image.resize((round(HEIGHT * image.width / image.height), HEIGHT), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
