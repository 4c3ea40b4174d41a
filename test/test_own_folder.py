# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The folder of a program that writes when it is asked to: fixed at its start, numbered, and without links."""

from __future__ import annotations

from pathlib import Path

import pytest

from stereo_depth_ros.core.errors import ConfigError, OutputError
from stereo_depth_ros.files import own_folder
from stereo_depth_ros.files.own_folder import OwnFolder

NAMES = ("left.yaml", "report.txt")


@pytest.mark.parametrize("text", ["~nosuchuser/x", "", " ", "a\0b", "a\x1b[2Jb", "a\nb"])
def test_what_is_not_a_path_is_refused_at_the_start(text: str) -> None:
    with pytest.raises(ConfigError, match=r"folder = '.* is not the path of a folder: write another one") as caught:
        OwnFolder(text, "folder")
    assert caught.value.settings == ("folder",) and str(caught.value).isprintable()


def test_a_loop_of_links_is_refused_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises(ConfigError, match="is not the path of a folder"):
        OwnFolder(str(tmp_path / "a" / "c"), "folder")


def test_home_and_links_are_resolved_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "other").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "link").symlink_to(tmp_path / "home")
    for text in ("~/out", str(tmp_path / "link" / "out")):
        assert OwnFolder(text, "folder").place(NAMES) == tmp_path / "home" / "out"
    linked = OwnFolder(str(tmp_path / "link" / "out"), "folder")
    monkeypatch.setenv("HOME", str(tmp_path / "other"))
    (tmp_path / "link").unlink()
    (tmp_path / "link").symlink_to(tmp_path / "other")
    assert linked.place(NAMES) == tmp_path / "home" / "out"


def test_each_set_of_files_has_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = OwnFolder(str(tmp_path / "out"), "folder")
    for expected in (tmp_path / "out", tmp_path / "out" / "2", tmp_path / "out" / "3"):
        place = folder.place(NAMES)
        assert place == expected
        place.mkdir(parents=True, exist_ok=True)
        (place / NAMES[1]).write_text("")
    assert folder.place(NAMES, overwrite=True) == tmp_path / "out"
    monkeypatch.setattr(own_folder, "_MOST", 3)
    with pytest.raises(OutputError, match="out: holds 3 sets of files: remove some of them"):
        folder.place(NAMES)


def test_no_link_is_followed(tmp_path: Path) -> None:
    folder = OwnFolder(str(tmp_path / "out"), "folder")
    (tmp_path / "other").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "other")
    with pytest.raises(OutputError, match="out: is a link, which is not followed"):
        folder.place(NAMES)
    (tmp_path / "out").unlink()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / NAMES[0]).symlink_to("/dev/null")
    with pytest.raises(OutputError, match=r"left\.yaml: is a link"):
        folder.place(NAMES, overwrite=True)
    (tmp_path / "out" / "2").symlink_to(tmp_path / "other")
    with pytest.raises(OutputError, match="2: is a link"):
        folder.place(NAMES)
