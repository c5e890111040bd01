"""One process that holds a profile's plant and all its emulated devices, and writes the bench's time.

Run as `python -m simulator.wiring.emulator` it reads its scene as one line of JSON on standard input, answers
with one line of JSON: where the devices are, or why there are none ({"refused": …}). It ends when that
input ends. A control port on loopback takes one JSON line a request: {"trial": …} puts the plant into a trial's scene,
{"account": true} requests what the plant did, {"fault": …} injects one, whose at_s counts from now; each answer has
the plant's account and where things stand, or why the request was {"refused": …}.
"""

from __future__ import annotations

import contextlib
import gc
import json
import select
import sys
import traceback
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from drivers.core.compiled import make_signed
from drivers.core.errors import DeviceError
from simulator.devices.faults import Fault, FaultSchedule
from simulator.devices.ur_controller.server import UrServer
from simulator.wiring.bench_clock import BenchClock, Pace
from simulator.wiring.control_port import ControlPort, Request
from simulator.wiring.far_ends import FarEnd, Line, Network, TcpLine

STEP_S = 0.002
"""How often plants and devices are stepped: a fifth of the shortest frame period of the board, and an arm's cycle."""

IDLE_S = 10.0
"""How long after the last bytes, with nobody on the bench's clock, it does with steps of `PASS_S`, and time passes at a
third of the wall's (assumption: no host waits for a device in silence for longer). The first byte ends that at once."""

PASS_S = 0.02
"""How much time may pass at once: a delayed emulator makes up for what it missed in small steps, all of its
devices together. Otherwise an arm would act in a past that the sensors have left behind (assumption)."""

BACKLOG_S = 2.0
"""How much time is made up for (assumption: longer than a busy machine delays a process)."""


class Emulator:
    """Plant, devices and their far ends of one profile.

    Args:
        scene: `{"plant": {"made": "module:Class", "settings_class": "module:Class", "settings": {…},
            "folders": […]}, "devices": {name: {"made": "module:function",
            "settings": {…}}}, "faults": […], "realtime": false}`; a device is made by calling its function with the
            settings of its driver, of which it takes what it needs, and the bench.

    Raises:
        DeviceError: the devices do not go together.
    """

    def __init__(self, scene: Mapping[str, Any]) -> None:
        self._realtime: bool = scene.get("realtime", False)
        self._pace = Pace(free=self._realtime)
        clock = BenchClock(self._pace.page)
        plant = scene["plant"]
        sys.path += plant.get("folders", ())
        made = _found(plant["made"])
        self._bench = made(_found(plant["settings_class"]).model_validate(plant["settings"]))
        self._ends: dict[str, FarEnd] = {
            name: _far_end(_found(device["made"])(device["settings"], self._bench))
            for name, device in scene["devices"].items()
        }
        self._bench.warm_up()
        make_signed()
        faults = [Fault.model_validate(fault) for fault in scene.get("faults", ())]
        self._faults = {
            name: FaultSchedule([fault for fault in faults if fault.device == name]) for name in self._ends
        }
        for name, end in self._ends.items():
            end.open(self._faults[name], clock)
        self._t_s = clock.monotonic_s()
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
                ready, _, _ = select.select(
                    [*waited, *self._control.sockets], [], [], self._pace.wait_s(due_s)
                )
                now_s = self._pace.turn(frozenset(name for name, end in ends.items() if end.unread()))
                if not ready and now_s < due_s:
                    continue  # time waits for a client
                self._t_s = max(min(now_s, self._t_s + PASS_S), now_s - BACKLOG_S)
                self._control.attend(ready)
                for name, end in list(ends.items()):
                    try:
                        if end.exchange(ready, self._t_s, self._t_s - self._trial_origin_s) is not False:
                            busy_s = self._t_s
                    except Exception:  # a defect costs its own device: the host sees that one's link end
                        traceback.print_exc(file=sys.stderr)
                        ends.pop(name).unplug()
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
        return {"account": dict(self._bench.account()), "scene": dict(self._bench.scene(t_s))}


def _far_end(device: Any) -> FarEnd:
    """An emulated device at the end of a wire of its kind; one with an `exchange` is its own."""
    if isinstance(device, UrServer):
        return Network(device)
    if hasattr(device, "exchange"):
        own: FarEnd = device
        return own
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
