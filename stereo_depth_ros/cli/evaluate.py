# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth evaluate`: errors and times of methods on pairs whose truth is known."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from stereo_depth_ros.bags.sources import is_bag
from stereo_depth_ros.cli.output import messages, progress_bar, show
from stereo_depth_ros.cli.tables import evaluation_tables
from stereo_depth_ros.config import MatchingConfig
from stereo_depth_ros.config.values import parse_assignments, pipeline_config
from stereo_depth_ros.core.errors import BagError, ImageError, StereoDepthError
from stereo_depth_ros.evaluation.bag_scenes import BagScenes
from stereo_depth_ros.evaluation.evaluator import Evaluation, evaluate
from stereo_depth_ros.evaluation.plausibility import check_plausible
from stereo_depth_ros.evaluation.scenes import Scene, SceneSet, SceneSource, find_scenes
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.plots.curve import curve_plot
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.error import error_plot

__all__ = ["evaluate_command"]

_EXIT_LEFT_OUT = 3  # some of what was asked for is missing


def evaluate_command(
    places: Annotated[list[Path], typer.Argument(metavar="DIR|BAG...", help="Dataset folders, or bags with truth.")],
    matcher: Annotated[list[str], typer.Option(metavar="NAME", help="Method to evaluate; may be repeated.")],
    param: Annotated[
        list[str] | None, typer.Option("--param", "-p", metavar="NAME:=VALUE", help="A parameter; may be repeated.")
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - is stdout.")
    ] = None,
    csv_file: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the figures as CSV.")] = None,
    images: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Draw left, truth, found and error of each scene into DIR.")
    ] = None,
) -> None:
    """Compare the disparities of methods with the truth, and take their time.

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
    for file in (json_file, csv_file):
        if file is not None and not file.resolve().parent.is_dir():
            raise BagError(f"cannot write {file}: there is no folder {file.parent}: make it, or name another")
    rows, left_out = _run([_scenes(place) for place in places], matcher, config, list(values), images)
    if not rows:
        raise ImageError(f"nothing could be evaluated: {left_out[0]}")
    if csv_file is not None:
        _write_csv(csv_file, rows)
    show(evaluation_tables(rows, "disparity_range" in values, images), rows, json_file)
    for text in left_out:
        messages.print(f"warning: {text}", markup=False)
    if left_out:
        messages.print(f"error: {len(left_out)} left out: see the warnings above")
        raise typer.Exit(_EXIT_LEFT_OUT)


def _scenes(place: Path) -> SceneSet:
    if not place.exists():
        raise BagError(f"{place} does not exist: name a folder of a dataset, or a bag")
    return BagScenes(place) if place.is_file() or is_bag(place) else find_scenes(place)


def _run(
    sets: list[SceneSet], matchers: list[str], config: MatchingConfig, given: list[str], images: Path | None
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
                    evaluation = evaluate(source.name, scene, matcher, config, given)
                except StereoDepthError as error:
                    left_out.append(f"{source.name}, {matcher} left out: {error}")
                    continue
                rows.append(evaluation.to_json())
                if images is not None:
                    _draw(images, scene, evaluation)
    return rows, left_out


def _with_different_names(sets: Iterable[SceneSet]) -> Iterator[SceneSource]:
    """All scenes; those of equal names are numbered."""
    seen: Counter[str] = Counter()
    for scenes in sets:
        for source in scenes:
            seen[source.name] += 1
            number = f"#{seen[source.name]}" if seen[source.name] > 1 else ""
            yield SceneSource(source.name + number, source.load)


def _draw(folder: Path, scene: Scene, evaluation: Evaluation) -> None:
    name = f"{evaluation.scene.replace('/', '_')}_{evaluation.matcher}"
    title = f"{evaluation.scene}: {evaluation.matcher}"
    errors = evaluation.errors
    caption = (
        f"error: bad 1 {errors.bad_1:.1f} %, bad 2 {errors.bad_2:.1f} % of the matched, "
        f"{errors.bad_2_all:.1f} % with holes, mean {errors.avg_px:.2f} px"
    )
    image = error_plot(scene.left, scene.truth_px, evaluation.result.disparity_px, title, caption)
    save_png(folder / f"{name}.png", image)
    if evaluation.confidence is not None:
        curve = evaluation.confidence.bad_1
        area = f"area {curve.area:.2f}, random {curve.random_area:.2f}, best {curve.oracle_area:.2f}"
        unit = "percent wrong by more than 1 px"
        drawn = curve_plot(curve.error, curve.oracle, errors.density, f"{title}: {area}", unit)
        save_png(folder / f"{name}_confidence.png", drawn)


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    """One line a row; what is not one value is in the JSON only."""
    columns = [name for name in rows[0] if name not in ("parameters", "curve")]
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, columns, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)
    except OSError as error:
        raise BagError(f"cannot write {path}: {error.strerror}") from error
