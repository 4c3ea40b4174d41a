# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The parameter file and the README's tables say what the code says."""

from __future__ import annotations

from pathlib import Path

import documentation
import pytest
from documentation import render_files, render_table, render_yaml, replace_section, write_files
from ruamel.yaml import YAML

from stereo_depth_ros.config import CONFIGS, ParameterInfo, parameter_infos
from stereo_depth_ros.core.errors import ConfigError

ROOT = Path(__file__).resolve().parents[1]


def all_infos() -> list[ParameterInfo]:
    return [info for config in CONFIGS.values() for info in parameter_infos(config)]


def test_files_have_not_drifted() -> None:
    assert (ROOT / "config" / "stereo_depth.yaml").read_text("utf-8") == render_yaml(), "run `make config`"
    readme = (ROOT / "README.md").read_text("utf-8")
    assert replace_section(readme, "parameters", render_table()) == readme, "run `make config`"
    assert replace_section(readme, "files", render_files(ROOT)) == readme, "run `make config`"


def test_yaml_holds_every_default_with_its_type() -> None:
    values = YAML(typ="safe").load(render_yaml())["/**"]["ros__parameters"]
    assert values == {info.name: info.default for info in all_infos()}
    assert {name: type(value) for name, value in values.items()} == {info.name: info.type for info in all_infos()}


def test_no_two_stages_share_a_name() -> None:
    names = [info.name for info in all_infos()]
    assert len(names) == len(set(names))


def test_yaml_says_sentence_range_and_unit() -> None:
    text = render_yaml()
    assert (
        "    # Number of disparities searched.\n    # 32 to 4096 in steps of 16 px\n    disparity_range: 64\n" in text
    )
    assert '    # 32FC1, 16UC1\n    depth_encoding: "32FC1"\n' in text
    assert "    # 1 to 1000; fixed at start\n    queue_size: 5\n" in text
    assert all(info.doc in text for info in all_infos())


def test_table_has_one_row_a_parameter() -> None:
    rows = render_table().splitlines()[2:]
    assert len(rows) == len(all_infos())
    for row, info in zip(rows, all_infos(), strict=True):
        assert f"| `{info.name}` |" in row
        assert info.doc in row
    texture = "| matching | `texture_threshold` | int | `10` | 0 to 10000 | Minimum sum of absolute prefilter"
    assert any(row.startswith(texture) for row in rows)


def test_table_escapes_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    info = ParameterInfo(name="a", field="a", type=int, default=1, doc="this | that")
    monkeypatch.setattr(documentation, "parameter_infos", lambda stage: [info])
    assert "| this \\| that |" in render_table()


def test_replace_section_keeps_what_is_around() -> None:
    text = "before\n<!-- x:begin -->\nold\n<!-- x:end -->\nafter <!-- y:begin -->\n"
    assert (
        replace_section(text, "x", "new") == "before\n<!-- x:begin -->\nnew\n<!-- x:end -->\nafter <!-- y:begin -->\n"
    )


@pytest.mark.parametrize(
    "text",
    [
        "no markers",
        "<!-- x:begin --> never ends",
        "<!-- x:end --> before <!-- x:begin -->",
        "<!-- x:begin --><!-- x:end --><!-- x:begin --><!-- x:end -->",
    ],
)
def test_replace_section_wants_one_pair_of_markers(text: str) -> None:
    with pytest.raises(ConfigError, match=r"<!-- x:begin --> and . x <!-- x:end -->: the text needs one of each"):
        replace_section(text, "x", "new")


README = "# R\n<!-- parameters:begin -->\n<!-- parameters:end -->\n<!-- files:begin -->\n<!-- files:end -->\n"


def test_write_files(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "README.md").write_text(README)
    (tmp_path / "stereo_depth_ros").mkdir()
    (tmp_path / "stereo_depth_ros" / "one.py").write_text('"""Says one thing.\n\nMore of it."""\n')
    write_files(tmp_path)
    assert (tmp_path / "config" / "stereo_depth.yaml").read_text() == render_yaml()
    readme = (tmp_path / "README.md").read_text()
    assert render_table() in readme
    assert "| `stereo_depth_ros/one.py` | Says one thing. |" in readme
