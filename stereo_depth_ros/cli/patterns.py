# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth patterns`: writes the patterns that a projector shows for a scan, and their manifest."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from stereo_depth_ros.active.one_shot.stripes import stripe_pattern
from stereo_depth_ros.active.structured_light.decoding import check_sequence
from stereo_depth_ros.active.structured_light.manifest import MANIFEST, manifest_text
from stereo_depth_ros.active.structured_light.patterns import KINDS, PatternSequence
from stereo_depth_ros.active.structured_light.video import mp4_video
from stereo_depth_ros.cli.camera_info import parse_size
from stereo_depth_ros.cli.given import refuse_files, refuse_ignored
from stereo_depth_ros.cli.options import Json, Overwrite, new_app
from stereo_depth_ros.cli.output import progress_bar, show
from stereo_depth_ros.cli.tables import TextTable, facts_table
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.files.output import check_outputs, write_file
from stereo_depth_ros.plots.drawing import save_png

__all__ = ["app"]

app = new_app()

_STRIPES = "stripes"
_VIDEO = "patterns.mp4"


@app.command()
def patterns(
    context: typer.Context,
    size: Annotated[str, typer.Option(metavar="WIDTHxHEIGHT", help="Write patterns for a projector of this size.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Write the files to this folder.")],
    kind: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help=f"Write patterns of this kind: {', '.join((*KINDS, _STRIPES))}.",
            autocompletion=lambda: [*KINDS, _STRIPES],
        ),
    ] = "gray+phase",
    rows: Annotated[
        bool,
        typer.Option(
            "--rows", help="Write patterns of the rows too, which a calibration of the projector and raw images need."
        ),
    ] = False,
    period: Annotated[
        list[float] | None,
        typer.Option(
            metavar="PIXELS",
            help="Use sinusoids of this period; the option may be repeated. The default is 16, for phase also the "
            "whole width and a period in between.",
        ),
    ] = None,
    steps: Annotated[int, typer.Option(min=3, max=64, metavar="N", help="Use this number of steps of a sinusoid.")] = 4,
    video: Annotated[bool, typer.Option(help=f"Write {_VIDEO}, which a projector can play.")] = True,
    seconds: Annotated[float, typer.Option(metavar="SECONDS", help="Show each pattern of the video so long.")] = 0.5,
    json_file: Json = None,
    overwrite: Overwrite = False,
) -> None:
    """Write the patterns that a projector shows for a scan, and their manifest.

    DIR receives the images pattern_001.png and so on, the manifest patterns.json, which `stereo-depth scan` reads, and
    the video. Gray codes (gray) need
    the most images and are the most robust, sinusoids of several periods (phase) the fewest, both together (gray+phase)
    are the most accurate. Color stripes (stripes) are a single image, which moving objects need; they have no manifest,
    since the image itself is the pattern.

    \b
    Examples:
      stereo-depth patterns --size 1024x768 -o patterns
      stereo-depth patterns --size 1920x1080 -o patterns --kind phase --period 42 --period 45 --period 48 --steps 3
      stereo-depth patterns --size 1024x768 -o patterns --kind gray --rows --seconds 1
    """
    refuse_files("--output", output)
    if "phase" not in kind:
        refuse_ignored(context, ["period", "steps"], f"with --kind {kind}", "use --kind phase or gray+phase")
    if kind == _STRIPES:
        refuse_ignored(context, ["rows"], "with --kind stripes", "leave it out")
    if not video:
        refuse_ignored(context, ["seconds"], "with --no-video", "leave one of them out")
    shown = _shown(kind, _projector(size), rows, period or (), steps)
    names = [f"pattern_{number:03d}.png" for number in range(1, shown.count + 1)]
    more = [*([MANIFEST] if shown.manifest else []), *([_VIDEO] if video else [])]
    check_outputs([output / name for name in (*names, *more)], reports=[json_file], overwrite=overwrite)
    encoded = mp4_video(shown.images(), seconds) if video else b""
    with progress_bar("writing patterns") as progress:
        for number, (name, image) in enumerate(zip(names, shown.images(), strict=True), start=1):
            save_png(
                output / name, image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1]), overwrite=overwrite
            )
            progress(number, shown.count)
    if video:
        write_file(output / _VIDEO, encoded, overwrite=overwrite)
    if shown.manifest:
        write_file(output / MANIFEST, shown.manifest, overwrite=overwrite)
    values = {
        "kind": kind,
        "images": shown.count,
        "output": str(output),
        "files": [*names, *more],
        "manifest": json.loads(shown.manifest) if shown.manifest else None,
        "video_seconds": shown.count * seconds if video else None,
    }
    show([_table(values)], values, json_file, overwrite=overwrite)


@dataclass(frozen=True)
class _Shown:
    """What is written: the number of patterns, the patterns, and the manifest, empty where there is none."""

    count: int
    sequence: PatternSequence | None
    stripes: U8 | None
    manifest: str

    def images(self) -> Iterable[U8]:
        return (
            self.sequence.render() if self.sequence is not None else [self.stripes] if self.stripes is not None else []
        )


def _shown(kind: str, size: tuple[int, int], rows: bool, periods: Iterable[float], steps: int) -> _Shown:
    if kind == _STRIPES:
        return _Shown(1, None, stripe_pattern(size), "")
    sequence = PatternSequence.of_kind(kind, size, rows=rows, periods_px=tuple(periods), steps=steps)
    check_sequence(sequence)
    return _Shown(len(sequence), sequence, None, manifest_text(sequence))


def _projector(text: str) -> tuple[int, int]:
    size = parse_size(text)
    if size is None:
        raise ConfigError("the size of the projector is missing", remedy="give --size, such as 1024x768")
    return size


def _table(values: dict[str, Any]) -> TextTable:
    table = facts_table()
    table.add_row("patterns", f"{values['images']} of kind {values['kind']}")
    table.add_row("written", f"{values['output']}: {', '.join(_summary(values['files']))}")
    if values["video_seconds"] is not None:
        table.add_row("video", f"{values['video_seconds']:g} s")
    return table


def _summary(files: list[str]) -> list[str]:
    images = [name for name in files if name.endswith(".png")]
    first = images[0] if len(images) == 1 else f"{images[0]} to {images[-1]}"
    return [first, *(name for name in files if name not in images)]
