"""What every device promises: run for mock drivers in virtual time, for real ones on ptys."""

import math
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import pytest

from drivers.core.errors import CommandError
from drivers.core.messages import (
    Excite,
    Grip,
    Home,
    Listen,
    MoveAt,
    MoveTo,
    Reached,
    Sent,
    SetTendon,
    Standstill,
    Status,
    Stop,
    Tare,
)
from tests.contracts.crank import Crank


class Bench(Crank):
    """A rig with its devices open."""

    def __init__(self, rig: Any) -> None:
        super().__init__(None, rig.clock, opens=False)
        self.rig = rig
        self.devices = list(rig.devices.values())
        self.infos = {name: device.open() for name, device in rig.devices.items()}

    def until(self, kind: type[Status], device: str) -> Any:  # type: ignore[override]
        return super().until(kind, device=device)

    def apply(self, command: Any) -> Any:
        return self.rig.devices[command.device].apply(command)

    def close(self) -> None:
        for device in self.devices:
            device.close()
        self.rig.close()


class DeviceContract:
    """Subclasses give a fixture `bench`: a mover and a sensor board called `board`."""

    mover: ClassVar[str] = "stage"
    """Name of the mover."""

    reach_m: ClassVar[float] = 1e-6
    """How far from its target the mover may stand and have reached it."""

    def test_streams_bear_their_devices_name_and_a_unit(self, bench: Bench) -> None:
        for device, info in bench.infos.items():
            assert info.device == device
            assert info.streams
            for name, stream in info.streams.items():
                assert name == stream.name
                assert name.startswith(f"{device}.")
                assert stream.unit
                assert stream.scale > 0.0

    def test_nothing_is_sent_without_a_subscriber(self, bench: Bench) -> None:
        bench.turn(0.05)
        assert bench.blocks == []

    def test_blocks_follow_one_another_in_sequence_and_time(self, bench: Bench) -> None:
        bench.apply(Listen("board", frozenset({"board.load_cell"})))
        # A busy machine may keep the wire waiting; 1 kHz is another test's business.
        while bench.rig.clock.now() < 10.0 and sum(map(len, bench.blocks_of("board.load_cell"))) <= 250:
            bench.turn(0.1)
        blocks = bench.blocks_of("board.load_cell")
        assert sum(map(len, blocks)) > 250
        for before, after in pairwise(blocks):
            assert after.seq == before.seq + len(before)
            assert after.t0_s > before.t0_s
        info = bench.infos["board"].streams["board.load_cell"]
        assert {(block.unit, block.scale, block.rate_hz) for block in blocks} == {
            (info.unit, info.scale, info.rate_hz)
        }
        assert all(np.issubdtype(block.values.dtype, np.integer) for block in blocks), "raw counts"
        assert all(block.device_t0_s is not None and block.arrival_s is not None for block in blocks)

    def test_a_stream_ends_when_it_is_unsubscribed(self, bench: Bench) -> None:
        bench.apply(Listen("board", frozenset({"board.load_cell"})))
        bench.turn(0.1)
        bench.apply(Listen("board", frozenset()))
        bench.turn(0.1)
        bench.blocks.clear()
        bench.turn(0.1)
        assert bench.blocks == []

    def test_periods_come_with_a_time_each_while_the_finger_is_excited(self, bench: Bench) -> None:
        bench.apply(Listen("board", frozenset({"board.period"})))
        bench.apply(Excite("board", True))
        bench.turn(1.5)
        times_s, periods_s = bench.times("board.period"), bench.values("board.period")[:, 0]
        assert (np.diff(times_s) > 0.0).all()
        # A period is the time since the last one's end: the two agree, but for the clock model, which
        # is still learning drift and delay in the first second: 3.6 ms is the 99th percentile of a pty's delay.
        assert np.diff(times_s)[5:] == pytest.approx(periods_s[6:], abs=4e-3)

    def test_a_motion_is_sent_and_reaches_its_target(self, bench: Bench) -> None:
        self.home(bench)
        bench.apply(Listen(self.mover, frozenset({f"{self.mover}.position"})))
        bench.apply(MoveTo(self.mover, 0.002, 0.01))
        sent = bench.until(Sent, self.mover)
        reached = bench.until(Reached, self.mover)
        assert isinstance(sent.command, MoveTo)
        assert reached.position_m == pytest.approx(0.002, abs=self.reach_m)
        assert reached.t_s - sent.t_s > 0.2, "2 mm at 10 mm/s"
        bench.turn(0.05)
        positions = bench.blocks_of(f"{self.mover}.position")[-1].physical[:, 0]
        assert positions[-1] == pytest.approx(0.002, abs=self.reach_m)

    def test_an_approach_ends_at_its_limit_by_itself(self, bench: Bench) -> None:
        self.home(bench)
        bench.apply(MoveAt(self.mover, 0.01, 0.001))
        assert bench.until(Reached, self.mover).position_m == pytest.approx(0.001, abs=self.reach_m)

    def test_a_stop_is_answered_by_standstill_while_moving(self, bench: Bench) -> None:
        self.home(bench)
        bench.apply(MoveAt(self.mover, 0.005, 0.01))
        bench.turn(0.2)
        bench.apply(Stop(self.mover))
        still = bench.until(Standstill, self.mover)
        assert 0.0005 < still.position_m < 0.003
        bench.turn(0.05)
        assert not [status for status in bench.statuses if isinstance(status, Reached)]

    def test_a_stop_is_answered_by_standstill_while_standing(self, bench: Bench) -> None:
        self.home(bench)
        bench.apply(Stop(self.mover))
        assert bench.until(Standstill, self.mover).position_m == pytest.approx(0.0, abs=self.reach_m)

    def test_a_status_names_the_command_that_it_is_about(self, bench: Bench) -> None:
        self.home(bench)
        bench.apply(MoveAt(self.mover, 0.005, 0.01, id=5))
        assert bench.until(Sent, self.mover).command_id == 5
        bench.apply(MoveTo(self.mover, 0.001, 0.01, id=6))
        assert bench.until(Reached, self.mover).command_id == 6
        bench.apply(MoveAt(self.mover, 0.005, 0.01, id=7))
        bench.turn(0.1)
        bench.apply(Stop(self.mover, id=8))
        assert bench.until(Standstill, self.mover).command_id == 8
        bench.apply(Home(self.mover, id=9))
        assert bench.until(Reached, self.mover).command_id == 9

    def test_a_command_that_makes_no_sense_is_refused_in_one_line(self, bench: Bench) -> None:
        mover = self.mover
        for command in (
            MoveTo(mover, math.nan, 0.01),
            MoveTo(mover, 0.001, math.inf),
            MoveAt(mover, math.nan, 0.001),
            MoveAt(mover, 0.001, 1.0),
            MoveTo(mover, 1.0, 0.01),
            Excite(mover, True),
            MoveTo("board", 0.001, 0.01),
            SetTendon("board", math.nan),
            SetTendon("board", 0.0201),
            SetTendon("board", -0.0001),
            Tare("board", "board.nothing"),
            Listen("board", frozenset({"board.nothing"})),
            Grip("board", 0.01, 0.01, 10.0),
        ):
            with pytest.raises(CommandError) as error:
                bench.apply(command)
            assert "\n" not in str(error.value)
            assert str(error.value).startswith(f"{command.device}: "), command

    def test_a_tendon_is_set_to_the_micrometre_and_that_is_reported(self, bench: Bench) -> None:
        bench.apply(SetTendon("board", 0.0100004, id=5))
        sent = bench.until(Sent, "board")
        assert sent.command_id == 5
        assert sent.command.position_m == pytest.approx(0.01, abs=1e-12)

    def test_closing_twice_is_no_error(self, bench: Bench) -> None:
        for device in bench.rig.devices.values():
            device.close()
            device.close()

    def home(self, bench: Bench) -> None:
        bench.apply(Home(self.mover))
        bench.until(Reached, self.mover)
        bench.statuses.clear()
