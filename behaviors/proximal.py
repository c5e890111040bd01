"""A4: an approach to either link, with an accelerometer on each (Backus and Dollar, V.C)."""

from behaviors.transient import Transient, TransientSettings
from drivers.core.settings import StreamName


class ProximalSettings(TransientSettings):
    """How one approach is run and heard on both links."""

    waveform_streams: tuple[StreamName, StreamName]
    """The accelerometers (m/s2): proximal link, then distal."""


class Proximal(Transient):
    """Approach until contact.

    Args:
        detectors: Names of all detectors that listen, the acting one among them.
    """

    settings: ProximalSettings
