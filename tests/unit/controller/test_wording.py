import pytest

from behaviors.events import Contact, GuardStopped
from controller.scales import as_text
from drivers.core.messages import Excite, Gripped, Listen, MoveAt, MoveTo, Reached, Refused, Sent, Stop

MOVE = MoveTo("stage", 0.003, 0.005)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (MOVE, "stage: move to 3 mm, speed 5 mm/s"),
        (MoveAt("stage", -0.0038, 0.012), "stage: move at −3.8 mm/s, limit 12 mm"),
        (Stop("stage"), "stage: stop"),
        (Excite("board", on=False), "board: excite, off"),
        (
            Listen("board", frozenset({"board.period", "board.load_cell"})),
            "board: listen, board.load_cell, board.period",
        ),
        (Sent(1.0, "stage", MOVE), "stage: sent “move to 3 mm, speed 5 mm/s”"),
        (Refused(1.0, "stage", MOVE, "not homed"), "stage: refused “move to 3 mm, speed 5 mm/s”, not homed"),
        (Reached(1.0, "stage", 0.0031234), "stage: reached, position 3.123 mm"),
        (Gripped(1.0, "hand", True, 0.02, 1.5), "hand: gripped, object, width 20 mm, force 1.5 N"),
        (Contact(1.0, "ours", 28.71, 28.6), "ours: contact, value 28.71, threshold 28.6"),
        (GuardStopped(1.0, "force 2.1 N above 2 N"), "guard stopped, force 2.1 N above 2 N"),
    ],
)
def test_commands_and_events_are_text_with_units(message, text):
    assert as_text(message) == text
