"""What all tests share: the examples that hypothesis tries, and the order."""

import gc

import pytest
from hypothesis import HealthCheck, settings

from tests.program import Verb

# An example takes as long as the machine lets it, and the examples are the same on every machine: what is searched at
# random belongs to a search, not to a verdict.
settings.register_profile(
    "touchbench", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("touchbench")

collect_ignore = ["hardware"]
"""The real bench is tested where its tests are asked for by name alone."""

LONG = ("scenarios", "stability")
"""Folders whose modules take long, the longest first."""


def pytest_sessionstart():
    """What is imported stays: to look for garbage meanwhile took a third of the time."""
    gc.disable()


@pytest.hookimpl(tryfirst=True)
def pytest_runtestloop():
    """From here on there is garbage; not among what was imported."""
    gc.freeze()
    gc.enable()


@pytest.fixture
def verb(capsys: pytest.CaptureFixture[str]) -> Verb:
    """Calls the program as `run.py …` does; gives exit code, output and errors."""
    from run import cli

    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main([str(argument) for argument in arguments], prog_name="run.py")
        printed = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, printed.out, printed.err

    return call


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long modules begin first, so that no worker is left with one when the others have ended."""
    items.sort(
        key=lambda item: next((LONG.index(part) for part in item.path.parts if part in LONG), len(LONG))
    )
