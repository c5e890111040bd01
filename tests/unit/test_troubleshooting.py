"""The troubleshooting page has every message of the program, and no other."""

from tests import messages


def test_every_message_is_an_entry_and_every_entry_a_message() -> None:
    written = messages.PAGE.read_text().partition(messages.MARK)[2]
    lines = {line for line in written.splitlines() if line.startswith("| ")}
    entries = {line for line in messages.tables().splitlines() if line.startswith("| ")}
    assert not entries - lines, f"python -m tests.messages adds: {sorted(entries - lines)[:5]}"
    assert not lines - entries, f"python -m tests.messages removes: {sorted(lines - entries)[:5]}"
    assert len(entries) > 300


def test_a_message_is_found_with_its_remedy_and_what_varies() -> None:
    arm = messages.messages()["A device does not answer"]
    assert ("the controller's time has stood still for … s", "is the cable in, and the controller up?") in arm
