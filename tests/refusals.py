"""What a refusal must hold: one line that names the place, what is wrong there, and the remedy; in any wording."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


def check_refusal(line: str, *named: str) -> None:
    """Check the line of a refusal.

    Args:
        line: As it is printed, or the text of the error.
        named: What it must name: device or file, setting, value, and the words of the remedy that cannot be said
            otherwise (a setting, an option, a command).
    """
    assert len(line.splitlines()) == 1, f"not one line: {line!r}"
    missing = [each for each in named if each.casefold() not in line.casefold()]
    assert not missing, f"{line!r} does not name {missing}"


@contextmanager
def refused(kind: type[Exception], *named: str) -> Iterator[None]:
    """Check that what is done in here is refused by an error of this kind, whose text names all that it must.

    Example:
        with refused(DeviceError, "stage", "unplugged", "power and cable"):
            stage.open()
    """
    with pytest.raises(kind) as caught:
        yield
    check_refusal(str(caught.value), *named)
