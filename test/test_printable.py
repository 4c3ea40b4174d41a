# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a terminal obeys is shown as an escape, what is text stays."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from stereo_depth_ros.core.printable import printable

NODES = Path(__file__).resolve().parents[1] / "stereo_depth_ros" / "nodes"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/left/image_raw 3.5 ± 0.1 mm, größer 左", "/left/image_raw 3.5 ± 0.1 mm, größer 左"),
        ("a\x1b[31mb", "a\\x1b[31mb"),
        ("a\x1b]0;title\x07b", "a\\x1b]0;title\\x07b"),
        ("a\rb\bc\nd\te\x7f", "a\\rb\\x08c\\nd\\te\\x7f"),
        ("a\x9b31mb", "a\\x9b31mb"),  # CSI in one byte
        ("a\u202eb\u2066c\u200ed\u2028e", "a\\u202eb\\u2066c\\u200ed\\u2028e"),
        ("a\udcffb", "a\\udcffb"),  # a file name that is not UTF-8
        ("", ""),
    ],
)
def test_printable(text: str, shown: str) -> None:
    assert printable(text) == shown
    shown.encode()  # no error


def test_the_log_of_a_node_is_printable() -> None:
    log = pytest.importorskip("stereo_depth_ros.nodes.log", reason="rclpy is not installed")
    said: list[str] = []
    logger = SimpleNamespace(info=said.append, warning=said.append, error=said.append, fatal=said.append)
    for level in ("info", "warning", "error", "fatal"):
        getattr(log, f"log_{level}")(logger, f"{level}: frame \x1b[31mleft\r\n  at line 3")
    assert said == [f"{level}: frame \\x1b[31mleft\\r\n  at line 3" for level in ("info", "warning", "error", "fatal")]


def test_nodes_log_in_one_place_only() -> None:
    direct = re.compile(r"get_logger\([^)]*\)\.(debug|info|warn|warning|error|fatal)\(")
    assert not [path.name for path in NODES.rglob("*.py") if direct.search(path.read_text("utf-8"))]
