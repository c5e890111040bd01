import errno
import json
import math
import os
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest

from controller.recording.run_folder import FORMAT, ROOM_BYTES, RecordingError, RunFolder, RunFolderError

STARTED = datetime(2026, 11, 20, 12, 0, 0, tzinfo=UTC)


def made(root, profile="mock/transient"):
    folder = RunFolder.create(root, profile, STARTED)
    folder.write_manifest({"exit": {"status": "running"}})
    return folder


def test_a_folder_is_named_after_time_and_profile_and_two_runs_of_one_second_have_two(tmp_path, monkeypatch):
    folder = made(tmp_path / "runs")
    assert re.fullmatch(r"2026-11-20T12-00-00Z_mock-transient_[0-9a-f]{4}", folder.path.name)
    assert folder.path.is_dir()
    digits = iter(["ab12", "ab12", "ab13"])
    monkeypatch.setattr("secrets.token_hex", lambda _: next(digits))
    first, second = made(tmp_path), made(tmp_path)
    assert (first.path.name[-4:], second.path.name[-4:]) == ("ab12", "ab13")


def test_a_folder_that_cannot_be_made_is_one_clear_line(tmp_path):
    (tmp_path / "runs").write_text("")
    with pytest.raises(RecordingError, match=r"a file is in the way|File exists|Not a directory") as caught:
        made(tmp_path / "runs")
    assert "\n" not in str(caught.value)


def test_the_manifest_is_read_as_it_was_written_and_one_that_cannot_be_replaced_leaves_the_old(tmp_path):
    folder = made(tmp_path)
    loss = {"samples": 0}
    folder.write_manifest({"seed": 7, "loss": loss, "sigma": math.nan, "streams": frozenset({"b", "a"})})
    expected = {"format": FORMAT, "seed": 7, "loss": loss, "sigma": None, "streams": ["a", "b"]}
    assert folder.read_manifest() == expected
    folder = made(tmp_path)
    folder.manifest_path.with_suffix(".json.tmp").symlink_to("/dev/full")
    with pytest.raises(RecordingError, match="No space left"):
        folder.write_manifest({"exit": {"status": "done"}})
    assert folder.read_manifest()["exit"] == {"status": "running"}
    assert [path.name for path in folder.path.iterdir()] == ["manifest.json"], "no empty file is left"


@pytest.mark.parametrize(
    ("number", "first"),
    [
        (errno.ENOSPC, "make room on that disk, or "),
        (errno.EISDIR, "move away what stands there, or "),
        (errno.EMFILE, "allow more open files (ulimit -n), or "),
        (errno.EACCES, ""),
    ],
)
@pytest.mark.parametrize("option", ["--out", "--into", ""])
def test_an_error_of_the_disk_has_its_remedy_and_names_another_place_or_where_no_option_does_a_copy(
    number, first, option
):
    error = RecordingError(Path("runs"), "making", OSError(number, os.strerror(number)), option)
    elsewhere = (
        f"choose another folder with {option}" if option else "copy the run folder to one that may be written"
    )
    assert str(error).startswith(f"recorder: {os.strerror(number)} while making runs; {first}{elsewhere}")


def test_the_room_that_is_kept_for_the_last_manifest_is_released_before_it_is_written(tmp_path, monkeypatch):
    folder = made(tmp_path)
    folder.keep_room()
    room = folder._room
    assert os.fstat(room.fileno()).st_blocks * 512 >= ROOM_BYTES
    assert [path.name for path in folder.path.iterdir()] == ["manifest.json"], "it has no name"
    write, held = folder.write_manifest, []
    watched = lambda manifest: (held.append(not room.closed), write(manifest))  # noqa: E731
    monkeypatch.setattr(folder, "write_manifest", watched)
    folder.end({"exit": {"status": "failed"}})
    assert held == [False]
    assert folder.read_manifest()["exit"] == {"status": "failed"}


@pytest.mark.parametrize("profile", ["p" * 230, "/".join(["é" * 60] * 8) + "/transient"])
def test_a_profile_with_a_long_path_has_a_folder_and_is_found_by_it(tmp_path, profile):
    first, other = made(tmp_path, profile), made(tmp_path, "x" + profile)
    assert len(first.path.name.encode()) < 255
    assert RunFolder.find(f"latest:{profile}", root=tmp_path).path == first.path
    assert RunFolder.find(f"latest:x{profile}", root=tmp_path).path == other.path


@pytest.mark.parametrize("text", ["{name}", "{path}", "{path}/manifest.json", "latest", "transient"])
def test_a_run_is_found_by_path_name_part_or_as_the_latest(tmp_path, text):
    folder = made(tmp_path)
    given = text.format(name=folder.path.name, path=folder.path)
    assert RunFolder.find(given, root=tmp_path).path == folder.path
    assert RunFolder.find(Path(given), root=tmp_path).path == folder.path


def test_what_names_no_run_or_several_is_refused(tmp_path):
    made(tmp_path), made(tmp_path)
    with pytest.raises(RunFolderError, match=r"transient: 2 runs match \(2026"):
        RunFolder.find("transient", root=tmp_path)
    with pytest.raises(RunFolderError, match="nowhere: no such run folder"):
        RunFolder.find("nowhere", root=tmp_path)
    with pytest.raises(RunFolderError, match=r"no run folder, for it has no manifest\.json"):
        RunFolder.find(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"format": 1, "pro', "cut off or damaged"),
        ("[]", "not the manifest of a run"),
        (json.dumps({"name": "something else"}), "not the manifest of a run"),
        (json.dumps({"format": FORMAT + 1}), "format 2, this program reads 1"),
    ],
)
def test_a_manifest_that_is_none_is_refused_in_one_line(tmp_path, content, message):
    folder = made(tmp_path)
    folder.manifest_path.write_text(content)
    with pytest.raises(RunFolderError, match=message) as caught:
        folder.read_manifest()
    assert "\n" not in str(caught.value)


def test_a_resumed_run_writes_over_no_recording(tmp_path):
    folder = made(tmp_path)
    names = []
    for _ in range(11):
        path = folder.new_recording()
        path.touch()
        names.append(path.name)
    assert names[:3] == ["recording.mcap", "recording_2.mcap", "recording_3.mcap"]
    assert [path.name for path in folder.recordings] == names
    (folder.path / "recording_2.mcap").unlink()
    (folder.path / "recording_before.mcap").touch()
    assert [path.name for path in folder.recordings] == [*names[:1], *names[2:]], "a copy is no recording"
    assert folder.new_recording().name == "recording_12.mcap"


def test_a_run_whose_devices_could_not_be_opened_is_never_the_latest(tmp_path):
    first = RunFolder.create(tmp_path, "mock/transient", STARTED)
    first.write_manifest({"exit": {"status": "done"}})
    later = RunFolder.create(tmp_path, "mock/transient", STARTED.replace(year=2027))
    later.write_manifest({"exit": {"status": "running"}})
    assert RunFolder.find("latest", root=tmp_path).path == later.path, "its devices are being opened"
    later.write_manifest({"exit": {"status": "fault"}})
    for text in ("latest", "latest:mock/transient"):
        assert RunFolder.find(text, root=tmp_path).path == first.path
    later.trials_path.write_text("trial,outcome\n")
    assert RunFolder.find("latest", root=tmp_path).path == later.path
