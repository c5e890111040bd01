"""A UR arm stopped beside the program that holds it: over the dashboard, which takes any number of clients."""

import math

from drivers.arm.link import STILL_M_S, STILL_RAD_S, LinkError
from drivers.core.clock import monotonic_s, rest
from drivers.ur_arm.dashboard import Dashboard
from drivers.ur_arm.settings import UrArmSettings

STOPS_S = 3.0
"""How long the arm may take to stand (assumption: ten times what braking from 0.25 m/s takes)."""

STILL_S = 0.1
"""How long it has to stand to count as still."""

LOOK_S = 0.01
"""Time between two looks."""


def stop_beside(settings: UrArmSettings) -> str:
    """End the program on an arm's controller, whoever runs it; returns why the arm is not seen standing, or ""."""
    try:
        dashboard = Dashboard(settings.host)
        dashboard.ask("stop")
        until_s = monotonic_s() + STOPS_S
        while "false" not in dashboard.ask("running").lower():
            if monotonic_s() > until_s:
                return "its controller goes on with the program"
            rest(LOOK_S)
    except LinkError as error:
        return f"{error.reason}; {error.advice}"
    try:
        from rtde_receive import RTDEReceiveInterface

        receive = RTDEReceiveInterface(settings.host, settings.rate_hz, ["timestamp", "actual_TCP_speed"])
    except (ImportError, RuntimeError) as error:
        return f"its program has ended; whether it stands cannot be seen ({error})"
    try:
        still_s = until_s = monotonic_s()
        until_s += STOPS_S
        while (now_s := monotonic_s()) < until_s:
            speed = receive.getActualTCPSpeed()
            if math.hypot(*speed[:3]) >= STILL_M_S or math.hypot(*speed[3:]) >= STILL_RAD_S:
                still_s = now_s
            elif now_s - still_s > STILL_S:
                return ""
            rest(LOOK_S)
        return "it still moves"
    finally:
        receive.disconnect()
