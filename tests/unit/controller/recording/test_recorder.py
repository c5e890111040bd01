import json
import threading
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from behaviors.events import Contact, GuardStopped
from controller.export import tidy
from controller.limits import GuardSettings
from controller.recording import disk
from controller.recording.layouts import FOXGLOVE, PLOTJUGGLER, write_layouts
from controller.recording.mcap_file import McapWriter
from controller.recording.reader import open_run
from controller.recording.recorder import Recorder
from controller.recording.run_folder import RecordingError, RunFolder, RunFolderError
from controller.recording.series import BIN_S, PLOT_S
from controller.recording.stream_writer import StreamWriter
from controller.recording.trial_rows import read_rows
from drivers.core.messages import MoveAt, Refused, SampleBlock, Stop, StreamInfo
from tests.refusals import refused

START = datetime(2026, 11, 20, 12, 0, 0, tzinfo=UTC)
STREAMS = {
    "board.load_cell": StreamInfo("board.load_cell", ("force",), "N", 1e-5, 1000.0),
    "board.period": StreamInfo("board.period", ("period",), "s", 1e-6),
}

SAVED = {
    "root": {("tabbed_widget", "name", "parent")},
    "tabbed_widget": {("Tab", "containers", "tab_name")},
    "Tab": {("Container",)},
    "Container": {("DockSplitter", "count", "orientation", "sizes")},
    "DockSplitter": {("DockArea", "name")},
    "DockArea": {("plot", "mode", "style")},
    "plot": {("curve", "color", "name")},
    "curve": set(),
}
"""What stands in what, with which attributes, in layouts that PlotJuggler saved and openpilot published
(tools/plotjuggler/layouts); what these have besides (range, limitY, currentTabIndex) its loader does without."""


def folder_at(root):
    folder = RunFolder.create(root, "mock/transient", START)
    folder.write_manifest({"bench": "mock", "exit": {"status": "running"}})
    return folder


def recorder_in(folder):
    return Recorder(folder, START, streams=STREAMS, factors=["location"], measures=["delay_s", "force_n"])


def load_cell(seq, count=10):
    values = (np.arange(seq, seq + count) ** 2 - 17).astype(np.int32).reshape(-1, 1)
    t_s = seq / 1000
    return SampleBlock("board.load_cell", seq, t_s, values, 1000.0, None, "N", 1e-5, 5.0 + t_s, t_s + 0.02)


def periods(seq, times_s):
    values = np.full((len(times_s), 1), 35714, np.int64)
    return SampleBlock("board.period", seq, times_s[0], values, None, np.array(times_s), "s", 1e-6)


def begun(folder):
    """A recorder with a trial under way, and the trial's recording."""
    recorder = recorder_in(folder)
    return recorder, recorder.begin_trial(1, {"location": "f"}, 0.0)


CONTACT = Contact(1.03, "contact", 30.0, 29.0)


def record_two_trials(recorder):
    kept = []
    for trial, offset_s in ((4, 0.0), (2, 100.0)):
        kept.append(recorder.begin_trial(trial, {"location": "f"}, offset_s))
        recorder.skip("board.load_cell", 0.0, 1.0)
        recorder.record([load_cell(1000 + trial), periods(3, [1.01, 1.046])])
        recorder.record([load_cell(1020 + trial)])
        recorder.event(CONTACT, state="APPROACH", next_state="STOPPING", commands=[Stop("stage")])
        recorder.end_trial("contact", {"delay_s": 0.2, "force_n": 0.05})
    return kept


@pytest.fixture
def folder(tmp_path):
    return folder_at(tmp_path)


@pytest.fixture
def kept(folder):
    """Two trials in the folder, as they were in memory."""
    recorder = recorder_in(folder)
    kept = record_two_trials(recorder)
    recorder.close()
    recorder.close()  # may be done twice
    return kept


def messages_of(folder, topic=None):
    """Channel, message and its content, as the library's own reader finds them."""
    with folder.recordings[0].open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return [found[1:] for found in reader.iter_decoded_messages(topics=topic)]


def test_what_is_read_again_is_what_the_trial_had_in_memory(folder, kept):
    run = open_run(folder.path)
    assert list(run.recorded_trials) == [2, 4]
    for memory in kept:
        disk = run.trial(memory.trial)
        assert disk.factors == {"location": "f"}
        assert disk.streams == memory.streams == ["board.load_cell", "board.period"]
        for name in memory.streams:
            before, after = memory.stream(name), disk.stream(name)
            assert before.times_s.tobytes() == after.times_s.tobytes()
            assert before.values.tobytes() == after.values.tobytes()
            assert (before.unit, before.gaps, before.skipped) == (after.unit, after.gaps, after.skipped)


def test_an_empty_skipped_span_is_none_but_excuses_what_a_sensor_misses_that_restarts_in_one_turn(folder):
    recorder, kept = begun(folder)
    recorder.skip("board.period", 1.0, 1.0)
    recorder.record([load_cell(7)])
    later = load_cell(7)
    begin_s = later.last_s + 0.004
    recorder.skip("board.load_cell", begin_s - 0.001, begin_s - 0.001)
    recorder.record([replace(later, seq=later.seq + len(later) + 3, t0_s=begin_s)])
    recorder.close()
    series = kept.stream("board.load_cell")
    assert len(series) == 2 * len(later)
    assert series.gaps == ()
    assert kept.stream("board.period").skipped == ()


def test_raw_counts_device_time_and_arrival_are_kept(folder):
    recorder, _ = begun(folder)
    recorder.record([load_cell(7)])
    recorder.close()
    (block,) = open_run(folder.path).trial(1).blocks("board.load_cell")
    assert block.values.dtype == np.int32
    assert block.values[:, 0].tolist() == [index**2 - 17 for index in range(7, 17)]
    assert (block.seq, block.scale, block.device_t0_s, block.arrival_s) == (7, 1e-5, 5.007, 0.027)


def test_foxglove_plots_force_in_newtons_against_campaign_time(folder, kept):
    found = [(message.log_time, content) for _, message, content in messages_of(folder, "/board/load_cell")]
    start_ns = 1795176000 * 10**9  # 2026-11-20T12:00:00Z
    assert found[0][0] == start_ns + 1_004_000_000
    assert found[0][1].t_s == pytest.approx(1.004, abs=1e-12)
    assert found[0][1].force_n == pytest.approx((1004**2 - 17) * 1e-5, rel=1e-15)
    assert found[2][0] == start_ns + 101_002_000_000
    assert len(found) == 4, "of each trial the least and the largest of one bin"


@pytest.mark.parametrize("size", [7, 90, 1000])
def test_of_what_people_plot_the_least_and_the_largest_of_each_bin_are_there_however_blocks_are_cut(
    folder, size
):
    recorder = recorder_in(folder)
    recorder.begin_trial(0, {"location": "a"}, 0.0)
    for seq in range(0, 1000, size):
        block = load_cell(seq, min(size, 1000 - seq))
        recorder.record([replace(block, t0_s=block.t0_s + 0.0005)])  # no sample on a bin's edge
        recorder.flush()
    recorder.end_trial("contact", {})
    recorder.close()
    plotted = [(message.sequence, d) for _, message, d in messages_of(folder, "/board/load_cell")]
    per_bin = round(PLOT_S * 1000)
    rising = [edge for low in range(0, 1000, per_bin) for edge in (low, low + per_bin - 1)]
    assert [number for number, _ in plotted] == rising
    times_s = [(number + 0.5) / 1000.0 for number in rising]
    assert [d.t_s for _, d in plotted] == pytest.approx(times_s, abs=1e-12)
    assert [d.force_n for _, d in plotted] == pytest.approx([(n**2 - 17) * 1e-5 for n in rising], rel=1e-15)


def test_events_are_foxglove_logs_with_their_level(folder):
    recorder, _ = begun(folder)
    recorder.event(GuardStopped(2.5, "force 2.1 N above 2 N"), state="APPROACH", next_state="FAULT")
    recorder.close()
    logs = [content for _, _, content in messages_of(folder, "/events")]
    assert logs[-1].DESCRIPTOR.full_name == "foxglove.Log"
    assert logs[-1].level == 4
    assert "force 2.1 N above 2 N" in logs[-1].message
    assert logs[-1].timestamp.ToNanoseconds() % 10**10 == 2_500_000_000


def test_an_event_is_one_line_as_the_interface_page_shows(folder):
    recorder = recorder_in(folder)
    recorder.begin_trial(4, {"location": "f"}, 0.0)
    contact = Contact(93.2, "contact", 30.5, float("inf"))
    commands = [Stop("stage"), MoveAt("stage", 0.003785, 0.012)]
    recorder.event(contact, state="APPROACH", next_state="STOPPING", commands=commands)
    recorder.event(Refused(94.0, "stage", Stop("stage"), "no"), state="STOPPING")
    recorder.close()
    first, second = folder.events_path.read_text().splitlines()
    assert first.startswith(
        '{"t_s": 93.2, "trial": 4, "event": "Contact", "state": "APPROACH", "next": "STOPPING", '
        '"commands": ["Stop(stage)", "MoveAt(stage, 0.003785, 0.012)"]'
    )
    assert json.loads(first)["threshold"] is None
    assert json.loads(second)["command"] == "Stop(stage)"
    assert json.loads(second)["next"] == "STOPPING"


def test_a_recorder_that_is_never_closed_leaves_all_that_was_flushed(folder):
    recorder = recorder_in(folder)
    record_two_trials(recorder)
    recorder.begin_trial(5, {"location": "f"}, 200.0)
    recorder.record([load_cell(0)])
    recorder.flush()
    run = open_run(folder.path)
    assert run.cut_off
    assert [row["trial"] for row in run.trials] == [4, 2]
    assert len(run.trial(5).stream("board.load_cell")) == 10
    assert any("cut off" in note for note in run.notes)
    assert any("no footer" in note for note in run.notes)
    recorder.close()


def test_a_run_cut_off_in_every_file_is_read_and_reported_as_such(folder, kept):
    for path, bytes_ in ((folder.trials_path, 5), (folder.events_path, 5), (folder.recordings[0], 50)):
        path.write_bytes(path.read_bytes()[:-bytes_])
    run = open_run(folder.path)
    assert [row["trial"] for row in run.trials] == [4]
    assert [event["trial"] for event in run.events] == [4]
    assert len(run.trial(2).stream("board.load_cell")) == 20
    assert len(run.notes) == 4


def test_a_run_that_ended_has_nothing_to_confess_and_of_a_trial_that_is_not_in_it_nothing(folder, kept):
    folder.write_manifest({"bench": "mock", "exit": {"status": "done", "code": 0}})
    run = open_run(folder.path)
    assert run.notes == []
    assert not run.cut_off
    assert run.simulated
    with pytest.raises(KeyError, match="trial 9"):
        run.trial(9)


def test_a_trial_that_runs_again_after_a_resume_replaces_its_first_attempt(folder):
    for seq in (0, 500):
        recorder, _ = begun(folder)
        recorder.record([load_cell(seq)])
        recorder.close()
    assert [block.seq for block in open_run(folder.path).trial(1).blocks("board.load_cell")] == [500]


def test_a_recording_that_cannot_be_begun_is_one_clear_line(tmp_path, monkeypatch):
    (tmp_path / "recording.mcap").touch()
    with refused(RecordingError, "File exists while making", "move away"):
        StreamWriter(tmp_path / "recording.mcap", START, STREAMS)
    full = Path("/dev/full").open("wb")  # noqa: SIM115 - the writer closes it
    monkeypatch.setattr(Path, "open", lambda *_: full)
    with refused(RecordingError, "No space left on device while making"):
        StreamWriter(tmp_path / "recording.mcap", START, STREAMS)


def test_a_recorder_that_gets_no_thread_leaves_a_recording_that_can_be_read(folder, monkeypatch):
    def no_thread(_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("threading.Thread.start", no_thread)
    with pytest.raises(RuntimeError, match="thread"):
        recorder_in(folder)
    with (folder.path / "recording.mcap").open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None and not summary.statistics.message_count
    assert tidy(open_run(folder.path)) is not None, "the table of no trials can be written"


def test_a_disk_that_fills_up_in_a_trial_is_reported_at_its_end_and_not_before(folder, monkeypatch):
    def full(_, **__):
        raise OSError(28, "No space left on device")

    recorder = recorder_in(folder)
    monkeypatch.setattr(McapWriter, "flush", full)
    kept = recorder.begin_trial(1, {"location": "f"}, 0.0)
    for seq in range(0, 1000, 10):
        recorder.record([load_cell(seq)])
        recorder.skip("board.period", 0.0, 1.0)
        recorder.event(CONTACT, state="APPROACH")
    with pytest.raises(RecordingError, match=r"No space left on device while writing .*; make room"):
        recorder.flush()
    recorder.record([load_cell(1000)])
    with pytest.raises(RecordingError, match="No space left"):
        recorder.end_trial("contact", {})
    with pytest.raises(RecordingError, match="No space left"):
        recorder.close()
    assert len(kept.stream("board.load_cell")) == 1010
    assert [row["outcome"] for row in open_run(folder.path).trials] == ["fault"]


def test_a_trial_whose_samples_cannot_be_written_at_its_end_is_no_result(folder, monkeypatch):
    recorder, _ = begun(folder)
    recorder.record([load_cell(0)])
    recorder.flush()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapWriter, "add_metadata", full)
    with pytest.raises(RecordingError, match="No space left"):
        recorder.end_trial("contact", {"delay_s": 0.2})
    with pytest.raises(RecordingError, match="No space left"):
        recorder.close()
    assert read_rows(folder.trials_path)[0] == [
        {"trial": 1, "outcome": "fault", "location": "f", "delay_s": None, "force_n": None}
    ]


def test_an_events_file_that_is_full_or_damaged_is_reported_in_one_line(folder):
    folder.events_path.symlink_to("/dev/full")
    recorder, _ = begun(folder)
    recorder.event(CONTACT, state="APPROACH")
    with pytest.raises(RecordingError, match=r"events\.jsonl; make room"):
        recorder.end_trial("contact", {})
    assert [row["outcome"] for row in read_rows(folder.trials_path)[0]] == ["fault"]
    with pytest.raises(RecordingError, match=r"events\.jsonl"):
        recorder.close()
    folder.events_path.unlink()
    folder.events_path.write_text("{\n")
    with refused(RunFolderError, "events.jsonl: damaged"):
        open_run(folder.path)


def test_what_comes_while_the_disk_is_busy_and_the_recorder_is_closed_is_kept(folder, monkeypatch):
    busy, free = threading.Event(), threading.Event()
    flush = McapWriter.flush

    def slow(file, **how):
        flush(file, **how)
        busy.set()
        assert free.wait(100.0)

    monkeypatch.setattr(McapWriter, "flush", slow)
    recorder, kept = begun(folder)
    recorder.record([load_cell(0)])
    assert busy.wait(100.0), "the disk has the first block"
    recorder.record([load_cell(10)])
    closing = threading.Thread(target=recorder.close)
    closing.start()
    closing.join(0.2)  # it has reported that, and waits for the disk
    assert closing.is_alive()
    free.set()
    closing.join(10.0)
    found = open_run(folder.path).trial(1).stream("board.load_cell")
    assert found.values.tolist() == kept.stream("board.load_cell").values.tolist()


def test_events_that_a_disk_cannot_keep_up_with_are_a_failure_and_not_held(folder, monkeypatch):
    monkeypatch.setattr(disk, "BACKLOG", 20)
    busy, free = threading.Event(), threading.Event()

    def slow(*_):
        busy.set()
        assert free.wait(100.0)

    recorder, _ = begun(folder)
    monkeypatch.setattr(recorder._events, "commit", slow)
    assert busy.wait(100.0)
    for _ in range(100):
        recorder.event(CONTACT, state="APPROACH")
    held, failure = len(recorder._disk._queue), str(recorder.failure)
    free.set()
    with pytest.raises(RecordingError):
        recorder.close()
    assert held <= 21  # an event is a line and a message
    assert "the disk cannot keep up, 20 posts wait for it" in failure


def test_what_a_detector_holds_against_its_threshold_is_a_topic_and_a_stream(folder):
    recorder, kept = begun(folder)
    readings = [(1.0 + 0.03 * n, 0.1 * n, 7.0) for n in range(25)]
    for reading in readings:
        recorder.readings("near", np.array([reading]), [])
    assert 0 < len(kept.stream("detector.near")) < len(readings), "some at a time"
    recorder.end_trial("contact", {})
    recorder.close()
    series = open_run(folder.path).trial(1).stream("detector.near")
    assert [(t_s, *row) for t_s, row in zip(series.times_s, series.values, strict=True)] == readings
    assert series.gaps == ()
    plotted = [content for _, _, content in messages_of(folder, "/detector/near")]
    assert [(d.t_s, d.statistic, d.threshold) for d in plotted] == readings


@pytest.mark.parametrize("size", [1, 64, 1000])
def test_of_readings_faster_than_the_rate_the_least_the_largest_and_the_deciding_ones_are_kept(folder, size):
    times_s = 2.0 + np.arange(1000) / 1024.0
    statistic = np.random.default_rng(3).normal(size=1000)
    readings = np.column_stack([times_s, statistic, np.full(1000, 1.5)])
    decided = int(np.argmax(statistic > 1.5))
    recorder, kept = begun(folder)
    for begin in range(0, 1000, size):
        part = readings[begin : begin + size]
        recorder.readings("near", part, [t_s for t_s in part[:, 0] if t_s == times_s[decided]])
    recorder.end_trial("contact", {})
    recorder.close()
    wanted = {decided}
    for low_s in np.arange(2.0, 3.0, BIN_S):
        inside = np.flatnonzero((times_s >= low_s - 1e-9) & (times_s < low_s + BIN_S - 1e-9))
        if len(inside):
            wanted |= {int(inside[pick(statistic[inside])]) for pick in (np.argmin, np.argmax)}
    found = kept.stream("detector.near")
    np.testing.assert_array_equal(found.times_s, times_s[sorted(wanted)])
    np.testing.assert_array_equal(found.values, readings[sorted(wanted), 1:])


def test_a_recording_has_what_people_plot_look_for_and_open_it_with(folder):
    recorder = recorder_in(folder)
    limits = GuardSettings(force_stream="board.load_cell", force_n=2.0, position_stream=None, travel_m=0.01)
    recorder.begin_trial(4, {"location": "f"}, 0.0, limits)
    recorder.record([load_cell(1000), load_cell(1010), load_cell(1110), periods(3, [1.01, 1.06])])
    recorder.readings("contact", np.array([[1.0, 28.0, 28.2]]), [])
    recorder.event(CONTACT, state="APPROACH", next_state="STOPPING", commands=[Stop("stage")])
    recorder.end_trial("contact", {"delay_s": 0.2})
    recorder.attach("manifest.json", b'{"profile": "mock/transient"}')
    recorder.close()
    topics = {}
    for channel, _, content in messages_of(folder):
        topics.setdefault(channel.topic, []).append(content)
    assert "/raw/detector/contact" not in topics, "a detector's readings are there once"
    with folder.recordings[0].open("rb") as file:
        reader = make_reader(file)
        trials = [record.metadata for record in reader.iter_metadata()]
        (attached,) = reader.iter_attachments()
        assert reader.get_summary().statistics.attachment_count == 1
    assert [(m.t_s, m.state) for m in topics["/state"]] == [(0.0, "APPROACH"), (1.03, "STOPPING")]
    assert [m.frequency_hz for m in topics["/board/frequency"]] == [pytest.approx(28.0, abs=0.001)] * 2
    largest_n = [(seq**2 - 17) * 1e-5 for seq in (1019, 1119)]
    assert [m.largest_n for m in topics["/guard/force"]] == pytest.approx(largest_n), "once in 0.1 s"
    assert [m.margin_n for m in topics["/guard/force"]] == pytest.approx([2.0 - n for n in largest_n])
    assert [m.t_s for m in topics["/guard/force"]] == [1.0, 1.11]
    assert (trials[1]["trial"], trials[1]["outcome"], trials[1]["delay_s"]) == ("4", "contact", "0.2")
    assert (attached.name, json.loads(attached.data)) == ("manifest.json", {"profile": "mock/transient"})
    write_layouts(folder.recordings[0])
    layout = json.loads((folder.path / FOXGLOVE).read_text())
    paths = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())]
    assert paths[:2] == ["/detector/contact.statistic", "/detector/contact.threshold"]
    assert {"/guard/force.margin_n", "/board/frequency.frequency_hz", "/state.state"} <= set(paths)
    plots = ElementTree.parse(folder.path / PLOTJUGGLER).getroot()
    curves = list(plots.iter("curve"))
    for parent in plots.iter():
        assert {(child.tag, *sorted(child.attrib)) for child in parent} <= SAVED[parent.tag]
    (split,) = plots.iter("DockSplitter")
    assert int(split.get("count")) == len(split) == len(split.get("sizes").split(";"))
    assert {curve.get("name").replace("/", ".") for curve in curves} == {
        path.replace("/", ".") for path in paths if path != "/state.state"
    }
