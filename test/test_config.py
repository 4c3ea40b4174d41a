# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: defaults of the contract, and every check of a value."""

from __future__ import annotations

import pytest

from stereo_depth_ros.config import (
    CONFIGS,
    DepthConfig,
    MatchingConfig,
    PairingConfig,
    PointConfig,
    parameter_infos,
    replace_checked,
)
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.config.values import parse_assignments
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.replay.options import ReplayOptions

# Name, default, low, high, step: as stereo_image_proc of Jazzy declares them.
CONTRACT = {
    "stereo_algorithm": (0, 0, 1, None),
    "prefilter_size": (9, 5, 255, 2),
    "prefilter_cap": (31, 1, 63, None),
    "correlation_window_size": (15, 5, 255, 2),
    "min_disparity": (0, -2048, 2048, None),
    "disparity_range": (64, 32, 4096, 16),
    "texture_threshold": (10, 0, 10000, None),
    "speckle_size": (100, 0, 1000, None),
    "speckle_range": (4, 0, 31, None),
    "disp12_max_diff": (0, 0, 128, None),
    "sgbm_mode": (0, 0, 3, None),
    "uniqueness_ratio": (15.0, 0.0, 100.0, None),
    "P1": (200.0, 0.0, 4000.0, None),
    "P2": (400.0, 0.0, 4000.0, None),
}
# Differences of this package: more methods, another default, smaller windows.
WIDER = {
    "stereo_algorithm": (2, 0, len(MATCHERS) - 1, None),
    "correlation_window_size": (15, 1, 255, 2),
}


def test_matcher_parameters_are_those_of_the_contract() -> None:
    ours = {i.name: (i.default, i.low, i.high, i.step) for i in parameter_infos(MatchingConfig) if i.name in CONTRACT}
    assert ours == CONTRACT | WIDER
    assert {n: type(v[0]) for n, v in ours.items()} == {n: type(v[0]) for n, v in CONTRACT.items()}


def test_every_value_of_the_contract_is_accepted() -> None:
    infos = {i.name: i for i in parameter_infos(MatchingConfig)}
    for name, (default, low, high, _) in CONTRACT.items():
        assert [infos[name].check(value) for value in (default, low, high)] == [default, low, high]
    original = {name: values[0] for name, values in CONTRACT.items()}
    assert replace_checked(MatchingConfig(), original).stereo_algorithm == 0


def test_other_parameters_of_the_contract() -> None:
    defaults = {i.name: i.default for config in (PairingConfig, PointConfig) for i in parameter_infos(config)}
    assert defaults == {
        "queue_size": 5,
        "approximate_sync": False,
        "approximate_sync_tolerance_seconds": 0.0,
        "image_transport": "raw",
        "avoid_point_cloud_padding": False,
        "use_color": True,
    }


def test_names_are_unique_over_all_stages_and_documented() -> None:
    infos = [info for config in CONFIGS.values() for info in parameter_infos(config)]
    assert len({info.name for info in infos}) == len(infos)
    assert all(info.doc.endswith(".") for info in infos)


def test_parameters_that_name_files_are_fixed_at_the_start() -> None:
    """Any participant of the graph may change the others."""
    infos = {info.name: info for config in (*CONFIGS.values(), ReplayOptions) for info in parameter_infos(config)}
    texts = {name for name, info in infos.items() if info.type is str and not info.choices and info.run_time}
    assert texts == set()
    assert not infos["overwrite"].run_time
    assert {"onnx_model", "calibration_folder", "bag", "output"} <= infos.keys()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"disparity_range": 70}, r"disparity_range = 70 is not 32 plus a multiple of 16: use 64 or 80"),
        ({"disparity_range": 16}, r"disparity_range = 16 is outside 32\.\.4096"),
        ({"correlation_window_size": 14}, r"correlation_window_size = 14 .* use 13 or 15"),
        ({"uniqueness_ratio": float("nan")}, r"uniqueness_ratio = nan"),
        ({"P1": "200"}, r"P1 = '200' is text, not a number: write a number, for example 200.0"),
        ({"stereo_algorithm": True}, r"stereo_algorithm = true is true or false, not a whole number"),
        ({"disparity_rage": 64}, r"unknown parameter 'disparity_rage': did you mean 'disparity_range'"),
        ({"stereo_algorithm": 1, "P1": 500.0, "P2": 400.0}, r"P2 = 400 is not above P1 = 500: raise P2 or lower P1"),
    ],
)
def test_errors_name_value_limit_and_remedy(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        replace_checked(MatchingConfig(), changes)
    assert caught.value.value in (*changes, *changes.values()) or caught.value.value != caught.value.value  # NaN
    assert caught.value.limit is not None
    assert caught.value.remedy


def test_choices_are_named() -> None:
    with pytest.raises(ConfigError, match=r"depth_encoding = '8UC1' is not one of 32FC1, 16UC1"):
        DepthConfig(depth_encoding="8UC1")


def test_choice_that_yaml_reads_as_a_boolean_is_accepted() -> None:
    assert parse_assignments(["anaglyph_method:=true"]) == {"anaglyph_method": "true"}
    with pytest.raises(ConfigError, match="anaglyph_method = false is true or false, not text"):
        parse_assignments(["anaglyph_method:=false"])


def test_integers_are_accepted_as_floats_and_both_names_as_keys() -> None:
    config = replace_checked(MatchingConfig(), {"P1": 8, "disparity_range": 96})
    assert (config.P1, type(config.P1), config.num_disparities) == (8.0, float, 96)
    assert replace_checked(config, {"num_disparities": 48, "min_disparity": -16}).max_disparity == 31


@pytest.mark.parametrize(
    ("config", "tolerance_ns"),
    [
        (PairingConfig(), 0),
        (PairingConfig(approximate_sync_tolerance_seconds=0.5), 0),
        (PairingConfig(approximate_sync=True), None),
        (PairingConfig(approximate_sync=True, approximate_sync_tolerance_seconds=0.002), 2_000_000),
    ],
)
def test_tolerance_of_pairing(config: PairingConfig, tolerance_ns: int | None) -> None:
    assert config.tolerance_ns == tolerance_ns
