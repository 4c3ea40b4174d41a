# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`stereo-depth evaluate`: errors and computing times of matchers on pairs with ground truth."""

from __future__ import annotations

import csv
import functools
import io
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.bags.projected_sweeps import SensorTopic
from stereo_depth_ros.bags.sources import is_bag
from stereo_depth_ros.camera_files.reading import rig_file_paths
from stereo_depth_ros.cli.camera_info import CameraInfo, CommandWithCameraInfo
from stereo_depth_ros.cli.errors import command_options, error_text
from stereo_depth_ros.cli.evaluate_tables import bias_warnings, evaluate_tables
from stereo_depth_ros.cli.given import check_takes_prior, given_parameters, refuse_files
from stereo_depth_ros.cli.options import Extrinsics, Json, Overwrite, Params, Prior, SideBySide, new_app
from stereo_depth_ros.cli.output import EXIT_INCOMPLETE, parameter_files, progress_bar, show, tell, warn
from stereo_depth_ros.config import MatchingConfig, PairingConfig
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.config.values import pipeline_config
from stereo_depth_ros.core.errors import BagError, ConfigError, StereoDepthError, TopicError
from stereo_depth_ros.diagnosis.opening import open_selection
from stereo_depth_ros.evaluation.bag_scenes import BagScenes
from stereo_depth_ros.evaluation.bag_score import TRUTH_TOPIC
from stereo_depth_ros.evaluation.evaluator import Evaluation
from stereo_depth_ros.evaluation.evaluator import evaluate as evaluate_matcher
from stereo_depth_ros.evaluation.plausibility import check_plausible
from stereo_depth_ros.evaluation.scenes import Scene, SceneSet, SceneSource, find_scenes
from stereo_depth_ros.evaluation.submission import find_submitted, submit
from stereo_depth_ros.evaluation.truth import TruthOption
from stereo_depth_ros.files.output import check_outputs, write_file
from stereo_depth_ros.matching import create_matcher
from stereo_depth_ros.plots.curve import curve_plot
from stereo_depth_ros.plots.drawing import save_png
from stereo_depth_ros.plots.error import error_plot
from stereo_depth_ros.plots.reasons import reason_plot

__all__ = ["app"]

app = new_app()


@app.command(cls=CommandWithCameraInfo)
def evaluate(
    context: typer.Context,
    places: Annotated[
        list[Path], typer.Argument(metavar="DIR|BAG", help="Read these dataset folders, or bags with ground truth.")
    ],
    matcher: Annotated[
        list[str],
        typer.Option(
            metavar="NAME",
            help=f"Evaluate this matcher; the option may be repeated: {', '.join(MATCHERS)}.",
            autocompletion=lambda: [*MATCHERS],
        ),
    ],
    camera_info: CameraInfo = None,
    param: Params = None,
    side_by_side: SideBySide = False,
    truth: Annotated[
        str,
        typer.Option(
            metavar="TOPIC",
            help="Take the truth from this topic of a bag: disparities, or a range sensor, PointCloud2, LaserScan or a "
            "depth Image.",
        ),
    ] = TRUTH_TOPIC,
    prior: Prior = None,
    extrinsics: Extrinsics = None,
    json_file: Json = None,
    csv_file: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the results as CSV.")] = None,
    plots: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Plot truth, disparities, errors, reasons and confidence of scenes."),
    ] = None,
    submission: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Write disparities of all pairs, with and without truth, as the benchmark takes them."
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Compare the disparities of matchers with ground truth, and measure their computing time.

    DIR is a Middlebury scene of 2001 to 2021, an ETH3D two-view scene, a KITTI stereo training folder or one of
    DrivingStereo, Sintel stereo or TartanAir, or a folder that contains such folders up to two levels down; no
    calibration is needed. BAG contains /truth/disparity, as
    written by `convert` and `synthesize`, or the topic of a range sensor that --truth names: its points are projected
    into the left image, without those that the camera does not see, see docs/range_sensor.md.

    The disparity range of a scene is the smallest multiple of 16 (at least 32) above its largest true disparity, the
    same for every matcher, unless it is set by --param disparity_range:=...

    Matchers of several pairs (temporal_window) must have those before each pair, as in a bag.

    With --prior the matcher sgm is guided by the points of another range sensor.

    With --submission the pairs of KITTI stereo, Middlebury and ETH3D, those of test sets too, are matched with the
    range of their calib.txt, or that of disparity_range, and written in the files of their benchmarks: PNG in disp_0,
    or PFM with the time. Pixels without a disparity are 0, which KITTI interpolates, or infinite; fill_holes leaves
    none.

    A median signed error that is large against the spread of the errors is named: the disparities are shifted.

    Pixels near depth edges and on thin structures, where stereo is hardest, have figures of their own.

    "bad x" is the percentage of the matched pixels with truth whose error is above x px; "all" counts pixels without a
    disparity as wrong. In the JSON and CSV files density is a fraction from 0 to 1.

    Exit codes are 0 for success, 1 for an error, 2 for wrong usage and 3 where scenes or matchers were skipped.

    \b
    Examples:
      stereo-depth evaluate Motorcycle-perfect --matcher sgbm
      stereo-depth evaluate middlebury eth3d --matcher bm --matcher sgbm --json scores.json --plots out
      stereo-depth evaluate room.mcap --matcher sgbm --param disparity_range:=128 --param P1:=100
      stereo-depth evaluate drive.mcap --matcher sgm --truth /velodyne_points
      stereo-depth evaluate MiddEval3/testH --matcher sgm --param fill_holes:=true --submission results
    """
    values = given_parameters(param or (), matcher, stages=("matching",))
    _check_options(matcher, plots, csv_file)
    config = pipeline_config(values).matching
    # Reports unknown matchers and invalid parameters before anything runs.
    pair_count = max(create_matcher(name, config).pair_count for name in matcher)
    if prior is not None:
        check_takes_prior(matcher)
    if prior == truth:
        raise ConfigError(
            f"--prior and --truth are both {prior}", value=prior, remedy="compare with another sensor, or leave one out"
        )
    if submission is not None:
        _submit(places, matcher, config, "disparity_range" in values, submission, overwrite)
        places = [place for place in places if _has_truth(place)]
        if not places:
            return
    files = rig_file_paths(camera_info) if camera_info else []
    sensor = None if prior is None else SensorTopic(prior, extrinsics)
    option = TruthOption(truth, extrinsics)
    sets = [
        _scenes(place, side_by_side, camera_info or (), option, sensor, pair_count, config.temporal_gap_ns)
        for place in places
    ]
    inputs = [*files, *(path for scenes in sets for path in _files(scenes)), *parameter_files(None, values)]
    plot_files = list(_plot_files(plots, sets, matcher)) if plots is not None else []
    check_outputs(plot_files, inputs, reports=[json_file, csv_file], overwrite=overwrite)
    plot = functools.partial(_plot, plots, overwrite) if plots is not None else None
    rows, skipped = _run(sets, matcher, config, list(values), plot)
    facts = {str(scenes.path): scenes.facts for scenes in sets if isinstance(scenes, BagScenes) and scenes.facts}
    if not rows:
        raise _nothing(skipped, facts, truth)
    if csv_file is not None:
        write_file(csv_file, _csv(rows), overwrite=overwrite)
    show(evaluate_tables(rows, "disparity_range" in values, plots, facts), rows, json_file, overwrite=overwrite)
    for text in bias_warnings(rows):
        warn(text)
    for error in skipped:
        warn(error_text(error, command_options(context.command)))
    if skipped:
        tell(f"error: {len(skipped)} skipped: see the warnings above")
        raise typer.Exit(EXIT_INCOMPLETE)


def _submit(
    places: list[Path], matchers: list[str], config: MatchingConfig, given: bool, folder: Path, overwrite: bool
) -> None:
    """Write the files of a submission."""
    refuse_files("--submission", folder)
    if len(matchers) > 1:
        raise ConfigError(
            f"--submission takes one matcher, {len(matchers)} are given", value=matchers, limit=1, remedy="name one"
        )
    pairs = [pair for place in places for pair in find_submitted(place)]
    outputs = [path for pair in pairs for path in pair.files(folder, matchers[0])]
    inputs = [path for pair in pairs for path in (pair.left, pair.right, pair.calibration) if path is not None]
    check_outputs(outputs, inputs, overwrite=overwrite)
    seconds = []
    with progress_bar("matching") as progress:
        for number, pair in enumerate(pairs):
            progress(number, len(pairs))
            seconds.append(submit(pair, folder, matchers[0], config, given, overwrite=overwrite))
    tell(f"{folder}: {len(outputs)} files of {len(pairs)} pairs, {1e3 * statistics.median(seconds):.1f} ms a pair")


def _has_truth(place: Path) -> bool:
    try:
        return bool(find_scenes(place))
    except BagError:
        return False


def _check_options(matchers: list[str], plots: Path | None, csv_file: Path | None) -> None:
    refuse_files("--plots", plots)
    if repeated := [name for name, count in Counter(matchers).items() if count > 1]:
        raise ConfigError(f"--matcher {repeated[0]} is given twice", value=repeated, remedy="give it once")
    if str(csv_file) == "-":
        raise ConfigError("--csv - names no file", value="-", remedy="name one, or write JSON by --json -")


def _nothing(skipped: list[StereoDepthError], facts: Mapping[str, str], truth: str) -> StereoDepthError:
    """The error where there is not one result."""
    if skipped:
        return skipped[0].about("nothing could be evaluated")
    return TopicError(
        f"no pair has a truth on {truth}" + "".join(f"; {text}" for text in facts.values()),
        subject="nothing could be evaluated",
        value=0,
        limit=1,
        remedy="record both at the same time, with the same clock",
        settings=("truth",),
    )


def _scenes(
    place: Path,
    side_by_side: bool,
    camera_files: Sequence[Path],
    truth: TruthOption,
    prior: SensorTopic | None,
    pair_count: int,
    gap_ns: int | None,
) -> SceneSet:
    if not place.exists():
        raise BagError("does not exist", subject=str(place), remedy="name a folder of a dataset, or a bag")
    if not place.is_file() and not is_bag(place):
        if side_by_side:
            raise ConfigError(
                "--side-by-side has no effect with a folder", subject=str(place), remedy="leave it out, or name a bag"
            )
        for name, is_given in (
            ("--camera-info", bool(camera_files)),
            ("--truth", truth.topic != TRUTH_TOPIC),
            ("--prior", prior is not None),
            ("--extrinsics", truth.extrinsics is not None),
        ):
            if is_given:
                raise ConfigError(
                    f"{name} has no effect with a folder", subject=str(place), remedy="leave it out, or name a bag"
                )
        return find_scenes(place)
    given = BagSelection(place, side_by_side=side_by_side, camera_files=tuple(camera_files))
    selection, choice = open_selection(given, PairingConfig())
    if choice:
        warn(choice)
    return BagScenes(selection, pair_count, gap_ns, truth, prior)


def _files(scenes: SceneSet) -> list[Path]:
    """All input files."""
    return scenes.files if isinstance(scenes, BagScenes) else [path for source in scenes for path in source.files]


def _plot_files(folder: Path, sets: Iterable[SceneSet], matchers: list[str]) -> Iterator[Path]:
    """All plots that may be written."""
    seen: Counter[str] = Counter()
    for scenes in sets:
        for name in scenes.names if isinstance(scenes, BagScenes) else [source.name for source in scenes]:
            different = _different(name, seen)
            for matcher in matchers:
                yield from _plot_names(folder, different, matcher)


def _plot_names(folder: Path, scene: str, matcher: str) -> tuple[Path, Path, Path]:
    """The plots of the errors, of the confidence against them, and of the reasons."""
    name = f"{scene.replace('/', '_')}_{matcher}"
    return folder / f"{name}.png", folder / f"{name}_confidence.png", folder / f"{name}_reasons.png"


def _run(
    sets: list[SceneSet],
    matchers: list[str],
    config: MatchingConfig,
    given: list[str],
    plot: Callable[[Scene, Evaluation], None] | None,
) -> tuple[list[dict[str, Any]], list[StereoDepthError]]:
    """A row of figures for each scene and matcher, and an error for each that was skipped."""
    rows: list[dict[str, Any]] = []
    skipped: list[StereoDepthError] = []
    total, done = len(matchers) * sum(len(scenes) for scenes in sets), 0
    with progress_bar("evaluating") as progress:
        for source in _with_different_names(sets):
            try:
                scene = source.load()
                check_plausible(scene)
            except StereoDepthError as error:
                skipped.append(error.about(f"{source.name} skipped"))
                done += len(matchers)
                continue
            for matcher in matchers:
                progress(done, total)
                done += 1
                try:
                    evaluation = evaluate_matcher(source.name, scene, matcher, config, given)
                except StereoDepthError as error:
                    skipped.append(error.about(f"{source.name}, {matcher} skipped"))
                    continue
                rows.append(evaluation.to_json())
                if plot is not None:
                    plot(scene, evaluation)
    return rows, skipped


def _with_different_names(sets: Iterable[SceneSet]) -> Iterator[SceneSource]:
    """All scenes; equal names are numbered."""
    seen: Counter[str] = Counter()
    for scenes in sets:
        for source in scenes:
            yield SceneSource(_different(source.name, seen), source.load)


def _different(name: str, seen: Counter[str]) -> str:
    seen[name] += 1
    return f"{name}#{seen[name]}" if seen[name] > 1 else name


def _plot(folder: Path, overwrite: bool, scene: Scene, evaluation: Evaluation) -> None:
    errors_file, confidence_file, reasons_file = _plot_names(folder, evaluation.scene, evaluation.matcher)
    title = f"{evaluation.scene}: {evaluation.matcher}"
    errors = evaluation.errors
    caption = (
        f"error: bad 1 {errors.bad_1:.1f} %, bad 2 {errors.bad_2:.1f} % of the matched pixels, "
        f"{errors.bad_2_all:.1f} % with holes counted, mean {errors.avg_px:.2f} px"
    )
    errors_image = error_plot(scene.left, scene.truth_px, evaluation.result.disparity_px, title, caption)
    save_png(errors_file, errors_image, overwrite=overwrite)
    found = evaluation.result
    save_png(reasons_file, reason_plot(scene.left, found.reasons, found.confidence, title), overwrite=overwrite)
    if evaluation.confidence is not None:
        curve = evaluation.confidence.bad_1
        area = f"area {curve.area:.2f}, random {curve.random_area:.2f}, best {curve.oracle_area:.2f}"
        unit = "percentage with errors above 1 px"
        curve_image = curve_plot(curve.error, curve.oracle, errors.density, f"{title}: {area}", unit)
        save_png(confidence_file, curve_image, overwrite=overwrite)


def _csv(rows: list[dict[str, Any]]) -> str:
    """One line per row; lists and mappings are in the JSON only."""
    columns = [name for name in rows[0] if name not in ("parameters", "curve")]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns, extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
