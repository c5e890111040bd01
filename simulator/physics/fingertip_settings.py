"""What stands on the slip bench: sensors, streams, and the numbers of its profile section."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

from pydantic import Field

from drivers.core.settings import Settings
from simulator.physics.bench import StreamSpec
from simulator.physics.slip import SENSORS, SlipNuisances, SlipPlantSettings

Sensor = Literal["fingertip", "flexible_finger", "barrett_finger", "wrist", "dsa"]
Bridge = Literal["x", "y", "t"]

PLANTS: Mapping[Sensor, str] = {
    "fingertip": "fingertip",
    "flexible_finger": "flexible_finger",
    "barrett_finger": "barrett_finger",
    "wrist": "jr3_wrist",
    "dsa": "dsa_taxel",
}
"""Which of the paper's sensors stands behind a trial's `sensor`. The wrist is the arm's own tool force, in the JR3's
place: it bends like the JR3 and reads like the arm."""

CONVERTER_V = 20.0 / 2**16
"""One count of the board. 16 bits over +-10 V: the paper's NI PCIe-6363 (4.1), the range being an assumption."""

STREAMS = (
    StreamSpec("fingertip", ("Fx", "Fy", "Ft"), "V", CONVERTER_V, 1000.0),
    StreamSpec("flexible", ("bending",), "V", CONVERTER_V, 1000.0),
)

BRIDGES: Mapping[Bridge, int] = {"x": 0, "y": 1, "t": 2}


class Matrix(NamedTuple):
    """What there is of one tactile matrix."""

    rows: int
    columns: int
    texel_m: float


FINGER = 11
"""Node of the BarrettHand's finger that carries the tip (assumption: the first)."""

MATRIX = Matrix(rows=14, columns=5, texel_m=0.0034)
"""A DSA 9210: 70 cells, 3.4 mm (5.4); their arrangement is an assumption."""

PATCH_TEXELS = 1.0
"""Standard deviation of the contact patch on the matrix, in texels. Assumption: rubber on a flat plate."""

STREAM_IDLE = 80
STREAM_TEXELS = 48
"""Numbers of the noise of sensors that touch nothing, and of the texels, among the counter-based streams; plant and arm
have those below."""


class SlipBenchSettings(Settings):
    """The plant section of a profile: where the table is, and what is different from `slip_sensors`."""

    surface_m: float = Field(default=0.003, gt=0.0, le=0.1)
    """Where the tip first touches the table, on the approach axis. Assumption: a 3 mm gap at the start."""

    radius_m: float = Field(default=0.012, gt=0.0, le=0.2)
    """Radius of the tip's cylinder, about whose axis the arm turns it. Assumption: the size of a fingertip."""

    bumps_hz: float = Field(default=0.0, ge=0.0, le=100.0)
    """Bumps a second, at random instants."""

    loads_hz: float = Field(default=0.0, ge=0.0, le=100.0)
    """Load steps a second, at random instants."""

    rolling_scale: float = Field(default=1.0, ge=0.0, le=100.0)
    """Multiplies the roughness of rolling."""

    noise_scale: float = Field(default=1.0, ge=0.0, le=1000.0)
    """Multiplies the noise of every bridge, gauge and texel; the arm's own is the arm's."""

    mode_scale: float = Field(default=1.0, ge=0.1, le=10.0)
    """Multiplies the frequency of the structure; its stiffness stays."""

    damping_scale: float = Field(default=1.0, gt=0.0, le=30.0)
    """Multiplies its damping ratio."""

    friction: float | None = Field(default=None, ge=1e-3, le=10.0)
    """Mean coefficient of kinetic friction, 0.001 (better than oiled steel) at the least; None takes the sensor's."""

    matrix_hz: float | None = Field(default=None, gt=0.0, le=1000.0)
    """How often the matrix is sampled, Hz; None takes the sensor's, 100 Hz with all cells. That its controller samples
    as often as the line could carry fewer cells is an assumption: it is documented nowhere."""

    nuisances: SlipNuisances = SlipNuisances()
    """What recordings have besides; nothing of it by default."""

    @property
    def quiet(self) -> bool:
        """Whether the noise is too small for a converter to see: a sensor that repeats its value is not stuck then."""
        return self.noise_scale < 0.5  # the hand's gauges have 0.6 counts at 1

    def of(self, sensor: Sensor) -> SlipPlantSettings:
        """The plant with this sensor at the tip.

        What the sensor's own electronics add is added where those are: the hand's converter, the texels' noise, the
        arm's noise.
        """
        base = SENSORS[PLANTS[sensor]]
        bridges = base.bridges
        if sensor == "barrett_finger":
            bridges = (bridges[0].model_copy(update={"step": 0.0}),)
        elif sensor in ("wrist", "dsa"):
            bridges = (bridges[0].model_copy(update={"step": 0.0, "noise": 0.0}),)
        return base.model_copy(
            update={
                "bridges": bridges,
                "rate_hz": (self.matrix_hz if sensor == "dsa" else None) or base.rate_hz,
                "bumps_hz": self.bumps_hz,
                "loads_hz": self.loads_hz,
                "rolling_n": self.rolling_scale * base.rolling_n,
                "noise_scale": self.noise_scale,
                "mode_hz": self.mode_scale * base.mode_hz,
                "mass_kg": base.mass_kg / self.mode_scale**2,
                "damping_ratio": self.damping_scale * base.damping_ratio,
                "friction": base.friction if self.friction is None else self.friction,
                "nuisances": self.nuisances,
            }
        )
