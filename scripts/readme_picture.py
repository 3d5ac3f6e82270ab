"""Draw the looping picture of the README, a press, slide and twist on four sensors: eight minutes on one core.

python scripts/readme_picture.py docs/loop.webp
"""

import sys
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

import tacgen

CONTACTS = {  # sensor: indenter
    "gelsight_mini": tacgen.Sphere(radius_mm=4),
    "gelsight_wedge": tacgen.Torus(radius_mm=3.5, tube_radius_mm=1),
    "digit": "hex_bolt",
    "ninedtact": "letters",
}
STEPS = {
    "press": tacgen.Press(depth_mm=0.8, frames=6),
    "slide": tacgen.Slide(x_mm=1.2, y_mm=0.4, frames=8),
    "twist": tacgen.Twist(angle_deg=20, frames=8),
}
HEIGHT, GAP, TITLE = 220, 8, 20  # of a picture, between two, and of a line of text [px]
FRAME_MS, LAST_MS, QUALITY = 90, 360, 80  # a frame's time, and a movement's last one's [ms]; of WebP [%]


def main(out: Path) -> None:
    """Write the animated picture."""
    font, frames, times = ImageFont.load_default(14), [], []
    made = {
        sensor: tacgen.simulate(sensor, thing, list(STEPS.values()), friction=0.5, outputs=["rgb"]).rgb
        for sensor, thing in CONTACTS.items()
    }
    for name, step in STEPS.items():
        times += [FRAME_MS] * (step.frames - 1) + [LAST_MS]
        for _ in range(step.frames):
            panels = [Image.fromarray(pictures[len(frames)]) for pictures in made.values()]
            panels = [panel.resize((round(HEIGHT * panel.width / panel.height), HEIGHT)) for panel in panels]
            wide = sum(panel.width + GAP for panel in panels) + GAP
            sheet, x = Image.new("RGB", (wide, HEIGHT + 2 * TITLE + GAP), "white"), GAP
            write = ImageDraw.Draw(sheet)
            for sensor, panel in zip(made, panels, strict=True):
                write.text((x, 2), sensor, "black", font)
                sheet.paste(panel, (x, TITLE))
                x += panel.width + GAP
            write.text((wide / 2, HEIGHT + TITLE + 3), name, "black", font, anchor="ma")
            frames.append(sheet)
    frames[0].save(out, save_all=True, append_images=frames[1:], duration=times, loop=0, quality=QUALITY, kmax=1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
