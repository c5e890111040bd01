"""The Robotiq driver over TCP, as at the URCap's port, to its emulated twin."""

import socket
import threading
import time
from types import SimpleNamespace

from drivers.core.clock import WallClock
from drivers.core.messages import Failed, Gripped, Listen
from drivers.robotiq.driver import Robotiq
from drivers.robotiq.settings import RobotiqSettings
from simulator.devices.robotiq import EmulatedRobotiq
from tests.contracts.gripper_suite import GRIP, SCENE, GripperBench, calibrated_jaws


def test_an_object_is_gripped_over_tcp_and_a_server_that_hangs_up_is_a_failure() -> None:
    drive, lock, over = calibrated_jaws(), threading.Lock(), threading.Event()
    widths = {"closed_width_m": SCENE.closed_width_m, "open_width_m": 0.068}
    twin = EmulatedRobotiq(RobotiqSettings(port="-", **widths), SimpleNamespace(jaws=drive))
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with server.accept()[0] as connection:
            connection.settimeout(0.01)
            while not over.is_set():
                try:
                    data = connection.recv(4096)
                except TimeoutError:
                    continue
                with lock:
                    answer = twin.receive(data, time.monotonic())
                connection.sendall(answer)

    thread = threading.Thread(target=serve)
    thread.start()
    where = f"socket://127.0.0.1:{server.getsockname()[1]}"
    settings = RobotiqSettings(port=where, reply_timeout_s=10.0, **widths)  # the machine may be busy

    def change(scene: object) -> None:
        with lock:
            scene(drive)

    bench = GripperBench(Robotiq("gripper", settings, WallClock()), WallClock(), change)
    bench.place("mug")
    bench.device.apply(Listen("gripper", frozenset({"gripper.width"})))
    bench.device.apply(GRIP)
    gripped = bench.until(Gripped)
    assert gripped.object
    assert abs(gripped.width_m - 0.039) < 0.3e-3
    assert bench.blocks_of("gripper.width")
    over.set()
    thread.join(10.0)
    assert "taken away" in bench.until(Failed).reason
    bench.device.close()
    server.close()
