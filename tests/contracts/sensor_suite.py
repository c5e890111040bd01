"""What every sensor promises, whatever it senses; suites of hands, matrices and the audio are of this one."""

from typing import Any, ClassVar

import pytest

from drivers.core.errors import CommandError
from drivers.core.messages import Command
from tests.contracts.crank import Crank


class SensorContract:
    """Subclasses give a fixture `bench`, one of its streams, and commands that make no sense to it."""

    stream: ClassVar[str]
    senseless: ClassVar[tuple[Command, ...]]

    def test_nothing_is_sent_without_a_subscriber(self, bench: Crank) -> None:
        bench.turn(0.1)
        assert bench.blocks == []

    def test_a_stream_ends_when_it_is_unsubscribed_and_begins_anew(self, bench: Crank) -> None:
        bench.listen(self.stream)
        bench.turn(0.2)
        bench.listen()
        bench.turn(0.3)
        last = bench.blocks[-1]
        bench.blocks.clear()
        bench.statuses.clear()
        bench.turn(0.1)
        assert bench.blocks == []
        bench.listen(self.stream)
        bench.turn(0.2)
        begun = bench.blocks[0].seq - last.seq - len(last)
        self.check_pause(bench, begun, 0.4 * bench.info.streams[self.stream].rate_hz)

    def check_pause(self, bench: Any, missing: int, pause: float) -> None:
        """Check how many numbers are missing between two subscriptions, of a pause of so many samples."""
        assert missing >= 0

    def test_a_command_that_makes_no_sense_is_refused_in_one_line(self, bench: Crank) -> None:
        for command in self.senseless:
            with pytest.raises(CommandError) as error:
                bench.device.apply(command)
            assert "\n" not in str(error.value)
            assert str(error.value).startswith(f"{bench.device.name}: "), command

    def test_closing_twice_is_no_error(self, bench: Crank) -> None:
        bench.device.close()
        bench.device.close()
