# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Output files: inputs and existing files are protected, and incomplete files do not appear."""

from __future__ import annotations

import os
import resource
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.files import output as output_files
from stereo_depth_ros.files.output import OutputFile, check_outputs, write_file


@contextmanager
def small_disk() -> Iterator[None]:
    """Files of this process are limited to 10 000 bytes, the log of the tests too: for a few lines only."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    with OutputFile(tmp_path / "a") as output:
        output.file.write(b"one")
        output.file.flush()
        (temporary,) = names(tmp_path)
        assert temporary.startswith(".") and temporary.endswith(".partial")
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_bytes() == b"one"


def test_temporary_names_are_unique(tmp_path: Path) -> None:
    outputs = [OutputFile(tmp_path / "a") for _ in range(10)]
    assert len(set(names(tmp_path))) == 10
    assert all(len(name) > 16 for name in names(tmp_path))
    for output in outputs:
        output.discard()
    assert names(tmp_path) == []


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_permissions_follow_the_umask(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        write_file(tmp_path / "a", "text")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o666 & ~mask


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, SystemExit])
def test_exception_keeps_the_existing_file(tmp_path: Path, error: type[BaseException]) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(error), OutputFile(tmp_path / "a", overwrite=True) as output:
        output.file.write(b"new")
        raise error
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "old"


def test_unfinished_output_is_removed(tmp_path: Path) -> None:
    output = OutputFile(tmp_path / "a")
    output.file.write(b"one")
    del output
    assert names(tmp_path) == []


def test_existing_file_is_replaced_with_overwrite_only(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(OutputError, match=r"a: already exists: remove it, write to another file, or allow overwriting"):
        write_file(tmp_path / "a", "new")
    assert (tmp_path / "a").read_text() == "old"
    write_file(tmp_path / "a", "new", overwrite=True)
    assert (tmp_path / "a").read_text() == "new"
    assert names(tmp_path) == ["a"]


@pytest.mark.parametrize("hard_links", [True, False])
def test_file_created_meanwhile_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hard_links: bool) -> None:
    if not hard_links:

        def refuse(*_: object) -> None:
            raise PermissionError(1, "Operation not permitted")

        monkeypatch.setattr(output_files.os, "link", refuse)
        write_file(tmp_path / "b", "fine")
        assert (tmp_path / "b").read_text() == "fine"
        (tmp_path / "b").unlink()
    with pytest.raises(OutputError, match="a"), OutputFile(tmp_path / "a") as output:
        output.file.write(b"new")
        (tmp_path / "a").write_text("of another")
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "of another"


def test_links_are_not_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "good").write_text("good")
    (tmp_path / "link").symlink_to("good")
    with pytest.raises(OutputError, match="link: already exists"):
        write_file(tmp_path / "link", "new")
    write_file(tmp_path / "link", "new", overwrite=True)
    assert (tmp_path / "good").read_text() == "good"
    assert (tmp_path / "link").read_text() == "new"
    (tmp_path / "nowhere").symlink_to("none")
    with pytest.raises(OutputError, match="nowhere: already exists"):
        write_file(tmp_path / "nowhere", "new")
    # an attacker guessed the temporary name and put a link there
    monkeypatch.setattr(output_files.secrets, "token_hex", lambda count: "guessed")
    (tmp_path / ".guessed.partial").symlink_to("good")
    with pytest.raises(OutputError, match="it exists already: write to another file"):
        write_file(tmp_path / "b", "new")
    assert (tmp_path / "good").read_text() == "good"


def test_full_disk_is_reported_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    text = r"/a: cannot be written: the file is too large for the disk: free space on the disk"
    with pytest.raises(OutputError, match=text), small_disk():
        write_file(tmp_path / "a", b"1" * 20_000, overwrite=True)
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "old"


def test_device_is_written_directly() -> None:
    write_file(Path(os.devnull), "text", overwrite=True)
    assert stat.S_ISCHR(Path(os.devnull).stat().st_mode)
    check_outputs((), reports=[Path(os.devnull), Path(os.devnull)])
    with pytest.raises(OutputError, match=r"/dev/full: cannot be written: the disk is full: free space on the disk"):
        write_file(Path("/dev/full"), "text")


def test_folders_are_created_with_make_folders_only(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="its folder does not exist"):
        write_file(tmp_path / "x" / "y" / "a", "text")
    write_file(tmp_path / "x" / "y" / "a", "text", make_folders=True)
    assert (tmp_path / "x" / "y" / "a").read_text() == "text"


def test_input_under_any_name_is_refused(tmp_path: Path) -> None:
    read = tmp_path / "in"
    read.write_text("in")
    (tmp_path / "soft").symlink_to("in")
    (tmp_path / "hard").hardlink_to(read)
    (tmp_path / "folder").mkdir()
    for name in ("in", "soft", "hard", "folder/../in"):
        for overwrite in (False, True):
            with pytest.raises(OutputError, match=r"would overwrite an input: write to another file"):
                check_outputs([tmp_path / name], [tmp_path / "none", read], overwrite=overwrite)
    check_outputs([tmp_path / "other"], [read])


def test_outputs_are_checked_before_anything_is_written(tmp_path: Path) -> None:
    (tmp_path / "there").write_text("old")
    for outputs, reports, text in (
        ([tmp_path / "there"], [], "there: already exists: .*allow overwriting"),
        ([], [tmp_path / "there"], "there: already exists: .*allow overwriting"),
        ([tmp_path], [], "it is a folder"),
        ([tmp_path / "there" / "a"], [], "there/a: cannot be written"),
        (
            [],
            [tmp_path / "none" / "a"],
            "none/a: cannot be written: folder .*none does not exist: create it, or",
        ),
        ([tmp_path / "a"], [tmp_path / "x" / ".." / "a"], "folder .* does not exist"),
        ([tmp_path / "a"], [tmp_path / "a"], "a: two outputs have this name: give each a different name"),
        ([tmp_path / ("a" * 300)], [], "its name is too long"),
        ([Path("/proc/none/a")], [], "/proc/none/a: cannot be written"),
    ):
        with pytest.raises(OutputError, match=text):
            check_outputs(outputs, reports=reports)
    check_outputs([tmp_path / "new" / "folder" / "a"], reports=[None, Path("-"), tmp_path / "b"])
    check_outputs([tmp_path / "there"], overwrite=True)
    assert names(tmp_path) == ["there"]


def test_errors_carry_their_fields(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(OutputError) as caught:
        write_file(tmp_path / "a", "new")
    assert (caught.value.subject, caught.value.settings) == (str(tmp_path / "a"), ("overwrite",))
    assert "--" not in str(caught.value)
    with pytest.raises(OutputError) as caught:
        check_outputs([tmp_path])
    assert (caught.value.subject, caught.value.remedy) == (str(tmp_path), "name a file")


def test_an_interrupt_while_a_file_is_created_finds_it_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "open", interrupted)
    with output_files.recorded_outputs() as outputs, pytest.raises(KeyboardInterrupt):
        OutputFile(tmp_path / "a")
    (output,) = outputs
    output.discard()
    assert output.path == tmp_path / "a" and not output.complete


def test_a_file_that_cannot_be_created_is_not_recorded(tmp_path: Path) -> None:
    with output_files.recorded_outputs() as outputs, pytest.raises(OutputError):
        OutputFile(tmp_path / "missing" / "a")
    assert outputs == []
