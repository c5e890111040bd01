"""A controller on its own, in front of a stiff plane: `python -m tests.wire.ur_controller_process`.

Prints one JSON line when it listens, with the clock that others may share (`simulator.wiring.bench_clock`), then obeys
one JSON object a line from standard input and answers each with the controller's state; it ends with standard input
or at Ctrl+C. Keys it obeys:

    deaf, streams, remote, accepts_scripts: true or false
    silence_s: seconds without RTDE data         drop: "control" or "receive"
    protective_stop, emergency_stop, stop_program, restart, gone: true
"""

import json
import os
import select
import sys
from typing import Literal

import click
from pydantic import Field, ValidationError

from drivers.core.settings import Settings
from simulator.devices.ur_controller.controller import UrController, UrControllerSettings
from simulator.devices.ur_controller.server import UrServer
from simulator.physics.arm_motion import StiffPlane
from simulator.wiring.bench_clock import BenchClock, Pace


class Order(Settings):
    """What it obeys; see the module's page for the keys."""

    restart: bool = False
    deaf: bool | None = None
    streams: bool | None = None
    remote: bool | None = None
    accepts_scripts: bool | None = None
    silence_s: float | None = Field(None, ge=0.0)
    drop: Literal["control", "receive"] | None = None
    protective_stop: bool = False
    emergency_stop: bool = False
    stop_program: bool = False
    gone: bool = False


def answered(server: UrServer, line: bytes) -> dict[str, object]:
    """Carry out the order in a line; the controller's state afterwards, or why it was refused."""
    try:
        return obey(server, Order.model_validate_json(line))
    except ValidationError as error:
        return {"refused": str(error)}


def obey(server: UrServer, order: Order) -> dict[str, object]:
    """Carry out an order; the controller's state afterwards."""
    if order.restart:
        server.restart()
    controller = server.controller
    for owner, names in ((server, ("deaf", "streams")), (controller, ("remote", "accepts_scripts"))):
        for name in names:
            if (wanted := getattr(order, name)) is not None:
                setattr(owner, name, wanted)
    if order.silence_s is not None:
        server.silent_until_s = server.clock.monotonic_s() + order.silence_s
    if order.drop is not None:
        server.drop(order.drop)
    if order.protective_stop:
        controller.protective_stop("asked for")
    if order.emergency_stop:
        controller.emergency_stop()
    if order.stop_program:
        controller.stop_program("asked for")
    if order.gone:
        server.unplug()
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
    found = UrControllerSettings.model_validate_json(settings)
    plane = StiffPlane() if plane_m is None else StiffPlane(height_m=plane_m)
    server = UrServer(UrController(found, plane))
    pace = Pace()
    server.clock = BenchClock(pace.page)
    server.listen()
    click.echo(json.dumps({"arm": {"host": found.host}, "clock": pace.page.path}))
    pending = b""
    try:
        while True:
            server.turn(pace.wait_s(server.next_s))
            pace.turn()
            if not select.select([sys.stdin], [], [], 0.0)[0]:
                continue
            data = os.read(sys.stdin.fileno(), 65536)
            if not data:
                return
            *lines, pending = (pending + data).split(b"\n")
            for line in lines:
                click.echo(json.dumps(answered(server, line)))
    except KeyboardInterrupt:
        return
    finally:
        server.unplug()


if __name__ == "__main__":
    main()
