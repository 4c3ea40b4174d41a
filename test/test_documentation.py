# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Generated files agree with the code, what the documents name exists, and none of the tools is distributed."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import parameter_tables
import pytest
from architecture import ORDER, part_of, read_imports, render_files, render_tree, role
from documentation import render_all, replace_section, write_all
from drawing import draw_imports, render_drawing
from parameter_tables import (
    render_launch_table,
    render_matcher_table,
    render_parameter_table,
    render_uniqueness_table,
    render_yaml,
)
from preview_image import TARGET_M, VIEWPOINT_M, draw_cloud
from ruamel.yaml import YAML

from stereo_depth_ros.config import CONFIGS, ParameterInfo, parameter_infos
from stereo_depth_ros.config.matchers import MATCHERS
from stereo_depth_ros.core.errors import ConfigError

ROOT = Path(__file__).resolve().parents[1]


def all_infos() -> list[ParameterInfo]:
    return [info for config in CONFIGS.values() for info in parameter_infos(config)]


GENERATED = (
    "config/stereo_depth.yaml",
    "README.md",
    "docs/parameters.md",
    "docs/ARCHITECTURE.md",
    "docs/architecture.svg",
)


@pytest.fixture(scope="module")
def rendered() -> Mapping[str, str]:
    """What the generated files have to be."""
    return render_all(ROOT)


@pytest.mark.parametrize("path", GENERATED)
def test_generated_files_have_not_drifted(rendered: Mapping[str, str], path: str) -> None:
    assert (ROOT / path).read_text("utf-8") == rendered[path], f"{path} is out of date: run `make config`"


def test_all_generated_files_are_compared(rendered: Mapping[str, str]) -> None:
    assert set(rendered) == set(GENERATED)


def test_yaml_holds_every_default_with_its_type() -> None:
    values = YAML(typ="safe").load(render_yaml())["/**"]["ros__parameters"]
    assert values == {info.name: info.default for info in all_infos()}
    assert {name: type(value) for name, value in values.items()} == {info.name: info.type for info in all_infos()}


def test_no_two_stages_share_a_name() -> None:
    names = [info.name for info in all_infos()]
    assert len(names) == len(set(names))


def test_yaml_names_sentence_range_and_unit() -> None:
    text = render_yaml()
    assert (
        "    # Number of disparities searched.\n    # 32 to 4096 in steps of 16 px\n    disparity_range: 64\n" in text
    )
    assert '    # 32FC1, 16UC1\n    depth_encoding: "32FC1"\n' in text
    assert "    # 1 to 1000; fixed at start\n    queue_size: 5\n" in text
    assert all(info.doc in text for info in all_infos())


def test_table_has_one_row_a_parameter() -> None:
    rows = render_parameter_table().splitlines()[2:]
    assert len(rows) == len(all_infos())
    for row, info in zip(rows, all_infos(), strict=True):
        assert f"| `{info.name}` |" in row
        assert info.doc in row
    texture = "| matching | `texture_threshold` | int | `10` | 0 to 10000 | Minimum sum of absolute prefilter"
    assert any(row.startswith(texture) for row in rows)


def test_table_escapes_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    info = ParameterInfo(name="a", field="a", type=int, default=1, doc="this | that")
    monkeypatch.setattr(parameter_tables, "parameter_infos", lambda stage: [info])
    assert "| this \\| that |" in render_parameter_table()


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


def test_matcher_tables_have_one_row_a_matcher() -> None:
    rows, uniqueness = (table.splitlines()[2:] for table in (render_matcher_table(), render_uniqueness_table()))
    assert rows == [f"| {n} | `{info.name}` | {info.sentence} |" for n, info in enumerate(MATCHERS.values())]
    assert uniqueness == [f"| `{info.name}` | {info.uniqueness or 'no effect'} |" for info in MATCHERS.values()]
    assert rows[2].startswith("| 2 | `sgm` | The default: ") and "three times the percentage" in uniqueness[2]
    assert uniqueness[7].endswith("| no effect |")


def test_launch_table_has_the_arguments_that_are_not_parameters() -> None:
    rows = render_launch_table(ROOT / "launch" / "stereo_depth.launch.py").splitlines()[2:]
    names = [row.split("`")[1] for row in rows]
    assert {"fused", "launch_image_proc", "namespace", "left_namespace", "right_namespace", "health"} < set(names)
    assert not {info.name for info in all_infos()} & set(names)
    assert "| `left_namespace` | `left` | Namespace of the topics of the left camera. |" in rows
    assert "| `namespace` |  | Namespace of the nodes. |" in rows


SECTIONS = {
    "README.md": ("matchers",),
    "docs/parameters.md": ("parameters", "uniqueness", "launch"),
    "docs/ARCHITECTURE.md": ("tree", "files"),
}


def source_tree(root: Path) -> Path:
    """A tree with all declared packages and the places for generated text."""
    for part in ORDER:
        path = root / "stereo_depth_ros" / (f"{part}.py" if part in ("pipeline", "outputs") else f"{part}/__init__.py")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f'"""Role of {part}.\n\nMore of it."""\n')
    (root / "stereo_depth_ros" / "plots" / "two.py").write_text("import stereo_depth_ros.core\n")
    for folder in ("config", "docs", "launch"):
        (root / folder).mkdir()
    (root / "launch" / "stereo_depth.launch.py").write_text('ARGUMENTS = {"fused": ("false", "One node.")}\n')
    for path, names in SECTIONS.items():
        (root / path).write_text("# T\n" + "".join(f"<!-- {name}:begin -->\n<!-- {name}:end -->\n" for name in names))
    return root


def test_tree_has_the_declared_order_and_the_roles_of_the_docstrings(tmp_path: Path) -> None:
    rows = render_tree(source_tree(tmp_path)).splitlines()[2:]
    assert rows[:2] == ["| `core/` | Role of core. |", "| `files/` | Role of files. |"]
    assert "| `pipeline.py` | Role of pipeline. |" in rows
    assert len(rows) == len(ORDER)


def test_every_module_has_a_role() -> None:
    assert not [path for path in (ROOT / "stereo_depth_ros").rglob("*.py") if not role(path).endswith(".")]


def test_files_without_a_docstring_are_not_listed(tmp_path: Path) -> None:
    text = render_files(source_tree(tmp_path))
    assert "| `stereo_depth_ros/plots/__init__.py` | Role of plots. |" in text
    assert "two.py" not in text


def test_drawing_shows_every_import_once_and_right_of_the_names() -> None:
    svg = ElementTree.fromstring(render_drawing(ROOT))
    titles = [element.text for element in svg.iter("{http://www.w3.org/2000/svg}title")]
    pairs = {(part_of(found.importer), part_of(found.imported)) for found in read_imports(ROOT)}
    expected = {f"{a} imports {b}" for a, b in pairs if a and b and a != b}
    assert sorted(title.replace(".py", "") for title in titles if title) == sorted(expected)


def test_drawing_of_three_packages() -> None:
    svg = ElementTree.fromstring(draw_imports(["top", "mid.py", "low"], {(0, 1), (0, 2), (1, 2)}))
    dots = [(int(dot.get("cx", "")), int(dot.get("cy", ""))) for dot in svg.iter("{http://www.w3.org/2000/svg}circle")]
    (x1, y0), (x2, y0_again), (x2_again, y1) = dots
    assert (y0, x2) == (y0_again, x2_again)
    assert x1 < x2 and y0 < y1
    assert [text.text for text in svg.iter("{http://www.w3.org/2000/svg}text")] == ["top", "mid.py", "low"]


def test_a_near_point_of_the_cloud_hides_a_far_one_on_its_ray() -> None:
    at_m = np.array([(TARGET_M - VIEWPOINT_M) * share + VIEWPOINT_M for share in (0.5, 1, 0.9, np.nan)], np.float32)
    colors = np.array([(1, 2, 3), (4, 5, 6), (7, 8, 9), (10, 11, 12)], np.uint8)
    for order in ([0, 1, 2, 3], [3, 2, 1, 0]):
        image = draw_cloud(at_m[None, order], colors[None, order])
        height, width = image.shape[:2]
        np.testing.assert_array_equal(image[height // 2, width // 2], (1, 2, 3))


def test_write_all(tmp_path: Path) -> None:
    write_all(source_tree(tmp_path))
    assert (tmp_path / "config" / "stereo_depth.yaml").read_text() == render_yaml()
    readme, parameters = ((tmp_path / path).read_text() for path in ("README.md", "docs/parameters.md"))
    assert render_parameter_table() in parameters
    assert render_uniqueness_table() in parameters
    assert "| `fused` | `false` | One node. |" in parameters
    assert render_matcher_table() in readme
    assert "| `core/` | Role of core. |" in (tmp_path / "docs" / "ARCHITECTURE.md").read_text()
    assert "<title>plots imports core</title>" in (tmp_path / "docs" / "architecture.svg").read_text()
    assert render_all(tmp_path)["README.md"] == readme  # written again it stays the same
    assert render_all(tmp_path)["docs/parameters.md"] == parameters


DOCUMENTS = ("docs/ARCHITECTURE.md", "CONTRIBUTING.md")


@pytest.mark.parametrize("document", DOCUMENTS)
def test_paths_that_the_documents_name_exist(document: str) -> None:
    text = (ROOT / document).read_text("utf-8")
    named = set(re.findall(r"`([\w./]+(?:\.(?:py|yaml|md)|/))`", text)) | set(re.findall(r"\]\(([^)]+)\)", text))
    assert len(named) > 10
    places = (ROOT, ROOT / "stereo_depth_ros", (ROOT / document).parent)
    assert not sorted(name for name in named if not any((place / name).exists() for place in places))


@pytest.mark.parametrize("document", DOCUMENTS)
def test_make_targets_that_the_documents_name_exist(document: str) -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    targets = set(re.findall(r"(?:`|^)make (\w+)", (ROOT / document).read_text("utf-8"), re.MULTILINE))
    assert {"config", "test"} <= targets
    assert not [target for target in targets if f"\n{target}:" not in makefile]


def test_tools_are_not_distributed(tmp_path: Path) -> None:
    """Neither as a package of the wheel nor in the source distribution."""
    command = [sys.executable, "setup.py", "-q", "egg_info", "--egg-base", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    (info,) = tmp_path.glob("*.egg-info")
    assert (info / "top_level.txt").read_text().split() == ["stereo_depth_ros"]
    sources = (info / "SOURCES.txt").read_text().splitlines()
    assert "stereo_depth_ros/core/errors.py" in sources
    assert not [source for source in sources if source.startswith("tools")]
