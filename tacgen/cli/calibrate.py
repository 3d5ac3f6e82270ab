"""`tacgen calibrate`: sensor files fitted to measurements of one's own unit."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tacgen.cli.common import AsJson, Overwrite, allowed, show_result, written

if TYPE_CHECKING:
    from tacgen.calibrate.sensor_fit import SensorFit

calibrations = typer.Typer(
    no_args_is_help=True, help="Fit a sensor file to your own unit: lights to photographs, gel to forces."
)
SensorFile = Annotated[str, typer.Option("--sensor", help="The sensor file to start from, by name or path.")]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Write the sensor file here.")]
Shift = Annotated[
    float, typer.Option(min=0, help="Largest shift of the LEDs from the file's positions; 0: fit radiances only.")
]
Rotation = Annotated[float, typer.Option(min=0, max=90, help="Largest rotation of the LEDs [deg].")]
NoMarkers = Annotated[bool, typer.Option("--no-markers", help="The photographed gel has no markers.")]
Anyway = Annotated[bool, typer.Option("--anyway", help="Write the file though the fit is not plausible.")]


@calibrations.command()
def optics(
    sensor: SensorFile,
    images: Annotated[
        Path, typer.Option("--images", help="A folder: background.png, and ball presses listed in presses.csv.")
    ],
    out: Out = None,
    tolerance_mm: Shift = 0.5,
    tolerance_deg: Rotation = 5.0,
    no_markers: NoMarkers = False,
    steps: Annotated[int, typer.Option(min=1, help="Largest number of iterations of a fit, for each ridge.")] = 1,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Draw unseen presses: photographed, and rendered before and after.")
    ] = None,
    anyway: Anyway = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Fit a sensor file to photographs of your own unit: LED radiances and positions, stray light, gloss, crop."""
    from tacgen.calibrate import optics as fitting
    from tacgen.calibrate.photometric_model import FitLimits

    inputs = [Path(sensor), images]
    allowed((out, figure), inputs, overwrite)
    with _progress():
        fitted = fitting.optics(sensor, images, FitLimits(tolerance_mm, tolerance_deg, no_markers, steps))
    drawn = figure, "unseen presses, photographed and rendered"
    _finish(fitted, "unit", inputs, drawn, out, anyway=anyway, overwrite=overwrite, as_json=as_json)


@calibrations.command()
def material(
    sensor: SensorFile,
    recipe: Annotated[
        str, typer.Option("--recipe", help="A recipe: its indenter, friction and quality are used, not its movements.")
    ],
    data: Annotated[Path, typer.Option("--data", help="CSV of forces: depth_mm, force_n and, for relaxation, time_s.")],
    out: Out = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Draw forces and residuals of the fit.")] = None,
    second: Annotated[
        str, typer.Option(metavar="PATH=LOW:HIGH", help="Also fit this number, such as contact.friction=0:0.5.")
    ] = "",
    no_zero: Annotated[bool, typer.Option("--no-zero", help="Depths are exact: do not fit their zero.")] = False,
    prony: Annotated[int, typer.Option(min=0, max=3, help="Terms of a Prony series to fit; needs time_s.")] = 0,
    anyway: Anyway = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Fit moduli, zero of the depth and relaxation of a gel to measured forces, with confidence intervals."""
    from tacgen.calibrate import material as fitting

    inputs = [Path(sensor), Path(recipe), data]
    allowed((out, plot), inputs, overwrite)
    with _progress():
        fitted = fitting.material(sensor, recipe, data, fitting.Unknowns(not no_zero, second, prony))
    drawn = plot, "forces, and what the fit is off by"
    _finish(fitted, "gel", inputs, drawn, out, anyway=anyway, overwrite=overwrite, as_json=as_json)


@calibrations.command()
def unit(
    sensor: SensorFile,
    images: Annotated[
        Path,
        typer.Option("--images", help="A folder: background.png, and ball presses with forces listed in presses.csv."),
    ],
    out: Out = None,
    friction: Annotated[float, typer.Option(min=0, help="Assumed friction of the balls on the gel.")] = 0.5,
    quality: Annotated[str, typer.Option("--quality", help="Mesh of the solved presses: draft or default.")] = "draft",
    keep_thickness: Annotated[
        bool, typer.Option("--keep-thickness", help="The gel is as thick as the sensor file says.")
    ] = False,
    no_lights: Annotated[bool, typer.Option("--no-lights", help="Do not fit the lights.")] = False,
    tolerance_mm: Shift = 2.0,
    tolerance_deg: Rotation = 15.0,
    no_markers: NoMarkers = False,
    plot: Annotated[Path | None, typer.Option("--plot", help="Draw forces from pictures over measured ones.")] = None,
    anyway: Anyway = False,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Fit gel thickness, moduli, zero of the gauge and lights to photographed ball presses with forces."""
    from tacgen.calibrate import unit as fitting
    from tacgen.calibrate.photometric_model import FitLimits

    inputs = [Path(sensor), images]
    allowed((out, plot), inputs, overwrite)
    limits = FitLimits(tolerance_mm, tolerance_deg, no_markers, fitting.LIGHT_FIT_STEPS)
    asked = fitting.Asked(friction, quality, not keep_thickness, not no_lights, limits)
    with _progress():
        fitted = fitting.unit(sensor, images, asked)
    drawn = plot, "forces from pictures over measured ones"
    _finish(fitted, "unit", inputs, drawn, out, anyway=anyway, overwrite=overwrite, as_json=as_json)


@contextmanager
def _progress() -> Iterator[None]:
    """Show the steps of a fit on stderr."""
    from tacgen.calibrate import steps
    from tacgen.report.progress import StepProgress

    with StepProgress() as shown, steps.telling(shown):
        yield


def _finish(
    fitted: "SensorFit", of: str, inputs: list[Path], drawn: tuple[Path | None, str], out: Path | None, *,
    anyway: bool, overwrite: bool, as_json: bool,
) -> None:  # fmt: skip
    """Draw, write and print a fit. Raises UserError, after printing it: it is not plausible and must not be written.

    Exits with 130 after a fit that Ctrl-C has ended.
    """
    lines, problem, (figure, what) = list(fitted.lines()), fitted.problem(), drawn
    if figure is not None and not fitted.interrupted:
        with written(figure, inputs, overwrite) as path:
            fitted.draw(path)
        lines.append(f"{figure}: {what}")
    if out is not None and (anyway or not problem):
        with written(out, inputs, overwrite) as path:
            fitted.write(path, anyway=anyway)
        lines.append(f"{out}: the sensor file of this {of}")
    if problem and (anyway or out is None):
        lines.append(f"not plausible: {problem}")
    show_result({**fitted.plain(), "problem": problem}, "\n".join(lines), as_json)
    if out is not None and not anyway:
        fitted.refuse(out)
    if fitted.interrupted:
        raise typer.Exit(130)
