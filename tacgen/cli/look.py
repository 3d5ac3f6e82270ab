"""The commands that show finished bundles: report, show and view."""

from pathlib import Path
from typing import Annotated

import typer

from tacgen.base.errors import UserError
from tacgen.cli.common import Bundles, Overwrite, tell, written


def report(
    folder: Annotated[Path, typer.Argument(help="A folder that `run` or `pack` wrote.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The page, by default report.html there.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write an HTML report of a dataset: coverage of the varied values, failures by cause, run times, pictures."""
    from tacgen.report import html_report as reporting

    if folder.is_file():
        raise UserError(f"{folder}: is a file, and a report is of a folder; tacgen show and view draw one bundle")
    out = out or folder / "report.html"
    with written(out, [folder], overwrite, "page") as path:
        reporting.write(folder, path, out)
    tell(str(out))


def show(
    path: Annotated[Path, typer.Argument(help="A bundle, or a folder of bundles for a summary.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Draw a picture; default: print a summary.")] = None,
    field: Annotated[
        str,
        typer.Option("--field", help="Draw one: camera, markers, pressure, traction, slip, height, flow or stress."),
    ] = "",
    animate: Annotated[
        Path | None, typer.Option("--animate", help="Write an animation: webp, gif, or mp4 if ffmpeg is installed.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Print the contents of a bundle, or draw images, pressure, traction and height of its frames."""
    from tacgen.report import animation, bundle_figure, dataset_summary, field_figure

    if animate is not None and (out is not None or field):
        raise UserError("--animate: draws a film of its own; leave out --out and --field")
    if field and out is None:
        raise UserError("--field: draws a picture, and needs --out to say where")
    if (target := animate or out) is None:
        tell(dataset_summary.summary(path) if path.is_dir() else bundle_figure.summary(path))
        return
    bundle = bundle_figure.only(path)
    with written(target, [path], overwrite) as new:
        if animate is not None:
            animation.write(bundle, new)
        else:
            bundle_figure.save(field_figure.figure(bundle, field) if field else bundle_figure.figure(bundle), new)
    tell(str(target))


def view(
    path: Bundles,
    other: Annotated[Path | None, typer.Argument(help="Another bundle, shown side by side.")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="The page to write.")] = Path("view.html"),
    browse: Annotated[bool, typer.Option("--browse", help="Open it in the web browser.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Write an interactive HTML page of a bundle: camera image, maps, and the gel with its stress in 3D; of a folder of
    several bundles a list of them with filters, and a page of each beside it."""
    from tacgen.bundle import dataset
    from tacgen.report import scene_pages, viewer

    bundles, left = [path] if other is None else [path, other], 0
    several = other is None and path.is_dir() and len(dataset.scenes(path)) > 1
    with written(out, bundles, overwrite, "page") as page:
        if several:
            left = scene_pages.write(path, page, out)
        else:
            viewer.write(bundles, page)
    tell(f"{out}: {left} scenes have no page" if left else str(out))
    if browse:
        typer.launch(str(out))
