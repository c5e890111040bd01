"""What the shipped profiles of one experiment have in common on all benches."""

from collections.abc import Mapping
from typing import Any

COMPARED = {
    "zaber_stage": {"microstep_m", "travel_m"},
    "ur_arm": {"tcp_offset", "payload_kg", "payload_cog_m"},
}
"""Settings of a driver that the real device is held against at opening."""


def on_the_mock_bench(devices: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The devices with the mock bench's ports, and without what a real device is held against."""
    return {
        name: {
            **{key: value for key, value in device.items() if key not in COMPARED.get(device["driver"], ())},
            "port": "mock",
        }
        for name, device in devices.items()
    }
