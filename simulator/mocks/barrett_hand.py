"""The BarrettHand of the mock bench: what its fingers feel, sampled in the process."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.barrett_hand import codec
from drivers.barrett_hand.strain import FingerStrain, FingerStrainSettings
from drivers.core.messages import Command, DeviceInfo, Listen, SampleBlock, Tare
from drivers.core.wire import check_sensor
from simulator.devices.barrett_hand import counts
from simulator.mocks.base import MockSensor
from simulator.physics.bench import part

MockBarrettHandSettings = FingerStrainSettings


class MockBarrettHand(MockSensor):
    """Samples the fingers' gauges."""

    model = "simulated BarrettHand"
    _settings: MockBarrettHandSettings

    def _wire(self) -> None:
        part(self._bench, "forces_n", self.name)

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        s = self._settings
        strains = [FingerStrain(self.name, finger, s.poll_hz, s) for finger in s.fingers]
        self._strains = {strain.info.name: strain for strain in strains}
        self._fingers = dict(zip(self._strains, s.fingers, strict=True))
        self._infos = {name: strain.info for name, strain in self._strains.items()}
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        return replace(super().open(), details={"safe_counts": codec.SAFE_COUNTS})

    def apply(self, command: Command) -> Command:
        """Listen to fingers, or tare one.

        Raises:
            CommandError: not for this hand.
        """
        check_sensor(self.name, command, self._strains, "a hand")
        if isinstance(command, Listen):
            self._subscribe(command.streams, self._clock.now())
        elif isinstance(command, Tare) and self._strains[command.stream].tare():
            self._sent(command)
        else:
            self._refuse(command, "nothing has been read of it; listen to it first")
        return command

    def read(self) -> Sequence[SampleBlock]:
        """What was sampled since the last call."""
        blocks = super().read()
        for block in blocks:
            self._statuses += self._strains[block.stream].saturation(block)
        return blocks

    def account(self) -> Mapping[str, object]:
        """No link; where the zeros are."""
        return {"zero_counts": {name: strain.zero for name, strain in self._strains.items()}}

    def _counts(self, stream: str, times_s: NDArray[np.float64]) -> NDArray[np.int64]:
        now_s = self._clock.now()
        raw = counts(self._bench.forces_n(self._fingers[stream], times_s), self._settings)
        if self._faults.active(now_s, "full_scale"):
            raw = np.zeros_like(raw)
        return raw

    def _block(
        self, stream: str, t0_s: float, values: Any, now_s: float, times_s: NDArray[np.float64] | None = None
    ) -> SampleBlock:
        seq = self._seq[stream]
        self._seq[stream] += len(values)
        return self._strains[stream].block(seq, t0_s, values, now_s)
