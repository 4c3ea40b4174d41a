# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth focus`: depth and an all-in-focus image from images at several focus distances."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from stereo_depth_ros.active.focus.distances import LAWS, ORDERS, even_distances, read_focus_table, table_order
from stereo_depth_ros.active.focus.stack import FocusResult, depth_from_focus
from stereo_depth_ros.bags.sources import is_bag
from stereo_depth_ros.bags.writer import check_bag_output
from stereo_depth_ros.camera_files.one_camera import read_camera
from stereo_depth_ros.cli.export import SurfaceExport, add_files
from stereo_depth_ros.cli.given import is_given, refuse_ignored, require_png
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.options import BagOutput, Export, Json, Overwrite, new_app
from stereo_depth_ros.cli.output import progress_bar, show
from stereo_depth_ros.cli.tables import TextTable, facts_table, plain_table
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import F64
from stereo_depth_ros.files.output import check_outputs
from stereo_depth_ros.offline.focus import FocusImages, range_image, read_focus_images, write_focus_bag
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.focus import focus_plot
from stereo_depth_ros.plots.preview import preview as depth_preview
from stereo_depth_ros.stages.depth import millimeters

__all__ = ["app"]

app = new_app()


@app.command()
def focus(
    context: typer.Context,
    place: Annotated[
        Path, typer.Argument(metavar="DIR|BAG", help="Read the images of this folder, or of a topic of this bag.")
    ],
    output: BagOutput,
    table: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Read the focus distance of each image from this table.")
    ] = None,
    near: Annotated[
        float | None, typer.Option(metavar="METERS", help="Set the nearest focus distance, in place of a table.")
    ] = None,
    far: Annotated[
        float | None, typer.Option(metavar="METERS", help="Set the farthest focus distance, inf is infinity.")
    ] = None,
    order: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"Set in which order the images are: {', '.join(ORDERS)}; --near and --far need it.",
            autocompletion=lambda: [*ORDERS],
        ),
    ] = None,
    law: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"Take equal steps between --near and --far of the distance or its inverse: {', '.join(LAWS)}.",
            autocompletion=lambda: [*LAWS],
        ),
    ] = "inverse",
    focal_length: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Use this focal length, for a table of the distance of the sensor."),
    ] = None,
    topic: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Read the images of a bag from this topic.")
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Take the calibration of the camera from this file.")
    ] = None,
    window: Annotated[
        int, typer.Option(metavar="PIXELS", help="Set the width of the window that sharpness is measured in, odd.")
    ] = 9,
    align: Annotated[
        bool, typer.Option("--align/--no-align", help="Look for the scale and shift of each image and remove them.")
    ] = True,
    depth_image: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Write the depth as a 16-bit PNG in millimeters, 0 is invalid."),
    ] = None,
    all_in_focus: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Write the all-in-focus image as a PNG.")
    ] = None,
    preview: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Write that image and the depth in colors as a PNG.")
    ] = None,
    export: Export = None,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Compute depth and an all-in-focus image from images at several focus distances.

    Camera and scene are at rest, and the focus moves in one direction from image to image; files are in the order of
    the numbers in their names. The depth of a pixel is the focus distance at which it is sharpest. It needs texture and
    focus distances beyond both ends of the scene; pixels without are invalid, with the reason.

    Depth in meters must have the focus distances, from the lens: --near, --far and --order, or a table. In a table, the
    first column is image (a file name) or stamp_s, the second one is distance_m, distance_mm, diopters, or sensor_mm
    with --focal-length. Without them the result is the number of the sharpest image, to which 1 / Z is linear if the
    lens moves in equal steps.

    OUT.mcap receives focus/image_rect_color, focus/index, focus/index_sigma and focus/reasons, with focus distances
    depth/image_rect and depth/sigma, with --camera depth/camera_info and points2. With both, a mesh or a cloud can be
    written by --export.

    \b
    Examples:
      stereo-depth focus stack -o focus.mcap --preview focus.png
      stereo-depth focus stack -o focus.mcap --near 0.1 --far inf --order far-to-near --camera camera.yaml
      stereo-depth focus stack -o focus.mcap --table stack.csv --focal-length 50 --depth-image depth.png
      stereo-depth focus stack -o focus.mcap --table stack.csv --camera camera.yaml --export stack.glb
    """
    _check_options(context, place, table, near, far, order, camera)
    further = {"--depth-image": depth_image, "--all-in-focus": all_in_focus, "--preview": preview}
    for name, path in further.items():
        require_png(name, path)
    images = read_focus_images(place, topic, ordered=table is not None)
    inputs = [*images.files, *(path for path in (table, camera) if path is not None)]
    check_bag_output(output, inputs, reports=[json_file], overwrite=overwrite)
    check_outputs([path for path in (*further.values(), export) if path is not None], inputs, overwrite=overwrite)
    surfaces = SurfaceExport(export, overwrite=overwrite)
    distances_m = None
    if table is not None:
        rows = read_focus_table(table, None if focal_length is None else 1e-3 * focal_length)
        names = [] if images.of_bag else images.names
        distances_m = table_order(rows, names, [frame.stamp_ns for frame in images.frames], table)
        images, distances_m = _sorted(images, distances_m)
    elif near is not None and far is not None and order is not None:
        distances_m = even_distances(near, far, len(images.frames), law, order)
    height, width = images.frames[0].pixels.shape[:2]
    model = None if camera is None else read_camera(camera, (width, height))
    prepare_kernels()
    with progress_bar("measuring sharpness") as progress:
        result = depth_from_focus(
            images.frames, distances_m, window=window, align=align, names=images.names, progress=progress
        )
    if model is not None:
        result = result.rectified(model)
    facts = {"images": str(len(images.frames)), "window": str(window)}
    reference = images.frames[result.reference]
    topics = write_focus_bag(output, result, reference, model, metadata=facts, overwrite=overwrite)
    if export is not None and model is not None:
        with surfaces:
            surfaces.add_image(range_image(result, model), reference.stamp_ns)
    if depth_image is not None and result.depth_m is not None:
        save_png(depth_image, _millimeters(result), overwrite=overwrite)
    sharp = result.all_in_focus if result.encoding != "rgb8" else np.ascontiguousarray(result.all_in_focus[..., ::-1])
    if all_in_focus is not None:
        save_png(all_in_focus, sharp, overwrite=overwrite)
    if preview is not None:
        title = place.name
        image = (
            focus_plot(sharp, result.index, len(images.frames), title)
            if result.depth_m is None
            else depth_preview(sharp, result.depth_m, title, "all in focus")
        )
        save_png(preview, image, overwrite=overwrite)
    values = _values(result, images, distances_m, topics, output) | surfaces.to_json()
    written = {"bag": output, "depth image": depth_image, "all-in-focus image": all_in_focus, "preview": preview}
    show(_tables(result, images, distances_m, written, surfaces), values, json_file, overwrite=overwrite)


def _check_options(
    context: typer.Context,
    place: Path,
    table: Path | None,
    near: float | None,
    far: float | None,
    order: str | None,
    camera: Path | None,
) -> None:
    """Refuse options that are missing, contradict each other or have no effect.

    Raises:
        ConfigError: such options.
    """
    if table is not None:
        refuse_ignored(context, ("near", "far", "order", "law"), "with --table", "leave one of them out")
    else:
        refuse_ignored(context, ("focal_length",), "without --table", "add --table, or leave it out")
    if (near is None) != (far is None):
        raise ConfigError(
            f"--{'near' if far is None else 'far'} is given without --{'far' if far is None else 'near'}",
            remedy="give both ends of the focus",
        )
    if near is not None and order is None:
        raise ConfigError(
            "the order of the focus is unknown: whether the first image is the nearest or the farthest",
            limit=ORDERS,
            remedy=f"give --order {ORDERS[0]} or --order {ORDERS[1]}",
        )
    if near is None:
        refuse_ignored(context, ("order", "law"), "without --near and --far", "add them, or leave it out")
    if not is_bag(place):
        refuse_ignored(context, ("topic",), "with a folder", "leave it out")
    for name in ("depth_image", "export"):
        if near is None and table is None and is_given(context, name):
            raise ConfigError(
                f"--{name.replace('_', '-')} needs the focus distances, without them no depth is known",
                remedy="give --table, or --near, --far and --order",
            )
    if camera is None and is_given(context, "export"):
        raise ConfigError(
            "--export needs the camera, without its calibration no point is known",
            remedy="give --camera, or write --depth-image",
        )


def _sorted(images: FocusImages, distances_m: F64) -> tuple[FocusImages, F64]:
    """The images in the order of their distance, the farthest first."""
    order = np.argsort(-distances_m, kind="stable")
    frames, names = [images.frames[k] for k in order], [images.names[k] for k in order]
    return FocusImages(frames, names, images.of_bag, images.files), distances_m[order]


def _millimeters(result: FocusResult) -> Any:
    depth_m = result.depth_m
    return None if depth_m is None else millimeters(np.ascontiguousarray(depth_m))


def _values(
    result: FocusResult, images: FocusImages, distances_m: F64 | None, topics: list[str], output: Path
) -> dict[str, Any]:
    depth_m, sigma_m = result.depth_m, result.sigma_m
    found = np.isfinite(result.index).any()
    return {
        "images": [
            {
                "name": name,
                "distance_m": _distance(distances_m, number),
                "scale": placement.scale,
                "shift_px": placement.shift_px,
                "gain": placement.gain,
                "correlation": placement.correlation,
                "sharpest": share,
            }
            for number, (name, placement, share) in enumerate(
                zip(images.names, result.placements, _shares(result), strict=True)
            )
        ],
        "reference": images.names[result.reference],
        "noise": result.noise,
        "valid_fraction": result.valid_fraction,
        "reasons": result.reason_counts(),
        "median_index": float(np.nanmedian(result.index)) if found else None,
        "median_index_sigma": float(np.nanmedian(result.index_sigma)) if found else None,
        "median_depth_m": float(np.nanmedian(depth_m)) if found and depth_m is not None else None,
        "median_sigma_m": float(np.nanmedian(sigma_m)) if found and sigma_m is not None else None,
        "topics": topics,
        "output": str(output),
    }


def _distance(distances_m: F64 | None, number: int) -> float | None:
    """The focus distance of an image; None where it is infinite, which JSON does not have."""
    return None if distances_m is None or not np.isfinite(distances_m[number]) else float(distances_m[number])


def _shares(result: FocusResult) -> list[float]:
    """For each image, the share of the valid pixels that are sharpest there."""
    index = result.index[np.isfinite(result.index)]
    counts = np.bincount(np.rint(index).astype(np.intp), minlength=len(result.placements))
    return [float(count) / max(index.size, 1) for count in counts]


def _tables(
    result: FocusResult,
    images: FocusImages,
    distances_m: F64 | None,
    written: dict[str, Path | None],
    surfaces: SurfaceExport,
) -> Iterator[TextTable]:
    table = plain_table("image", "focus m:r", "scale:r", "shift px:r", "correlation:r", "sharpest:r")
    for number, (name, each, share) in enumerate(zip(images.names, result.placements, _shares(result), strict=True)):
        x, y = each.shift_px
        distance = "" if distances_m is None else f"{distances_m[number]:.4g}"
        cells = f"{each.scale:.4f}", f"{x:+.1f} {y:+.1f}", f"{each.correlation:.3f}", f"{100 * share:.1f} %"
        table.add_row(name, distance, *cells)
    yield table
    facts = facts_table()
    facts.add_row("images", f"{len(images.frames)}, placed on {images.names[result.reference]}")
    facts.add_row("noise", f"{result.noise:.2f} gray levels")
    counts = sorted(((count, name) for name, count in result.reason_counts().items() if count), reverse=True)
    facts.add_row("valid", f"{100 * result.valid_fraction:.1f} %")
    facts.add_row("without depth", ", ".join(f"{name.lower().replace('_', ' ')} {n}" for n, name in counts) or "none")
    if np.isfinite(result.index).any():
        facts.add_row("sharpest image", f"median {float(np.nanmedian(result.index)) + 1:.2f} of {len(images.frames)}")
        if result.depth_m is not None and result.sigma_m is not None:
            low, high = np.nanpercentile(result.depth_m, [1, 99])
            median, sigma = float(np.nanmedian(result.depth_m)), float(np.nanmedian(result.sigma_m))
            facts.add_row("depth", f"median {median:.4g} m, {low:.4g} to {high:.4g} m (98 %)")
            facts.add_row("standard deviation", f"median {1e3 * sigma:.3g} mm")
        else:
            facts.add_row("standard deviation", f"median {float(np.nanmedian(result.index_sigma)):.3f} images")
    for name, path in written.items():
        if path is not None:
            facts.add_row(f"{name} written", str(path))
    add_files(facts, surfaces.written)
    yield facts
