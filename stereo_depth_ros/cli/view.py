# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth view`: views of a bag or a pair of images as image, animation or video."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import typer

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.sources import bag_files
from stereo_depth_ros.cli.camera_info import CameraInfo, CommandWithCameraInfo
from stereo_depth_ros.cli.given import given_parameters, is_given, refuse_ignored
from stereo_depth_ros.cli.kernels import prepare_kernels
from stereo_depth_ros.cli.options import (
    Duration,
    Left,
    Matcher,
    Overwrite,
    Params,
    ParamsFile,
    Right,
    SideBySide,
    Start,
    new_app,
)
from stereo_depth_ros.cli.output import (
    EXIT_INCOMPLETE,
    parameter_files,
    progress_bar,
    show,
    tell,
    warn,
)
from stereo_depth_ros.cli.params_file import read_parameters
from stereo_depth_ros.cli.tables import facts_table
from stereo_depth_ros.config import PipelineConfig, ViewConfig
from stereo_depth_ros.config.stages import ANAGLYPH_FILTERS, ANAGLYPH_METHODS
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.datasets.disparity_maps import MAP_SUFFIXES, read_disparity_map
from stereo_depth_ros.datasets.image_files import IMAGE_SUFFIXES, framed, read_image, read_pair
from stereo_depth_ros.datasets.rig_files import read_rig, rig_files
from stereo_depth_ros.files.output import check_outputs, write_file
from stereo_depth_ros.offline.view_frames import BagFrames, map_frame, pair_frame
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.views.anaglyph import anaglyph_matrix
from stereo_depth_ros.views.frame import ViewFrame
from stereo_depth_ros.views.gif import animated_gif
from stereo_depth_ros.views.layouts import LAYOUTS, arranged, check_layout
from stereo_depth_ros.views.stereogram import stereogram
from stereo_depth_ros.views.topics import ViewImages
from stereo_depth_ros.views.video import VideoFile
from stereo_depth_ros.views.wiggle import FRAME_MS, wiggle

__all__ = ["app"]

app = new_app()

_KINDS = ("position", "sweep", "anaglyph", "layout", "wiggle", "stereogram", "disparity_color", "depth_color")
# Options that belong to some kinds only
_BELONG = {
    "filters": ("anaglyph",),
    "convergence": ("anaglyph", "layout", "wiggle"),
    "texture": ("stereogram",),
    "legend": ("disparity_color", "depth_color"),
    "near": ("depth_color",),
    "far": ("depth_color",),
}
_OF_MAPS = ("stereogram", "disparity_color")  # views that need no images
_OF_BAGS = ("start", "duration", "left", "right")
_SWEEP_S = 2.0  # from the left camera to the right one and back
_SWEEP_HZ = 30.0  # of a pair of images


@app.command(cls=CommandWithCameraInfo)
def view(
    context: typer.Context,
    source: Annotated[
        Path, typer.Argument(metavar="BAG|LEFT|MAP", help="Read this bag, image of the left camera, or disparity map.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Write this file: .png, .gif or .mp4.")
    ],
    right_image: Annotated[
        Path | None, typer.Argument(metavar="RIGHT", help="Read this image of the right camera.")
    ] = None,
    position: Annotated[
        float | None,
        typer.Option(
            min=-0.5,
            max=1.5,
            metavar="-0.5..1.5",
            help="Draw the view from between the cameras: 0 is left, 1 is right.",
        ),
    ] = None,
    sweep: Annotated[bool, typer.Option("--sweep", help="Draw views from left to right and back, as a video.")] = False,
    anaglyph: Annotated[
        str | None,
        typer.Option(
            metavar="METHOD",
            help=f"Draw an anaglyph by this method: {', '.join(ANAGLYPH_METHODS)}.",
            autocompletion=lambda: [*ANAGLYPH_METHODS],
        ),
    ] = None,
    layout: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"Draw both images in one: {', '.join(LAYOUTS)} (rows).",
            autocompletion=lambda: [*LAYOUTS],
        ),
    ] = None,
    wiggle: Annotated[
        bool, typer.Option("--wiggle", help="Draw an animation from left to right and back, .gif.")
    ] = False,
    stereogram: Annotated[
        bool, typer.Option("--stereogram", help="Draw random dots, or --texture, that show depth without glasses.")
    ] = False,
    disparity_color: Annotated[
        bool, typer.Option("--disparity-color", help="Draw the disparity as colors, over the range searched.")
    ] = False,
    depth_color: Annotated[
        bool, typer.Option("--depth-color", help="Draw the depth as colors, over --near and --far.")
    ] = False,
    filters: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"Use these filters for --anaglyph: {', '.join(ANAGLYPH_FILTERS)}.",
            autocompletion=lambda: [*ANAGLYPH_FILTERS],
        ),
    ] = ANAGLYPH_FILTERS[0],
    convergence: Annotated[
        float | None,
        typer.Option(
            metavar="PX", help="Set the disparity that lies at the screen; it is that of the subject by default."
        ),
    ] = None,
    texture: Annotated[
        Path | None, typer.Option(metavar="IMAGE", help="Use this image, repeated, in place of random dots.")
    ] = None,
    legend: Annotated[bool, typer.Option("--legend", help="Draw a legend beside the colors.")] = False,
    near: Annotated[
        float, typer.Option(min=0, metavar="M", help="Set the depth with the lightest color; 0 is the 1st percentile.")
    ] = 0.0,
    far: Annotated[
        float, typer.Option(min=0, metavar="M", help="Set the depth with the darkest color; 0 is the 99th percentile.")
    ] = 0.0,
    camera_info: CameraInfo = None,
    matcher: Matcher = None,
    param: Params = None,
    params_file: ParamsFile = None,
    start: Start = 0.0,
    duration: Duration = 0.0,
    left: Left = None,
    right: Right = None,
    side_by_side: SideBySide = False,
    overwrite: Overwrite = False,
) -> None:
    """Draw one kind of view of a bag or a pair of images: an image, an animation or a video.

    An image, .png, and an animation, .gif, are of the first pair; of a bag, --start chooses another one. A video, .mp4,
    has a frame for each pair of a bag. Images are rectified with --camera-info; without it they are rectified already.
    Of a disparity map, .pfm or .npz, --stereogram and --disparity-color can be drawn.

    Exit codes are 0 for success, 1 for an error, 2 for wrong usage and 3 where some pairs were skipped.

    \b
    Examples:
      stereo-depth view left.png right.png --position 0.5 -o view.png
      stereo-depth view drive.mcap --sweep -o view.mp4
      stereo-depth view drive.mcap --anaglyph dubois --filters green-magenta -o anaglyph.png
      stereo-depth view drive.mcap --depth-color --near 1 --far 20 --legend -o depth.mp4
      stereo-depth view left.png right.png --wiggle -o wiggle.gif
      stereo-depth view disp0.pfm --stereogram --texture stones.png -o stereogram.png
    """
    kind = _kind(context)
    for name, kinds in _BELONG.items():
        if kind not in kinds:
            refuse_ignored(context, [name], f"with {_option(kind)}", f"use it with {' or '.join(map(_option, kinds))}")
    check_layout(layout or LAYOUTS[0])
    anaglyph_matrix(anaglyph or ANAGLYPH_METHODS[-1], filters)  # refuses unknown ones before anything is read
    config = ViewConfig(
        view_position=0.5 if position is None else position,
        anaglyph_method=anaglyph or ANAGLYPH_METHODS[-1],
        anaglyph_filters=filters,
        auto_convergence=convergence is None,
        convergence=convergence or 0.0,
        depth_near=near,
        depth_far=far,
        color_legend=legend,
    )
    given = _given(source, right_image, side_by_side)
    _check_suffix(kind, output, given)
    _check_source(context, kind, given, source, bool(camera_info))
    file = read_parameters(params_file)
    stages = _STAGES[given]
    values = {**file, **given_parameters(param or (), matcher, file=file, stages=stages, remedies=_REMEDIES)}
    pipeline = pipeline_config(values)
    files = rig_files(camera_info) if camera_info else []
    sources = bag_files(source) if given == "a bag" else [source, right_image or source]
    inputs = [*sources, *files, *([texture] if texture else []), *parameter_files(params_file, values)]
    check_outputs([output], inputs, overwrite=overwrite)
    drawing = _Drawing(config, layout or LAYOUTS[0], read_image(texture) if texture else None)
    prepare_kernels(pipeline.matching if given != "a disparity map" else None)
    frames: BagFrames | list[ViewFrame]
    rate_hz = _SWEEP_HZ
    if given == "a bag":
        selection = BagSelection(source, left, right, start, duration, side_by_side, tuple(camera_info or ()))
        frames = BagFrames(selection, pipeline)
        rate_hz = frames.rate_hz if output.suffix.lower() == ".mp4" else 0.0
    elif given == "images":
        frames = [_pair(source, right_image or source, camera_info, pipeline)]
        frames *= round(_SWEEP_S * _SWEEP_HZ) if kind == "sweep" else 1
    else:
        frames = [map_frame(read_disparity_map(source))]
    _write(drawing, kind, frames, rate_hz, output, overwrite)
    if isinstance(frames, BagFrames):
        _finish(frames)


_REMEDIES = {"view": "use the options of this command"}
# By what is given: the stages whose parameters have an effect, and the options that have none
_STAGES: Mapping[str, tuple[str, ...]] = {
    "a bag": ("pairing", "matching", "rectification"),
    "images": ("matching",),
    "a disparity map": (),
}
_IGNORED: Mapping[str, tuple[str, ...]] = {
    "a bag": (),
    "images": _OF_BAGS,
    "a disparity map": (*_OF_BAGS, "camera_info", "matcher", "param", "params_file", "side_by_side"),
}


def _given(source: Path, right_image: Path | None, side_by_side: bool) -> str:
    """What the views are drawn from."""
    if right_image is not None or (side_by_side and source.suffix.lower() in IMAGE_SUFFIXES):
        if right_image is not None and side_by_side:
            raise ConfigError(
                f"{right_image} has no effect with --side-by-side, both images are in {source}",
                remedy="name one image",
            )
        return "images"
    return "a disparity map" if source.suffix.lower() in MAP_SUFFIXES else "a bag"


def _check_source(context: typer.Context, kind: str, given: str, source: Path, calibrated: bool) -> None:
    """Refuse options and views that what is given does not have."""
    refuse_ignored(context, _IGNORED[given], f"with {given}", "leave it out")
    if given == "a bag" and source.suffix.lower() in IMAGE_SUFFIXES:
        raise ConfigError(
            "the image of the right camera is missing",
            value=str(source),
            remedy="name it after that of the left camera, or give --side-by-side where one file holds both",
        )
    if given == "a disparity map" and kind not in _OF_MAPS:
        raise ConfigError(
            f"{_option(kind)} needs images, {source} is a disparity map",
            value=str(source),
            limit=_OF_MAPS,
            remedy=f"use {' or '.join(map(_option, _OF_MAPS))}, or name both images",
        )
    if given == "images" and kind == "depth_color" and not calibrated:
        raise ConfigError(
            "--depth-color needs a calibration, images have none",
            remedy="give --camera-info, or use --disparity-color",
        )


def _option(kind: str) -> str:
    return f"--{kind.replace('_', '-')}"


def _kind(context: typer.Context) -> str:
    """The one kind of view that is asked for."""
    given = [kind for kind in _KINDS if is_given(context, kind)]
    if len(given) != 1:
        names = ", ".join(map(_option, given or _KINDS))
        problem = f"{names} are different views" if given else f"no view is chosen of {names}"
        raise ConfigError(problem, value=given, limit=1, remedy="give one of them")
    return given[0]


def _check_suffix(kind: str, output: Path, given: str) -> None:
    """Refuse a file of another type than the view has."""
    possible = {"sweep": (".mp4",), "wiggle": (".gif",)}.get(kind, (".png", ".mp4") if given == "a bag" else (".png",))
    if output.suffix.lower() not in possible:
        raise ConfigError(
            f"--output {output} does not end in {' or '.join(possible)}, as {_option(kind)} of {given} does",
            value=output.suffix,
            limit=possible,
            remedy=f"name it {output.stem or 'view'}{possible[0]}",
        )


def _pair(left: Path, right: Path, camera_info: list[Path] | None, config: PipelineConfig) -> ViewFrame:
    pixels = read_pair(left, right)
    rig = framed(read_rig(camera_info, size=(pixels[0].shape[1], pixels[0].shape[0]))) if camera_info else None
    return pair_frame(*pixels, rig, config)


@dataclass
class _Drawing:
    """Draws the frames of one kind, in order."""

    config: ViewConfig
    layout: str
    texture: U8 | None
    images: ViewImages = field(default_factory=ViewImages)

    def draw(self, kind: str, frame: ViewFrame, position: float) -> U8:
        """The image of a frame; ``position`` is that of a sweep."""
        if kind == "sweep":
            return self.images.interpolated(frame, replace(self.config, view_position=position))
        if kind == "layout":
            return arranged(*self.images.converged(frame, self.config), self.layout)
        if kind == "stereogram":
            return stereogram(frame.disparity_px, self.texture)
        draw = {
            "position": self.images.interpolated,
            "anaglyph": self.images.anaglyph,
            "disparity_color": self.images.disparity_color,
            "depth_color": self.images.depth_color,
        }[kind]
        return draw(frame, self.config)

    def animation(self, frame: ViewFrame) -> bytes:
        """The GIF of a frame."""
        assert frame.left is not None and frame.right is not None  # of bags and images
        shift_px = self.images.shift_px(frame, self.config)
        return animated_gif(wiggle(frame.left, frame.right, frame.disparity_px, shift_px), FRAME_MS)


def _write(
    drawing: _Drawing, kind: str, frames: BagFrames | list[ViewFrame], rate_hz: float, output: Path, overwrite: bool
) -> None:
    """Draw and write what the suffix of the file names."""
    number, size = 1, ""
    if output.suffix.lower() == ".mp4":
        with VideoFile(output, rate_hz, overwrite=overwrite) as video, progress_bar("drawing") as progress:
            for number, frame in enumerate(frames, start=1):
                position = 0.5 - 0.5 * math.cos(2 * math.pi * (number - 1) / (_SWEEP_S * rate_hz))
                image = drawing.draw(kind, frame, position)
                video.add(image)
                size = f"{image.shape[1]}x{image.shape[0]}"
                progress(number, max(number, frames.count if isinstance(frames, BagFrames) else len(frames)))
    else:
        frame = next(iter(frames))
        if kind == "wiggle":
            write_file(output, drawing.animation(frame), overwrite=overwrite, make_folders=True)
        else:
            image = drawing.draw(kind, frame, 0.0)
            save_png(output, image, overwrite=overwrite)
            size = f"{image.shape[1]}x{image.shape[0]}"
    facts = facts_table()
    facts.add_row("view", kind.replace("_", " "))
    if size:
        facts.add_row("frames", f"{number}, {size} px" if number > 1 else f"{size} px")
    if kind in _BELONG["convergence"]:
        facts.add_row("at the screen", f"disparity {drawing.images.screen_px} px")
    facts.add_row("written", str(output))
    show([facts], {}, None)


def _finish(frames: BagFrames) -> None:
    for text in frames.warnings:
        warn(text)
    if frames.skipped:
        tell(f"error: {frames.skipped} pairs skipped: see the warnings above")
        raise typer.Exit(EXIT_INCOMPLETE)
