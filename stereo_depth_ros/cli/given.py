# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Options and parameters given on the command line have an effect: those that have none, or contradict, are refused."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from stereo_depth_ros.config import CONFIGS, MatchingConfig, parameter_infos
from stereo_depth_ros.config.matchers import MATCHERS, matchers_with
from stereo_depth_ros.config.values import Value, parse_assignments
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.datasets.image_files import IMAGE_SUFFIXES

__all__ = [
    "PIPELINE",
    "check_takes_prior",
    "given_parameters",
    "is_given",
    "refuse_files",
    "refuse_ignored",
    "require_png",
]

# The stages whose parameters have an effect on the outputs of process and replay
PIPELINE = ("pairing", "camera_info", "matching", "depth", "cloud", "rectification")
_MATCHER = "stereo_algorithm"
_NO_FOLDER = (*IMAGE_SUFFIXES, ".yaml", ".yml", ".json", ".txt", ".csv", ".mcap", ".bag", ".db3")
# Parameters that have an effect only where another one has this value
_CONDITIONS: Mapping[str, tuple[str, Value]] = {
    "approximate_sync_tolerance_seconds": ("approximate_sync", True),
    "max_difference": ("window_cost", "sad"),
    "correction_limit": ("auto_correct", True),
    "reference_yaw": ("correct_yaw", True),
    "convergence": ("auto_convergence", False),
}
# Parameters of stereo_image_proc and of the nodes that no command uses
_NEVER: Mapping[str, str] = {
    "image_transport": "the bag holds one kind of images",
    "prefilter_size": "the Sobel prefilter has no window",
    "disparity_sigma_px": "no output contains the uncertainty of the depth",
}


def is_given(context: typer.Context, name: str) -> bool:
    """Whether an option is on the command line; ``name`` is that of the argument of the function."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def refuse_ignored(context: typer.Context, names: Iterable[str], reason: str, remedy: str) -> None:
    """Refuse options that have no effect.

    Args:
        context: of the command.
        names: arguments of the function of the command.
        reason: why they have none, such as "with a bag".
        remedy: what to do instead.

    Raises:
        ConfigError: one of them is given.
    """
    for name in names:
        if is_given(context, name):
            option = next(each.opts[0] for each in context.command.params if each.name == name)
            raise ConfigError(f"{option} has no effect {reason}", value=option, remedy=remedy)


def refuse_files(option: str, folder: Path | None) -> None:
    """Refuse the name of a file for a folder that will be made.

    Raises:
        ConfigError: a name such as out.png, where no folder of that name is there.
    """
    if folder is not None and folder.suffix.lower() in _NO_FOLDER and not folder.is_dir():
        raise ConfigError(
            f"{option} {folder} is the name of a file, a folder is written",
            value=str(folder),
            remedy=f"name it {folder.with_suffix('')}",
        )


def require_png(option: str, path: Path | None) -> None:
    """Refuse another suffix than that of PNG files.

    Raises:
        ConfigError: another one.
    """
    if path is not None and path.suffix.lower() != ".png":
        raise ConfigError(
            f"{option} {path} does not end in .png, plots are written as PNG",
            value=path.suffix,
            limit=".png",
            remedy=f"name it {path.stem or 'plot'}.png",
        )


def check_takes_prior(matchers: Iterable[str]) -> None:
    """Raise ConfigError if one of these matchers cannot use ``--prior``."""
    for name in matchers:
        if not MATCHERS[name].takes_prior:
            raise ConfigError(
                f"--prior has no effect with {name}, which takes no prior",
                value=name,
                remedy="use a matcher that does, sgm",
                settings=("matcher",),
            )


def given_parameters(
    texts: Sequence[str],
    matcher: str | Sequence[str] | None = None,
    *,
    file: Mapping[str, Value] | None = None,
    stages: Collection[str] = PIPELINE,
    names: Collection[str] = (),
    remedies: Mapping[str, str] | None = None,
) -> dict[str, Value]:
    """The checked values of ``--param`` and ``--matcher``, all of which must have an effect.

    The values of a parameter file need not have one: a file may serve other matchers and nodes.

    Args:
        texts: the values of ``--param``.
        matcher: that of ``--matcher``; or several, each of which is used by itself.
        file: other values, such as those of the parameter file, which these override.
        stages: names of the stages in ``CONFIGS`` whose parameters have an effect.
        names: further parameters that have an effect.
        remedies: what to do about parameters of other stages, by the name of the stage.

    Raises:
        ConfigError: a text of another form, an unknown name, an invalid value; a parameter that is given twice, that
            contradicts ``--matcher``, or that has no effect.
    """
    _refuse_repeated(texts)
    several = () if matcher is None or isinstance(matcher, str) else matcher
    given = parse_assignments(texts)
    chosen = parse_assignments((), matcher if isinstance(matcher, str) else None)
    if several and _MATCHER in given:
        raise _no_effect(_MATCHER, "the matchers are those of --matcher", "leave it out")
    if chosen and given.get(_MATCHER, chosen[_MATCHER]) != chosen[_MATCHER]:
        other = [*MATCHERS][int(given[_MATCHER])]
        raise ConfigError(
            f"--matcher {matcher} and --param {_MATCHER}:={given[_MATCHER]}, which is {other}, contradict each other",
            value=other,
            limit=matcher,
            remedy="give one of them",
        )
    values = {**(file or {}), **given, **chosen}
    matchers = several or [[*MATCHERS][int(values.get(_MATCHER, MatchingConfig().stereo_algorithm))]]
    for name in given:
        _check_stage(name, stages, names, remedies or {})
        _check_matchers(name, matchers, values)
        _check_condition(name, values)
    return {**given, **chosen}


def _refuse_repeated(texts: Sequence[str]) -> None:
    seen: dict[str, str] = {}
    for text in texts:
        name, _, value = text.partition(":=")
        if seen.setdefault(name, value) != value:
            raise ConfigError(
                f"parameter {name} is given twice, as {seen[name]} and as {value}", value=value, remedy="give it once"
            )


def _check_stage(name: str, stages: Collection[str], names: Collection[str], remedies: Mapping[str, str]) -> None:
    stage = next(stage for stage, config in CONFIGS.items() if any(i.name == name for i in parameter_infos(config)))
    if name in names:
        return
    if stage not in stages:
        remedy = remedies.get(stage, "leave it out")
        raise _no_effect(name, f"it is a parameter of {_PARTS[stage]}, which this command does not run", remedy)
    if name in _NEVER:
        raise _no_effect(name, _NEVER[name], "leave it out")


def _check_matchers(name: str, matchers: Sequence[str], values: Mapping[str, Any]) -> None:
    users = matchers_with(name)
    if name.startswith("onnx_") and values.get("sgm_cost") != "onnx":
        users = tuple(user for user in users if user != "sgm")
    if users and not set(users) & set(matchers):
        reason = f"the matcher is {' and '.join(matchers)}, which does not use it"
        raise _no_effect(name, reason, f"leave it out, or choose {_either(users)} by --matcher")


def _check_condition(name: str, values: Mapping[str, Any]) -> None:
    if name not in _CONDITIONS:
        return
    other, needed = _CONDITIONS[name]
    default = next(i.default for config in CONFIGS.values() for i in parameter_infos(config) if i.name == other)
    if values.get(other, default) != needed:
        wanted = str(needed).lower()
        raise _no_effect(name, f"it is used only where {other} is {wanted}", f"add --param {other}:={wanted}")


_PARTS: Mapping[str, str] = {
    "pairing": "the pairing",
    "camera_info": "the camera infos",
    "matching": "the matchers",
    "depth": "the depth image",
    "cloud": "the point cloud",
    "rectification": "the rectification",
    "health": "calibration_monitor",
    "calibration": "calibration_node",
    "structured_light": "structured_light_node",
    "light_stripe": "light stripe scanning",
    "stripe_motion": "light_stripe_node",
    "view": "the views",
}


def _no_effect(name: str, reason: str, remedy: str) -> ConfigError:
    return ConfigError(f"parameter {name} has no effect: {reason}", value=name, remedy=remedy)


def _either(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
