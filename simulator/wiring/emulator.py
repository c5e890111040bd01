"""One process that holds a profile's plant and all its emulated devices, and writes the bench's time.

Run as `python -m simulator.wiring.emulator` it reads its scene as one line of JSON on standard input, answers
with one line of JSON: where the devices are, or why there are none ({"refused": …}). It ends when that
input ends. A control port on loopback takes one JSON line a request: {"trial": …} puts the plant into a trial's scene,
{"account": true} requests what the plant did, {"fault": …} injects one, whose at_s counts from now; each answer has
the plant's account and where things stand, or why the request was {"refused": …}.
"""

import contextlib
import gc
import json
import select
import socket
import sys
import traceback
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from drivers.core.compiled import make_signed
from drivers.core.errors import DeviceError
from drivers.core.settings import Settings
from simulator.devices.far_end import FarEnd
from simulator.devices.faults import Fault, FaultSchedule
from simulator.devices.tcp_clients import TcpClients
from simulator.wiring.bench_clock import BenchClock, Pace
from simulator.wiring.far_ends import Line, TcpLine, UdpLine

STEP_S = 0.002
"""How often plants and devices are stepped: a fifth of the shortest frame period of the board, and an arm's cycle."""

IDLE_S = 10.0
"""How long after the last bytes, with nobody on the bench's clock, it rests (assumption: no host waits for a device in
silence for longer). The first byte ends that at once."""

REST_S = 0.05
"""How long it rests between two steps then, s of the wall; bench time passes at less than a tenth of it. With
`realtime`, where it must not fall behind, steps are of `PASS_S`."""

PASS_S = 0.02
"""How much time may pass at once: a delayed emulator makes up for what it missed in small steps, all of its
devices together. Otherwise an arm would act in a past that the sensors have left behind (assumption)."""

BACKLOG_S = 2.0
"""How much time is made up for (assumption: longer than a busy machine delays a process)."""

LINE_BYTES = 1 << 20
"""Longest request (assumption: a hundred times the longest profile)."""

CLIENTS = 16
"""Connections at a time (assumption: a run has one, and `select` bears a thousand)."""

Answer = Mapping[str, Any]


class Request(Settings):
    """What a client can request; an empty one requests the account alone."""

    trial: int | None = Field(default=None, ge=0)
    """Number of the trial that begins; `seed`, `factors` and `plant` come with it."""
    seed: int | None = Field(default=None, ge=0)
    """Seed of the run."""
    factors: dict[str, Any] | None = None
    """Of the trial."""
    plant: dict[str, Any] | None = None
    """The profile's plant section for this trial."""
    fault: Fault | None = None
    """What breaks from now on."""
    mark: tuple[str, str] | None = Field(default=None, strict=False)
    """A device, and what its faults count from, which has come now."""
    account: bool = True
    """What the plant did: every answer has it."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        parts = {"trial": self.trial, "seed": self.seed, "factors": self.factors, "plant": self.plant}
        missing = [name for name, part in parts.items() if part is None]
        if missing and len(missing) < len(parts):
            raise ValueError(f"a trial needs {', '.join(missing)} as well")
        return self


class ControlPort:
    """A port on loopback. A client that does not read its answers is dropped.

    Args:
        answer: Handles a request, returns the answer. What it raises is sent to the client.

    Attributes:
        close: Drops all clients and closes the port.
    """

    def __init__(self, answer: Callable[[Request], Answer]) -> None:
        self._answer = answer
        self._pending: dict[socket.socket, bytearray] = {}
        self._clients = TcpClients(CLIENTS, 0, lambda client, reason: self._pending.pop(client))
        self._listener = self._clients.listen()
        host, port = self._listener.getsockname()
        self.endpoint: dict[str, Any] = {"host": host, "port": port}
        self.close = self._clients.close

    @property
    def sockets(self) -> list[socket.socket]:
        """What to select on."""
        return self._clients.sockets

    def attend(self, readable: Collection[Any]) -> None:
        """Answer what has come.

        Args:
            readable: What of `sockets` can be read.
        """
        if self._listener in readable and (client := self._clients.accept(self._listener)) is not None:
            self._pending[client] = bytearray()
        for client in [client for client in self._pending if client in readable]:
            self._receive(client)

    def _receive(self, client: socket.socket) -> None:
        pending = self._pending[client]
        *requests, rest = self._clients.receive(client).split(b"\n")
        for request in requests:
            self._send(client, self._answered(bytes(pending + request)))
            pending.clear()
        pending += rest
        if len(pending) > LINE_BYTES:
            self._send(client, {"refused": f"a request has at most {LINE_BYTES} bytes"})
            self._clients.drop(client)

    def _answered(self, line: bytes) -> Answer:
        try:
            return self._answer(Request.model_validate_json(line))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            return {"refused": f"{where}: {first['msg']}" if where else first["msg"]}
        except ValueError as error:
            return {"refused": str(error)}
        except Exception as error:  # a defect, and this client's alone: the bench goes on
            traceback.print_exc(file=sys.stderr)
            return {"refused": f"{type(error).__name__}: {error}"}

    def _send(self, client: socket.socket, answer: Answer) -> None:
        self._clients.send(client, json.dumps(answer).encode() + b"\n")


class Emulator:
    """Plant, devices and their far ends of one profile.

    Args:
        scene: `{"plant": {"made": "module:Class", "settings_class": "module:Class", "settings": {…},
            "folders": […]}, "devices": {name: {"made": "module:function", "settings_class": "module:Class",
            "settings": {…}}}, "faults": […], "realtime": false}`; a device is made by calling its function with the
            settings of its driver, of which it takes what it needs, and the bench.

    Raises:
        DeviceError: the devices do not go together.
    """

    def __init__(self, scene: Mapping[str, Any]) -> None:
        self._realtime: bool = scene.get("realtime", False)
        self._pace = Pace(free=self._realtime)
        clock = BenchClock(self._pace.page)
        self._bench, devices = wired(scene)
        self._ends: dict[str, FarEnd] = {name: _far_end(device) for name, device in devices.items()}
        self._bench.warm_up()
        make_signed()
        faults = [Fault.model_validate(fault) for fault in scene.get("faults", ())]
        self._faults = {
            name: FaultSchedule([fault for fault in faults if fault.device == name]) for name in self._ends
        }
        for name, end in self._ends.items():
            end.open(self._faults[name], clock)
        self._t_s = self._pace.turn()  # compiling may have taken longer than time waits for an emulator
        self._trial_origin_s = 0.0
        self._control = ControlPort(self._answer)

    @property
    def endpoints(self) -> dict[str, Any]:
        """Where everything is, as `run.py emulate` prints it."""
        return {
            "devices": {name: dict(end.endpoint) for name, end in self._ends.items()},
            "control": self._control.endpoint,
            "clock": self._pace.page.path,
            "realtime": self._realtime,
        }

    def serve(self, ended: Callable[[], bool]) -> None:
        """Run until `ended()`, which is called once a step."""
        ends = dict(self._ends)
        busy_s = self._t_s
        # these objects stay: a full collection in the middle of a motion would delay all devices
        gc.collect()
        gc.freeze()
        try:
            while not ended():
                waited = [one for end in ends.values() for one in end.waited()]
                idle = self._t_s - busy_s > IDLE_S and not self._pace.attended
                step_s = PASS_S if idle else STEP_S
                due_s = min([self._t_s + step_s, *(end.due_s() for end in ends.values())])
                wait_s = self._pace.wait_s(due_s, REST_S if idle and not self._realtime else 0.0)
                ready, _, _ = select.select([*waited, *self._control.sockets], [], [], wait_s)
                now_s = self._pace.turn(frozenset(name for name, end in ends.items() if end.unread()))
                if not ready and now_s < due_s:
                    continue  # time waits for a client
                self._t_s = max(min(now_s, self._t_s + PASS_S), now_s - BACKLOG_S)
                for name, end in list(ends.items()):
                    try:
                        if end.exchange(ready, self._t_s, self._t_s - self._trial_origin_s) is not False:
                            busy_s = self._t_s
                    except Exception:  # a defect costs its own device: the host sees that one's link end
                        traceback.print_exc(file=sys.stderr)
                        ends.pop(name).unplug()
                self._control.attend(
                    ready
                )  # last: what devices send of the time before a trial is of that time
        finally:
            for end in self._ends.values():
                end.unplug()
            self._control.close()

    def _answer(self, request: Request) -> Mapping[str, Any]:
        """Handle a request on the control port."""
        t_s = self._t_s
        if (fault := request.fault) is not None and fault.device not in self._faults:
            raise ValueError(f"there is no {fault.device} here; there are {', '.join(self._faults)}")
        if request.trial is not None:
            self._bench.begin(t_s, request.seed, request.trial, request.factors, request.plant)
            self._trial_origin_s = t_s
            for faults in self._faults.values():
                faults.restart(request.trial)
        if fault is not None:
            at_s = t_s - self._trial_origin_s + fault.at_s
            self._faults[fault.device].add(fault.model_copy(update={"at_s": at_s}))
        if request.mark is not None:
            device, what = request.mark
            self._faults[device].mark(what, t_s - self._trial_origin_s)
        effects = [each for faults in self._faults.values() for each in faults.shown()]
        account = {**self._bench.account(), **({"faults": effects} if effects else {})}
        return {"account": account, "scene": dict(self._bench.scene(t_s))}


def wired(scene: Mapping[str, Any]) -> tuple[Any, Mapping[str, Any]]:
    """The plant of a scene, and its emulated devices by name, which nobody can reach yet.

    Raises:
        DeviceError: the devices do not go together.
    """
    plant = scene["plant"]
    sys.path += plant.get("folders", ())
    bench = _found(plant["made"])(_found(plant["settings_class"]).model_validate(plant["settings"]))
    devices = {}
    for name, device in scene["devices"].items():
        settings = _found(device["settings_class"]).model_validate_json(json.dumps(device["settings"]))
        devices[name] = _found(device["made"])(settings, bench)
    return bench, devices


def _far_end(device: Any) -> FarEnd:
    """An emulated device at the end of a wire of its kind; one with an `exchange` is its own."""
    if hasattr(device, "exchange"):
        own: FarEnd = device
        return own
    if hasattr(device, "datagram"):
        return UdpLine(device)
    return TcpLine(device) if hasattr(device, "hang_up") else Line(device)


def _found(name: str) -> Any:
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute)


def main() -> None:
    """Serve the scene on standard input until that input ends."""
    try:
        emulator = Emulator(json.loads(sys.stdin.readline()))
    except DeviceError as error:
        reason = {
            "device": error.device,
            "doing": error.doing,
            "reason": error.reason,
            "advice": error.advice,
        }
        sys.stdout.write(json.dumps({"refused": reason}) + "\n")
        return
    sys.stdout.write(json.dumps(emulator.endpoints) + "\n")
    sys.stdout.flush()

    def ended() -> bool:
        ready, _, _ = select.select([sys.stdin], [], [], 0.0)
        return bool(ready)

    with contextlib.suppress(KeyboardInterrupt):
        emulator.serve(ended)


if __name__ == "__main__":
    main()
