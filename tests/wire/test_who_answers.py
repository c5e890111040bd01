"""Emulated devices at ports that no profile uses: each is known by its answer."""

import os
import threading
import time

import pytest

from config.assemble import start_emulator
from config.profile import load_profile
from controller import who_answers
from simulator.devices.dsa_matrix import EmulatedDsaMatrix
from tests.contracts.matrix_suite import steady


@pytest.fixture
def lines():
    """A port of a device that does `act` with what it reads, every 20 ms; its far ends are closed at the end."""
    ended, threads, ends = threading.Event(), [], []

    def line(act):
        far, near = os.openpty()
        ends.extend((far, near))
        os.set_blocking(far, False)

        def serve():
            while not ended.wait(0.02):
                try:
                    heard = os.read(far, 4096)
                except BlockingIOError:
                    heard = b""
                os.write(far, act(heard))

        threads.append(threading.Thread(target=serve, daemon=True))
        threads[-1].start()
        return os.ttyname(near)

    yield line
    ended.set()
    for thread in threads:
        thread.join()
    for end in ends:
        os.close(end)


def test_what_is_known_is_told_by_its_answer_and_nothing_is_made_of_the_rest(serve, lines, monkeypatch):
    monkeypatch.setattr(who_answers, "BOOT_S", 0.1)
    monkeypatch.setattr(who_answers, "ANSWER_S", 1.0)  # the machine may be busy with other tests
    bench = start_emulator(load_profile("emulated/transient"), realtime=True)
    try:
        ports = [
            bench.endpoints["devices"]["stage"]["port"],
            bench.endpoints["devices"]["board"]["port"],
            serve(EmulatedDsaMatrix(steady(), 115_200)),
            lines(lambda heard: b"V1013\r" if b"V\r" in heard else b""),
            lines(lambda heard: f"{time.monotonic_ns() // 1000},0.25\r\n".encode()),
            lines(lambda heard: b"@01 0 OK IDLE -- 50138\r\n" if b"deviceid" in heard else b""),
            lines(lambda heard: heard.upper()),
            lines(lambda heard: b""),
            "/dev/nowhere",
        ]
        stage, board, matrix, adapter, printer, known, echo, silent, absent = who_answers.who_answers(ports)
    finally:
        bench.close()
    assert stage.startswith("zaber_stage: address 1, device id ")
    assert board.startswith("sensor_board: ")
    assert matrix.startswith("dsa_matrix: DSACON32-M, serial ")
    assert "slcan" in adapter
    assert printer.startswith("serial_lines: it prints '")
    assert printer.endswith(",0.25'")
    assert known == "zaber_stage: address 1, device id 50138, X-LSQ-A: microstep_m = 9.921875e-08"
    assert "of no kind known here" in echo
    assert silent.startswith("nothing")
    assert absent.startswith("not asked: ")
