"""A make of arm beside a profile: its module is found by the arm's process too."""

import importlib
import sys
import time
from pathlib import Path

import pytest

from drivers.arm.host import ArmHost
from drivers.arm.link import LinkError
from drivers.arm.settings import ArmSettings
from drivers.core.clock import WallClock
from drivers.core.errors import RefusedError

OWN = """
from drivers.arm.link import LinkError
from drivers.core.errors import RefusedError

class OwnLink:
    package, extra = "pytest", "own"

    def __init__(self, settings, clock):
        pass

    def open(self, again):
        raise LinkError(RefusedError, "it is my own", "nothing to do")
"""


@pytest.mark.parametrize("place", ["own_arm_lab.py", "own_arm_lab/__init__.py"])
def test_a_link_beside_a_profile_is_found_by_the_arm_s_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    file = tmp_path / place
    file.parent.mkdir(exist_ok=True)
    file.write_text(OWN)
    with monkeypatch.context() as found:
        found.syspath_prepend(tmp_path)
        module = importlib.import_module("own_arm_lab")
    monkeypatch.delitem(sys.modules, "own_arm_lab", raising=False)
    monkeypatch.setitem(sys.modules, "own_arm_lab", module)
    settings = ArmSettings(host="-", rate_hz=500.0, start_pose=(0.4, 0.0, 0.2, 0.0, 3.0, 0.0))
    host = ArmHost("arm", settings, module.OwnLink, WallClock(), again=False)
    received: list[object] = []
    deadline_s = time.monotonic() + 100.0  # a busy machine starts Python slowly
    while not received and not host.exit_reason() and time.monotonic() < deadline_s:
        received = host.receive()
        time.sleep(0.01)
    host.kill()
    (error,) = received
    assert isinstance(error, LinkError)
    assert error.args == (RefusedError, "it is my own", "nothing to do")
