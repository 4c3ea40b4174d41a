# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth evaluate`: errors and times of methods on pairs whose truth is known."""

from __future__ import annotations

import csv
import functools
import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from stereo_depth_ros.bags.sources import is_bag
from stereo_depth_ros.cli.options import Json, Overwrite, Params, new_app
from stereo_depth_ros.cli.output import messages, parameter_files, progress_bar, show
from stereo_depth_ros.cli.tables import evaluation_tables
from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.config.values import parse_assignments, pipeline_config
from stereo_depth_ros.core.errors import BagError, ImageError, StereoDepthError
from stereo_depth_ros.evaluation.bag_scenes import BagScenes
from stereo_depth_ros.evaluation.evaluator import Evaluation
from stereo_depth_ros.evaluation.evaluator import evaluate as evaluate_matcher
from stereo_depth_ros.evaluation.plausibility import check_plausible
from stereo_depth_ros.evaluation.scenes import Scene, SceneSet, SceneSource, find_scenes
from stereo_depth_ros.files.output import check_outputs, write_file
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.plots.curve import curve_plot
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.error import error_plot

__all__ = ["app"]

app = new_app()

_EXIT_LEFT_OUT = 3  # some of what was asked for is missing


@app.command()
def evaluate(
    places: Annotated[list[Path], typer.Argument(metavar="DIR|BAG...", help="Dataset folders, or bags with truth.")],
    matcher: Annotated[list[str], typer.Option(metavar="NAME", help="Method to evaluate; may be repeated.")],
    param: Params = None,
    json_file: Json = None,
    csv_file: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the figures as CSV.")] = None,
    images: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Draw left, truth, found and error of each scene into DIR.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Compare the disparities of methods with the truth, and measure their time.

    DIR is a Middlebury scene of 2001 to 2014, an ETH3D two-view scene or a KITTI stereo training folder, or a folder of
    such, one or two levels down; no calibration is needed. BAG has /truth/disparity, as `convert` and `synthesize`
    write it.

    The search of each scene ends at the smallest multiple of 16 (at least 32) above its largest true disparity, the
    same for every method, unless disparity_range is given with --param.

    "bad x" is the percentage of the matched truth pixels that are wrong by more than x px; "all" counts pixels without
    disparity as wrong. Density is within 0..1 in the files.

    \b
    Examples:
      stereo-depth evaluate Motorcycle-perfect --matcher sgbm
      stereo-depth evaluate middlebury eth3d --matcher bm --matcher sgbm --json scores.json --images out
      stereo-depth evaluate room.mcap --matcher sgbm --param disparity_range:=128 --param P1:=100
    """
    values = parse_assignments(param or ())
    config = pipeline_config(values).matching
    for name in matcher:
        create_matcher(name, config)  # an unknown name or a refused parameter ends it before anything runs
    sets = [_scenes(place) for place in places]
    inputs = [*(path for scenes in sets for path in _files(scenes)), *parameter_files(None, values)]
    drawn = list(_pictures(images, sets, matcher)) if images is not None else []
    check_outputs(drawn, inputs, reports=[json_file, csv_file], overwrite=overwrite)
    draw = functools.partial(_draw, images, overwrite) if images is not None else None
    rows, left_out = _run(sets, matcher, config, list(values), draw)
    if not rows:
        raise ImageError(f"nothing could be evaluated: {left_out[0]}")
    if csv_file is not None:
        write_file(csv_file, _csv(rows), overwrite=overwrite)
    show(evaluation_tables(rows, "disparity_range" in values, images), rows, json_file, overwrite=overwrite)
    for text in left_out:
        messages.print(f"warning: {text}", markup=False)
    if left_out:
        messages.print(f"error: {len(left_out)} left out: see the warnings above")
        raise typer.Exit(_EXIT_LEFT_OUT)


def _scenes(place: Path) -> SceneSet:
    if not place.exists():
        raise BagError(f"{place} does not exist: name a folder of a dataset, or a bag")
    return BagScenes(place) if place.is_file() or is_bag(place) else find_scenes(place)


def _files(scenes: SceneSet) -> list[Path]:
    """All that is read."""
    return scenes.files if isinstance(scenes, BagScenes) else [path for source in scenes for path in source.files]


def _pictures(folder: Path, sets: Iterable[SceneSet], matchers: list[str]) -> Iterator[Path]:
    """All that may be drawn."""
    seen: Counter[str] = Counter()
    for scenes in sets:
        for name in scenes.names if isinstance(scenes, BagScenes) else [source.name for source in scenes]:
            different = _different(name, seen)
            for matcher in matchers:
                yield from _picture_files(folder, different, matcher)


def _picture_files(folder: Path, scene: str, matcher: str) -> tuple[Path, Path]:
    """Of the errors and of the confidence."""
    name = f"{scene.replace('/', '_')}_{matcher}"
    return folder / f"{name}.png", folder / f"{name}_confidence.png"


def _run(
    sets: list[SceneSet],
    matchers: list[str],
    config: MatchingConfig,
    given: list[str],
    draw: Callable[[Scene, Evaluation], None] | None,
) -> tuple[list[dict[str, Any]], list[str]]:
    """A row of figures for each scene and method, and a sentence for each that is left out."""
    rows: list[dict[str, Any]] = []
    left_out: list[str] = []
    total, done = len(matchers) * sum(len(scenes) for scenes in sets), 0
    with progress_bar("evaluating") as progress:
        for source in _with_different_names(sets):
            try:
                scene = source.load()
                check_plausible(scene)
            except StereoDepthError as error:
                left_out.append(f"{source.name} left out: {error}")
                done += len(matchers)
                continue
            for matcher in matchers:
                progress(done, total)
                done += 1
                try:
                    evaluation = evaluate_matcher(source.name, scene, matcher, config, given)
                except StereoDepthError as error:
                    left_out.append(f"{source.name}, {matcher} left out: {error}")
                    continue
                rows.append(evaluation.to_json())
                if draw is not None:
                    draw(scene, evaluation)
    return rows, left_out


def _with_different_names(sets: Iterable[SceneSet]) -> Iterator[SceneSource]:
    """All scenes; those of equal names are numbered."""
    seen: Counter[str] = Counter()
    for scenes in sets:
        for source in scenes:
            yield SceneSource(_different(source.name, seen), source.load)


def _different(name: str, seen: Counter[str]) -> str:
    seen[name] += 1
    return f"{name}#{seen[name]}" if seen[name] > 1 else name


def _draw(folder: Path, overwrite: bool, scene: Scene, evaluation: Evaluation) -> None:
    errors_file, confidence_file = _picture_files(folder, evaluation.scene, evaluation.matcher)
    title = f"{evaluation.scene}: {evaluation.matcher}"
    errors = evaluation.errors
    caption = (
        f"error: bad 1 {errors.bad_1:.1f} %, bad 2 {errors.bad_2:.1f} % of the matched, "
        f"{errors.bad_2_all:.1f} % with holes, mean {errors.avg_px:.2f} px"
    )
    image = error_plot(scene.left, scene.truth_px, evaluation.result.disparity_px, title, caption)
    save_png(errors_file, image, overwrite=overwrite)
    if evaluation.confidence is not None:
        curve = evaluation.confidence.bad_1
        area = f"area {curve.area:.2f}, random {curve.random_area:.2f}, best {curve.oracle_area:.2f}"
        unit = "percent wrong by more than 1 px"
        drawn = curve_plot(curve.error, curve.oracle, errors.density, f"{title}: {area}", unit)
        save_png(confidence_file, drawn, overwrite=overwrite)


def _csv(rows: list[dict[str, Any]]) -> str:
    """One line a row; what is not one value is in the JSON only."""
    columns = [name for name in rows[0] if name not in ("parameters", "curve")]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns, extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
