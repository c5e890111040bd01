"""A fault in words, as `--fault` takes it: "board freeze 80 ms in APPROACH"."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

WORDS: Mapping[str, str] = {
    "off": "unplug",
    "freeze": "silent",
    "garbage": "corrupt",
    "intermittent": "lose",
    "delayed": "late",
}
"""Other words for kinds: those of PX4's failure injection, where ours differ."""

UNITS_S = {"s": 1.0, "ms": 1e-3, "min": 60.0}

FORM = "DEVICE KIND [80 ms] [by AMOUNT] [at 0.5 s] [in STATE] [after write 3] [every 2 s] [times 3] [trial 1]"

_TIME = r"(?P<{}>[0-9.]+) ?(?P<{}_unit>ms|s|min)"
_FAULT = re.compile(
    r"(?P<device>\w+) (?P<kind>\w+)"
    rf"(?: (?:for )?{_TIME.format('for_s', 'for_s')})?"
    r"(?: by (?P<amount>-?[0-9.e-]+))?"
    rf"(?: at {_TIME.format('at_s', 'at_s')})?"
    r"(?: in (?P<state>[A-Z_]+))?(?: after (?P<after>\w+ \d+))?"
    rf"(?: every {_TIME.format('every_s', 'every_s')})?"
    r"(?: times (?P<times>\d+))?(?: trial (?P<trial>\d+))?"
)


def fault_of(words: str) -> dict[str, Any]:
    """A fault as a profile has it.

    Raises:
        ValueError: not of that form.
    """
    found = _FAULT.fullmatch(" ".join(words.split()))
    if found is None:
        raise ValueError(f"'{words}' is no fault; write {FORM}")
    said = {name: text for name, text in found.groupdict().items() if text is not None}
    kind = said["kind"]
    fault: dict[str, Any] = {"device": said["device"], "kind": WORDS.get(kind, kind)}
    for key in ("for_s", "at_s", "every_s"):
        if key in said:
            fault[key] = float(said[key]) * UNITS_S[said[f"{key}_unit"]]
    if "amount" in said:
        fault["amount"] = float(said["amount"])
    fault |= {key: int(said[key]) for key in ("times", "trial") if key in said}
    if after := said.get("state") or said.get("after"):
        fault["after"] = after
    if kind == "intermittent" and "every_s" not in fault:
        fault |= {"for_s": fault.get("for_s", 0.02), "every_s": 0.1}
    return fault
