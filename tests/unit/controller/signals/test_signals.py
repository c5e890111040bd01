"""Streams computed from streams: activation, and the samples."""

import numpy as np

from controller.signals.protocol import Signals
from drivers.core.messages import SampleBlock, Saturated, StreamInfo


class Doubled:
    """Twice its input; reports a value beyond ten."""

    def __init__(self, name, source):
        self.name = name
        self.inputs = (source,)
        self.info = StreamInfo(f"signals.{name}", ("x",), "V", rate_hz=1000.0)
        self.resets = 0

    def push(self, block):
        made = SampleBlock(self.info.name, block.seq, block.t0_s, 2.0 * block.physical, rate_hz=block.rate_hz)
        beyond = made.values[np.abs(made.values) > 10.0]
        statuses = (
            [Saturated(block.last_s, "signals", self.info.name, float(beyond[0]))] if beyond.size else []
        )
        return [made, *statuses]

    def reset(self):
        self.resets += 1


def block(*values, stream="board.bridge"):
    return SampleBlock(stream, 0, 0.0, np.array(values, dtype=float)[:, None], rate_hz=1000.0)


def test_a_signal_without_a_subscriber_computes_nothing():
    signals = Signals([Doubled("a", "board.bridge")])
    assert signals.subscribe(frozenset({"board.bridge"})) == {"board.bridge"}
    assert signals.push([block(1.0)]) == ([], [])


def test_a_subscribed_signal_needs_its_sources():
    signals = Signals([Doubled("a", "board.bridge"), Doubled("b", "signals.a")])
    assert signals.streams == {"signals.a", "signals.b"}
    assert signals.subscribe(frozenset({"signals.b", "stage.position"})) == {"board.bridge", "stage.position"}
    made, _ = signals.push([block(1.0, 2.0)])
    assert [(one.stream, one.values[:, 0].tolist()) for one in made] == [
        ("signals.a", [2.0, 4.0]),
        ("signals.b", [4.0, 8.0]),
    ]


def test_a_signal_is_reset_when_activated_and_not_while_active():
    signal = Doubled("a", "board.bridge")
    signals = Signals([signal])
    streams = frozenset({"signals.a"})
    signals.subscribe(streams)
    signals.subscribe(streams | {"stage.position"})
    assert signal.resets == 1
    signals.subscribe(frozenset())
    signals.subscribe(streams)
    assert signal.resets == 2


def test_a_signal_beyond_its_range_is_reported():
    signals = Signals([Doubled("a", "board.bridge")])
    signals.subscribe(frozenset({"signals.a"}))
    _, saturated = signals.push([block(1.0, 6.0)])
    assert [(status.stream, status.value) for status in saturated] == [("signals.a", 12.0)]
