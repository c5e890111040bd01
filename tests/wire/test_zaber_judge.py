"""The vendor's own library as an independent judge of the emulated stage, in native units over a pty."""

import threading
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import pytest
from zaber_motion import (
    BadDataException,
    CommandFailedException,
    DriverDisabledException,
    MovementFailedException,
    MovementInterruptedException,
    NoValueForKeyException,
)
from zaber_motion.ascii import Axis, Connection

from simulator.devices.zaber_stage import EmulatedZaberStage
from simulator.physics.stage_axis import StageAxis
from simulator.wiring.bench_clock import BenchClock

TIMEOUT_MS = 10_000
"""What the library waits for a reply: it lives on the wall's clock, and its machine may be busy."""


class Serve(Protocol):
    """The fixture `serve` of conftest.py."""

    clock: BenchClock

    def __call__(self, device: Any) -> str: ...

    def lock(self, port: str) -> threading.Lock: ...


class Court:
    """The judge's axis, and the emulated stage that it does not see."""

    def __init__(
        self,
        axis: Axis,
        connection: Connection,
        inject: Callable[[str], None],
        truth: StageAxis,
        clock: BenchClock,
    ) -> None:
        self.axis = axis
        self.connection = connection
        self.inject = inject
        self.truth = truth
        self.clock = clock

    def during(self, movement: Callable[[], None], kind: str) -> None:
        """Inject a fault while a movement that waits for its end is on its way."""
        timer = threading.Timer(0.1, self.inject, [kind])
        timer.start()
        try:
            movement()
        finally:
            timer.join()


@pytest.fixture
def court(serve: Serve) -> Iterator[Court]:
    truth = StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.026)
    stage = EmulatedZaberStage(truth)
    port = serve(stage)

    def inject(kind: str) -> None:
        with serve.lock(port):
            stage.inject(kind, serve.clock.monotonic_s())

    with Connection.open_serial_port(port) as connection:
        connection.default_request_timeout = TIMEOUT_MS
        axis = connection.get_device(1).get_axis(1)
        axis.home()
        yield Court(axis, connection, inject, truth, serve.clock)


def test_it_is_detected_and_homed(court: Court) -> None:
    court.connection.default_request_timeout = 1000  # it waits as long for devices beyond the first
    (device,) = court.connection.detect_devices(identify_devices=False)
    assert device.device_address == 1
    assert court.axis.is_homed()
    assert not court.axis.is_busy()
    assert court.axis.get_position() == 0.0


def test_a_move_arrives_where_it_was_sent(court: Court) -> None:
    court.axis.move_absolute(4000)
    assert court.axis.get_position() == 4000
    court.axis.move_relative(-1000, velocity=41943)
    assert court.axis.get_position() == 3000
    court.axis.move_absolute(5000, velocity=41943, acceleration=205)
    assert court.axis.get_position() == 5000
    court.axis.move_absolute(3000)
    assert court.truth.target_m == pytest.approx(3000 * 0.49609375e-6)


def test_a_velocity_is_kept_and_a_stop_ends_it(court: Court) -> None:
    court.axis.move_velocity(16384)  # 10,000 microsteps a second
    court.clock.rest(0.1)
    first_s = court.clock.monotonic_s()
    first = court.truth.position(first_s)
    assert court.axis.is_busy()
    court.axis.stop()
    assert not court.axis.is_busy()
    assert first > 0.0
    braked_m = (10000 * 0.49609375e-6) ** 2 / (2 * 0.5)
    cruised_m = 10000 * 0.49609375e-6 * (court.truth.arrival_s - first_s)
    assert first < court.truth.target_m <= first + cruised_m + braked_m
    assert court.axis.get_position() == round(court.truth.target_m / 0.49609375e-6)


def test_a_travel_limit_bounds_a_movement_and_rejects_what_lies_beyond(court: Court) -> None:
    court.axis.settings.set("limit.max", 5000)
    assert court.axis.settings.get("limit.max") == 5000
    court.axis.move_velocity(41943)
    court.axis.wait_until_idle()
    assert court.axis.get_position() == 5000
    with pytest.raises(BadDataException):
        court.axis.move_absolute(5001)


def test_a_stall_is_a_failed_movement(court: Court) -> None:
    with pytest.raises(MovementFailedException, match="FS"):
        court.during(lambda: court.axis.move_absolute(40000), "stall")
    assert 0 < court.axis.get_position() < 40000
    court.axis.move_absolute(0)
    assert court.axis.warnings.get_flags() == set()


def test_a_hand_on_the_knob_is_an_interrupted_movement(court: Court) -> None:
    with pytest.raises(MovementInterruptedException):
        court.during(lambda: court.axis.move_absolute(40000), "interrupt")


def test_the_library_takes_the_emulated_checksums(court: Court) -> None:
    court.connection.generic_command("set comm.checksum 1")
    court.axis.move_absolute(500)
    assert court.axis.get_position() == 500


def test_a_text_is_kept_in_the_stage_itself(court: Court) -> None:
    storage = court.axis.device.storage
    storage.set_string("touchbench.limit.max", "51200,24995")
    assert storage.get_string("touchbench.limit.max") == "51200,24995"
    storage.erase_key("touchbench.limit.max")
    with pytest.raises(NoValueForKeyException):
        storage.get_string("touchbench.limit.max")


def test_a_parked_stage_stays_where_it_is(court: Court) -> None:
    court.axis.move_absolute(1000)
    court.axis.park()
    assert court.axis.is_parked()
    with pytest.raises(CommandFailedException, match="PARKED"):
        court.axis.move_absolute(0)
    court.axis.unpark()
    court.axis.move_absolute(0)


def test_a_restored_stage_has_the_maker_s_settings_and_knows_no_place(court: Court) -> None:
    made = court.axis.settings.get("limit.max")
    court.axis.settings.set("limit.max", 5000)
    court.axis.device.storage.set_string("touchbench.limit.max", "51200,5000")
    court.connection.generic_command("system restore", 1)
    assert court.axis.settings.get("limit.max") == made
    assert court.axis.warnings.get_flags() == {"WR"}
    with pytest.raises(NoValueForKeyException):
        court.axis.device.storage.get_string("touchbench.limit.max")


def test_a_stage_is_renumbered(court: Court) -> None:
    court.connection.default_request_timeout = 1000  # it waits as long for devices beyond the first
    court.connection.renumber_devices(7)
    assert court.connection.get_device(7).get_axis(1).get_position() == 0.0


def test_a_disabled_driver_is_reported(court: Court) -> None:
    court.inject("disable")
    with pytest.raises(DriverDisabledException):
        court.axis.move_absolute(100)
