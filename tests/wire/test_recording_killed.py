import signal
import subprocess
import sys
from pathlib import Path

from mcap.reader import NonSeekingReader, make_reader

from controller.recording.reader import close_recordings, open_run

RECORD_FOR_EVER = """
import sys, time
from datetime import UTC, datetime
from pathlib import Path
import numpy as np
from controller.recording.recorder import Recorder
from controller.recording.run_folder import RunFolder
from drivers.core.messages import SampleBlock

folder = RunFolder.create(Path(sys.argv[1]), "mock/transient", datetime.now(UTC))
folder.write_manifest({"bench": "mock", "exit": {"status": "running"}})
recorder = Recorder(folder, datetime.now(UTC), streams={}, factors=[], measures=[])
recorder.begin_trial(0, {}, 0.0)
recorder.end_trial("contact", {})
recorder.begin_trial(1, {}, 10.0)
start = time.monotonic()
while time.monotonic() - start < 20:
    now = time.monotonic() - start
    recorder.record([SampleBlock("board.load_cell", 0, now, np.ones((1, 1), np.int32), 1000.0)])
    print(now, flush=True)
    time.sleep(0.005)
"""


def test_a_kill_costs_less_than_the_last_second(tmp_path):
    root = Path(__file__).parents[2]
    child = subprocess.Popen(
        [sys.executable, "-c", RECORD_FOR_EVER, tmp_path], stdout=subprocess.PIPE, cwd=root
    )
    try:
        reported_s = 0.0
        while reported_s < 2.1:
            reported_s = float(child.stdout.readline())
        child.send_signal(signal.SIGKILL)
        child.wait(100.0)
    finally:
        child.kill()
        child.stdout.close()
    run = open_run(next(tmp_path.iterdir()))
    assert run.cut_off
    assert [row["trial"] for row in run.trials] == [0]
    last_s = run.trial(1).stream("board.load_cell").times_s[-1]
    assert last_s > reported_s - 1.0
    (path,) = run.folder.recordings
    close_recordings(run.folder)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        (raw,) = (
            each.id for each in reader.get_summary().channels.values() if each.topic == "/raw/board/load_cell"
        )
        counted = sum(1 for _ in reader.iter_messages(topics="/raw/board/load_cell"))
        assert reader.get_summary().statistics.channel_message_counts[raw] == counted > 10
    with path.open("rb") as file:
        streamed = NonSeekingReader(file, validate_crcs=True).iter_messages(topics="/raw/board/load_cell")
        assert sum(1 for _ in streamed) == counted
    closed = open_run(run.folder.path)
    assert closed.cut_off
    assert closed.trial(1).stream("board.load_cell").times_s[-1] == last_s
    assert "The recording was cut off, and closed afterwards behind its last whole chunk." in closed.notes
