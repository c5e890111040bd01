"""One process that holds a profile's plant and all its emulated devices, in real time.

Run as `python -m drivers.mock.emulator` it reads its scene as one line of JSON on standard input, answers
with one line of JSON that says where the devices are, and ends when that input ends. A control port on
loopback takes one JSON line a request: {"trial": …} puts the plant into a trial's scene, {"account": true} asks
what the plant did, {"fault": …} injects one now; each answer has the plant's account and where things stand.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import pty
import select
import socket
import sys
import tty
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, Protocol

from drivers.clock import WallClock
from drivers.mock.faults import Fault, FaultSchedule

STEP_S = 0.001
"""How often plants and devices are stepped: a tenth of the shortest frame period of the board."""

READ_BYTES = 4096


class EmulatedDevice(Protocol):
    """A device made of software, at the far end of a serial line."""

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Take bytes from the host; returns what is answered at once."""

    def step(self, t_s: float) -> bytes:
        """What the device says by `t_s` without being asked."""

    def inject(self, kind: str, t_s: float) -> None:
        """Break something of the device's own (a stall, a refusal)."""


class _Line:
    """A pty with an emulated device at its far end, and the faults of the wire."""

    def __init__(self, name: str, device: EmulatedDevice, faults: FaultSchedule) -> None:
        self.name = name
        self.device = device
        self.faults = faults
        self._far, near = pty.openpty()
        tty.setraw(near)
        os.set_blocking(self._far, False)
        self.port = os.ttyname(near)
        # One end stays open here, so that the line survives a host that closes and opens it again.
        self._near: int | None = near

    @property
    def endpoint(self) -> int | None:
        """What to select on, or None once the plug is pulled."""
        return self._far if self._near is not None else None

    def unplug(self) -> None:
        """Pull the plug: the host sees its port vanish."""
        if self._near is not None:
            os.close(self._near)
            os.close(self._far)
            self._near = None

    def exchange(self, readable: bool, t_s: float) -> None:
        """Carry bytes both ways."""
        if self._near is None:
            return
        out = b""
        if readable:
            with contextlib.suppress(OSError):
                out = self.device.receive(os.read(self._far, READ_BYTES), t_s)
        out += self.device.step(t_s)
        if out and not self.faults.active(t_s, "silent"):
            self._write(self._corrupted(out, t_s))

    def _corrupted(self, out: bytes, t_s: float) -> bytes:
        if self.faults.active(t_s, "lose"):
            return b""
        if self.faults.active(t_s, "corrupt"):
            return bytes(byte ^ 0x10 if place % 7 == 3 else byte for place, byte in enumerate(out))
        return out

    def _write(self, out: bytes) -> None:
        try:
            os.write(self._far, out)
        except OSError as error:
            # Nobody reads: a real board's bytes fall on the floor as well.
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise

    def fail(self, t_s: float) -> None:
        """Let the faults happen that have begun."""
        if self.faults.begun(t_s, "unplug"):
            self.unplug()
        for kind in ("stall", "refuse"):
            if self.faults.begun(t_s, kind) is not None:
                with contextlib.suppress(ValueError):  # a board cannot stall: then it does not
                    self.device.inject(kind, t_s)


class Emulator:
    """Plant, devices and ptys of one profile.

    Args:
        scene: `{"plant": {"made": "module:Class", "settings": {…}}, "devices": {name: {"made": "module:function",
            "settings": {…}}}, "faults": […]}`; a device is made by calling its function with settings and bench.
    """

    def __init__(self, scene: Mapping[str, Any]) -> None:
        self._clock = WallClock()
        plant = scene["plant"]
        made = _found(plant["made"])
        self._bench = made(_found(plant["settings_class"]).model_validate(plant["settings"]))
        faults = [Fault.model_validate(fault) for fault in scene.get("faults", ())]
        self._lines = [
            _Line(
                name,
                _found(device["made"])(device["settings"], self._bench),
                FaultSchedule([fault for fault in faults if fault.device == name]),
            )
            for name, device in scene["devices"].items()
        ]
        self._bench.warm_up()
        self._trial_origin_s = 0.0
        self._control = socket.create_server(("127.0.0.1", 0))
        self._control.setblocking(False)
        self._clients: dict[socket.socket, bytes] = {}

    @property
    def endpoints(self) -> dict[str, Any]:
        """Where everything is, as `run.py emulate` prints it."""
        host, port = self._control.getsockname()
        return {
            "devices": {line.name: {"port": line.port} for line in self._lines},
            "control": {"host": host, "port": port},
        }

    def serve(self, ended: Callable[[], bool]) -> None:
        """Run until `ended()`, which is asked once a step."""
        try:
            while not ended():
                waited: list[Any] = [line.endpoint for line in self._lines if line.endpoint is not None]
                readable, _, _ = select.select([*waited, self._control, *self._clients], [], [], STEP_S)
                t_s = self._clock.now()
                self._attend(readable)
                for line in self._lines:
                    line.fail(t_s - self._trial_origin_s)
                    line.exchange(line.endpoint in readable, t_s)
        finally:
            for line in self._lines:
                line.unplug()
            for client in [*self._clients, self._control]:
                client.close()

    def _attend(self, readable: list[Any]) -> None:
        """Answer what came on the control port."""
        if self._control in readable:
            client, _ = self._control.accept()
            client.setblocking(False)
            self._clients[client] = b""
        for client in [client for client in self._clients if client in readable]:
            try:
                data = client.recv(READ_BYTES)
            except OSError:
                data = b""
            if not data:
                del self._clients[client]
                client.close()
                continue
            *requests, self._clients[client] = (self._clients[client] + data).split(b"\n")
            for request in requests:
                client.sendall(json.dumps(self._answer(json.loads(request))).encode() + b"\n")

    def _answer(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        t_s = self._clock.now()
        if "trial" in request:
            trial = int(request["trial"])
            self._trial_origin_s = t_s
            self._bench.begin(t_s, int(request["seed"]), trial, request["factors"], request["plant"])
            for line in self._lines:
                line.faults.restart(trial)
        if "fault" in request:
            fault = Fault.model_validate(request["fault"])
            for line in self._lines:
                if line.name == fault.device:
                    line.faults.add(fault)
        return {"account": dict(self._bench.account()), "scene": dict(self._bench.scene(t_s))}


def _found(name: str) -> Any:
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute)


def main() -> None:
    """Serve the scene on standard input until that input ends."""
    emulator = Emulator(json.loads(sys.stdin.readline()))
    sys.stdout.write(json.dumps(emulator.endpoints) + "\n")
    sys.stdout.flush()

    def ended() -> bool:
        ready, _, _ = select.select([sys.stdin], [], [], 0.0)
        return bool(ready)

    with contextlib.suppress(KeyboardInterrupt):
        emulator.serve(ended)


if __name__ == "__main__":
    main()
