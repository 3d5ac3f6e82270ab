"""`tacgen calibrate`: sensor files fitted to measurements of one's own unit."""

from pathlib import Path
from typing import Annotated

import typer

from tacgen.cli_common import AsJson, show_result, writing

calibrations = typer.Typer(
    no_args_is_help=True, help="Fit a sensor file to your own unit: its lights to photographs, its gel to forces."
)
SensorFile = Annotated[str, typer.Option("--sensor", help="The sensor file to start from, by name or path.")]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Write the sensor file here.")]


@calibrations.command()
def optics(
    sensor: SensorFile,
    images: Annotated[
        Path, typer.Option("--images", help="A folder: background.png, and ball presses listed in presses.csv.")
    ],
    out: Out = None,
    tolerance_mm: Annotated[
        float, typer.Option(min=0, help="How far LEDs may be from where the file has them; 0: light alone is fitted.")
    ] = 0.5,
    tolerance_deg: Annotated[float, typer.Option(min=0, max=90, help="How far they may be turned.")] = 5.0,
    no_markers: Annotated[bool, typer.Option("--no-markers", help="The photographed gel has no dots.")] = False,
    steps: Annotated[int, typer.Option(min=1, help="Most rounds of the fit.")] = 10,
    as_json: AsJson = False,
) -> None:
    """Fit a sensor file to photographs of your own unit: light and place of its LEDs, stray light, gloss, crop."""
    from tacgen import calibrate as fitting

    found = fitting.optics(sensor, images, fitting.Asked(tolerance_mm, tolerance_deg, no_markers, steps))
    lines = list(found.lines())
    if out is not None:
        with writing(out):
            found.write(out)
        lines.append(f"{out}: the sensor file of this unit")
    show_result(found.plain(), "\n".join(lines), as_json)


@calibrations.command()
def material(
    sensor: SensorFile,
    recipe: Annotated[
        str,
        typer.Option("--recipe", help="A recipe: its indenter, friction and quality count, its movements not."),
    ],
    data: Annotated[Path, typer.Option("--data", help="Measured forces: depth_mm, force_n and, to relax, time_s.")],
    out: Out = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Draw the forces and what the fit is off by.")] = None,
    second: Annotated[
        str,
        typer.Option(metavar="PATH=LOW:HIGH", help="Find this number too, such as contact.friction=0:0.5."),
    ] = "",
    no_zero: Annotated[bool, typer.Option("--no-zero", help="Depths count from first touch exactly.")] = False,
    prony: Annotated[int, typer.Option(min=0, max=3, help="Terms of a Prony series; needs time_s.")] = 0,
    as_json: AsJson = False,
) -> None:
    """Fit the moduli of a gel to forces of your own unit, with confidence intervals: and zero of depth, relaxation."""
    from tacgen.calibrate import material as fitting

    found = fitting.material(sensor, recipe, data, fitting.Asked(not no_zero, second, prony))
    lines = list(found.lines())
    if plot is not None:
        with writing(plot):
            found.draw(plot)
        lines.append(f"{plot}: forces, and what the fit is off by")
    if out is not None:
        with writing(out):
            found.write(out)
        lines.append(f"{out}: the sensor file of this gel")
    show_result(found.plain(), "\n".join(lines), as_json)
