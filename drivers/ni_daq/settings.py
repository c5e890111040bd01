"""What a profile says of a device's inputs, counters and output."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Literal, Self

from pydantic import Field, model_validator

from drivers.core.scaled import ScaledStream
from drivers.core.settings import Mismatch, Settings


class DaqStream(ScaledStream):
    """Some of the analog inputs in volts, or a counter in counts: a channel each."""

    inputs: tuple[str, ...] = Field(min_length=1)
    """Which inputs of the device, `ai0`, or which counter, `ctr0`."""
    counts: Literal["edges", "x1", "x2", "x4"] | None = None
    """A counter: of rising edges, or of an encoder with two phases and this decoding; "none": analog inputs."""

    @property
    def sources(self) -> Sequence[int | str]:
        """See `ScaledStream.sources`."""
        return self.inputs

    @model_validator(mode="after")
    def _of_one_sort(self) -> Self:
        if self.counts and len(self.inputs) > 1:
            raise ValueError("a counter has a stream of its own: inputs names one")
        if wrong := [name for name in self.inputs if name.startswith("ctr") != bool(self.counts)]:
            raise ValueError(
                f'{wrong[0]}: a counter (ctr0) has counts, "edges" or "x4"; an analog input has none'
            )
        return self


class DaqDrive(Settings):
    """An analog output, and what it gives: a constant voltage on `Excite`, a sine on `Tone`."""

    output: str = Field(min_length=1)
    """Which: `ao0`."""
    limit_v: float = Field(gt=0.0, le=60.0)
    """Volts that it never exceeds: the amplitude of a `Tone` of level 1. What hangs there must bear it."""
    on_v: float | None = None
    """Volts while the excitation is on; "none": `Excite` on is refused."""
    rate_hz: float | None = Field(default=None, gt=0.0, le=10_000_000.0)
    """Samples a second of a sine; "none": `Tone` is refused."""

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.on_v is None and self.rate_hz is None:
            raise ValueError("it can give nothing: set on_v (a constant voltage) or rate_hz (tones)")
        if abs(self.on_v or 0.0) > self.limit_v:
            raise ValueError(f"on_v is {self.on_v:g}, beyond limit_v, {self.limit_v:g}")
        return self


class NiDaqSettings(Settings):
    """A National Instruments device whose analog inputs are sampled by its own clock."""

    port: str = Field(min_length=1)
    """Its name in NI MAX or `nilsdev`: `Dev1`."""
    server: str | None = None
    """`HOST:PORT` of an NI gRPC Device Server where the device is at another computer; "none": at this one."""
    rate_hz: float = Field(gt=0.0, le=1_000_000.0)
    """Samples a second of every input, by the device's clock."""
    range_v: float = Field(default=10.0, gt=0.0, le=60.0)
    """Inputs measure from minus to plus this; the device takes its next wider range."""
    terminal: Literal["default", "rse", "nrse", "differential"] = "default"
    """How the inputs are wired."""
    streams: dict[str, DaqStream] = Field(min_length=1)
    """`[devices.NAME.streams.force]` is the stream `NAME.force`."""
    drive: DaqDrive | None = None
    """`[devices.NAME.drive]`: an output; without it there is none."""
    block_s: float = Field(default=0.01, ge=0.001, le=0.1)
    """How long the samples are that are fetched together (assumption)."""
    open_timeout_s: float = Field(default=5.0, gt=0.0, le=60.0)
    """Longest wait for a server (assumption)."""
    silence_timeout_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Silence after which it has failed (assumption: 50 blocks)."""
    max_drift_ppm: float = Field(default=200.0, gt=0.0, le=10_000.0)
    """Bound on the drift between its clock and the host's. Assumption: two crystals of 100 ppm."""

    @model_validator(mode="after")
    def _each_input_once(self) -> Self:
        inputs = [name for stream in self.streams.values() for name in stream.inputs]
        if twice := sorted({name for name in inputs if inputs.count(name) > 1}):
            raise ValueError(f"{twice[0]} stands in two places; an input belongs to one stream")
        if not self.analog:
            raise ValueError("a counter is sampled by the clock of the analog inputs; name one of those, ai0")
        return self

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterator[Mismatch]:
        """A limit of the force that no voltage in the range reaches would never act."""
        limits = profile.get(("limits",))
        device, _, own = (getattr(limits, "force_stream", None) or "").partition(".")
        stream = self.streams.get(own)
        if device != path[-1] or stream is None or stream.counts:
            return
        most_n = abs(stream.scale) * (self.range_v + abs(stream.offset))
        for key in ("force_n", "retreat_n"):
            limit_n = getattr(limits, key)
            if limit_n is not None and limit_n >= most_n:
                mistake = (
                    f" = {limit_n:g}: {device}.{own} ends at {most_n:.4g} N, where range_v ends; lower the limit, or"
                    " choose a sensor that goes beyond it"
                )
                yield Mismatch(("limits",), key, mistake)

    @property
    def analog(self) -> list[str]:
        """The analog inputs, in the order in which they are read."""
        return [name for one in self.streams.values() if not one.counts for name in one.inputs]

    @property
    def counters(self) -> dict[str, str]:
        """How each counter counts; they are read after the analog inputs."""
        return {one.inputs[0]: one.counts for one in self.streams.values() if one.counts}

    @property
    def block(self) -> int:
        """Samples that are fetched together."""
        return max(1, round(self.block_s * self.rate_hz))
