"""A controller on its own, in front of a stiff plane: `python -m drivers.mock.devices.ur_controller`.

Prints one JSON line when it listens, then obeys one JSON object a line from standard input and answers each
with the controller's state; it ends with standard input or at Ctrl+C. Keys it obeys:

    deaf, streams, remote, accepts_scripts: true or false
    silence_s: seconds without RTDE data         drop: "control" or "receive"
    protective_stop, emergency_stop, stop_program, unlock, restart: true
"""

from __future__ import annotations

import json
import os
import select
import sys
from contextlib import suppress

import click

from drivers.mock.devices.ur_controller.controller import UrController, UrControllerSettings
from drivers.mock.devices.ur_controller.server import UrServer
from drivers.mock.plants.arm_motion import StiffPlane

REALTIME_PRIORITY = 20
"""SCHED_FIFO priority where the system allows it: a controller keeps its time whatever else is busy (assumption)."""

LOOK_S = 0.02
"""How often standard input is looked at, seconds (assumption)."""


def obey(server: UrServer, order: dict[str, object]) -> dict[str, object]:
    """Do what an order says; the controller's state afterwards."""
    if order.get("restart"):
        server.restart()
    controller = server.controller
    for name in ("deaf", "streams"):
        if name in order:
            setattr(server, name, bool(order[name]))
    for name in ("remote", "accepts_scripts"):
        if name in order:
            setattr(controller, name, bool(order[name]))
    if "silence_s" in order:
        server.silent_until_s = server.clock.monotonic_s() + float(str(order["silence_s"]))
    if "drop" in order:
        server.drop(str(order["drop"]))
    if order.get("protective_stop"):
        controller.protective_stop("asked for")
    if order.get("emergency_stop"):
        controller.emergency_stop()
    if order.get("stop_program"):
        controller.stop_program("asked for")
    if order.get("unlock"):
        controller.unlock()
    return {
        "t_s": controller.t_s,
        "runtime": controller.runtime.name,
        "safety": controller.safety.name,
        "pose": controller.arm.pose.tolist(),
        "twist": controller.arm.twist.tolist(),
        "obeyed": dict(controller.obeyed),
        "log": list(controller.log),
    }


@click.command()
@click.option("--settings", default="{}", help="UrControllerSettings as JSON.")
@click.option("--plane-m", type=float, default=None, help="Height of a stiff plane above the base, metres.")
def main(settings: str, plane_m: float | None) -> None:
    """Serve one emulated controller until standard input ends."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REALTIME_PRIORITY))
    found = UrControllerSettings.model_validate_json(settings)
    plane = StiffPlane() if plane_m is None else StiffPlane(height_m=plane_m)
    server = UrServer(UrController(found, plane))
    server.open()
    click.echo(json.dumps({"arm": {"host": found.host}}))
    pending = b""
    try:
        while True:
            server.service(server.clock.monotonic_s() + LOOK_S)
            if not select.select([sys.stdin], [], [], 0.0)[0]:
                continue
            data = os.read(sys.stdin.fileno(), 65536)
            if not data:
                return
            *lines, pending = (pending + data).split(b"\n")
            for line in lines:
                click.echo(json.dumps(obey(server, json.loads(line))))
    except KeyboardInterrupt:
        return
    finally:
        server.close()


if __name__ == "__main__":
    main()
