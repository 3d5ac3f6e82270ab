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
    if animate is not None:
        if out is not None or field:
            raise UserError("--animate: draws a film of its own; leave out --out and --field")
        from tacgen.report import animation

        with written(animate, [path], overwrite) as film:
            animation.write(path, film)
        tell(str(animate))
        return
    from tacgen.report import bundle_figure as showing
    from tacgen.report import dataset_summary

    if out is None:
        if field:
            raise UserError("--field: draws a picture, and needs --out to say where")
        tell(dataset_summary.summary(path) if path.is_dir() else showing.summary(path))
        return
    with written(out, [path], overwrite) as picture:
        if field:
            from tacgen.report import field_figure

            field_figure.picture(path, field, picture)
        else:
            showing.picture(path, picture)
    tell(str(out))


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
