"""The controller's tool against the profile's."""

from typing import Any

import pytest

from drivers.ur_arm.settings import UrArmSettings
from drivers.ur_arm.tool import NO_TOOL, Tool, disagreement, stated

FOUND = Tool((0.0, 0.0, 0.12, 0.0, 0.0, 3.1414), 1.25, (0.0, 0.01, 0.06))


def settings(**tool: Any) -> UrArmSettings:
    return UrArmSettings(host="arm", start_pose=(0.4, 0.0, 0.2, 0.0, 3.14, 0.0), **tool)


@pytest.mark.parametrize(
    "tool",
    [
        {},
        FOUND._asdict(),
        {"tcp_offset": (0.00005, 0.0, 0.12, 0.0, 0.0, 3.1414)},
        {"tcp_offset": (0.0, 0.0, 0.12, 0.0, 0.0, -3.1414)},  # half a turn either way, but for 0.4 mrad
        {"payload_kg": 1.255},
        {"payload_cog_m": (0.0005, 0.01, 0.06)},
    ],
    ids=["nothing stated", "equal", "rounded", "turned the other way", "10 g", "0.5 mm"],
)
def test_what_is_not_stated_or_differs_by_a_rounding_agrees(tool: dict[str, Any]) -> None:
    assert disagreement(settings(**tool), FOUND) == ""


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        ({"tcp_offset": (0.0, 0.0, 0.1202, 0.0, 0.0, 3.1414)}, "tcp_offset is [0, 0, 0.12, 0, 0, 3.1414]"),
        ({"tcp_offset": (0.0, 0.0, 0.12, 0.0, 0.0, 3.1394)}, "the profile's [0, 0, 0.12, 0, 0, 3.1394]"),
        ({"payload_kg": 0.0}, "payload_kg is 1.25, the profile's 0"),
        (
            {"payload_cog_m": (0.0, 0.01, 0.062)},
            "payload_cog_m is [0, 0.01, 0.06], the profile's [0, 0.01, 0.062]",
        ),
        (NO_TOOL._asdict(), "payload_kg is 1.25"),
    ],
    ids=["0.2 mm", "2 mrad", "payload", "centre of gravity", "all of it"],
)
def test_another_tool_is_shown_beside_the_profile_s(tool: dict[str, Any], words: str) -> None:
    assert words in disagreement(settings(**tool), FOUND)


def test_the_manifest_has_the_tool_and_what_the_profile_does_not_state_of_it() -> None:
    given = settings(payload_kg=1.25)
    assert FOUND.details(given) == {
        **FOUND._asdict(),
        "not_stated_by_the_profile": ("tcp_offset", "payload_cog_m"),
    }
    assert stated(given) == NO_TOOL._replace(payload_kg=1.25)
