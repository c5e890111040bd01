"""What a profile says of a device's analog inputs."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from drivers.core.settings import Settings


class DaqStream(Settings):
    """A stream: some of the inputs. A value is `scale` times the difference of the voltage and `offset`."""

    inputs: tuple[str, ...] = Field(min_length=1)
    """Which inputs of the device, `ai0`: a channel each."""
    channels: tuple[str, ...] = ()
    """Their names; by default the inputs'."""
    unit: str = Field(min_length=1)
    """SI unit of the values: "N", "m/s2"."""
    scale: float = 1.0
    """Units for each volt; negative where the sensor is mounted the other way round."""
    offset: float = 0.0
    """Volts at zero. `Tare` replaces it until the device is opened again."""
    noisy: bool = False
    """Whether its last digit always moves, so that the guard may take a value that stands still for a stuck sensor."""
    shows: tuple[str, ...] = ()
    """Simulated benches alone: what of the plant each input shows, `load_cell` or `strain.fx`."""

    @property
    def columns(self) -> tuple[int, ...]:
        """Places of the inputs in the stream."""
        return tuple(range(len(self.inputs)))

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.scale == 0.0:
            raise ValueError("scale is 0; how many units is a volt?")
        for key in ("channels", "shows"):
            if getattr(self, key) and len(getattr(self, key)) != len(self.inputs):
                raise ValueError(f"{key} has {len(getattr(self, key))} names for {len(self.inputs)} inputs")
        return self


class DaqLimits(Settings):
    """What is sampled, and how: of a real device and a simulated one."""

    rate_hz: float = Field(gt=0.0, le=1_000_000.0)
    """Samples a second of every input, by the device's clock."""
    range_v: float = Field(default=10.0, gt=0.0, le=60.0)
    """Inputs measure from minus to plus this; the device takes its next wider range."""
    streams: dict[str, DaqStream] = Field(min_length=1)
    """`[devices.NAME.streams.force]` is the stream `NAME.force`."""

    @model_validator(mode="after")
    def _each_input_once(self) -> Self:
        inputs = [name for stream in self.streams.values() for name in stream.inputs]
        if twice := sorted({name for name in inputs if inputs.count(name) > 1}):
            raise ValueError(f"{twice[0]} stands in two places; an input belongs to one stream")
        return self


class NiDaqSettings(DaqLimits):
    """A National Instruments device with analog inputs that are sampled by its own clock."""

    port: str = Field(min_length=1)
    """Its name in NI MAX or `nilsdev`: `Dev1`."""
    server: str | None = None
    """`HOST:PORT` of an NI gRPC Device Server where the device is at another computer; "none": at this one."""
    terminal: Literal["default", "rse", "nrse", "differential"] = "default"
    """How the inputs are wired."""
    block_s: float = Field(default=0.01, ge=0.001, le=0.1)
    """How long the samples are that are fetched together (assumption)."""
    open_timeout_s: float = Field(default=5.0, gt=0.0, le=60.0)
    """Longest wait for a server (assumption)."""
    silence_timeout_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Silence after which it has failed (assumption: 50 blocks)."""
    max_drift_ppm: float = Field(default=200.0, gt=0.0, le=10_000.0)
    """Bound on the drift between its clock and the host's. Assumption: two crystals of 100 ppm."""
