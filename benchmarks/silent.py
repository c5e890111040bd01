"""A console that says nothing and an operator who never interrupts."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any


class Silent:
    """Nobody looks."""

    def poll(self) -> str | None:
        """Never a word."""
        return None

    def suspend(self) -> None:
        """Never asked for."""

    def state(self, name: str, t_s: float) -> None:
        """Not shown."""

    def campaign_started(self, title: str, trials: int, folder: Path) -> None:
        """Not shown."""

    def trial_started(self, trial: int, factors: Mapping[str, Any]) -> None:
        """Not shown."""

    def trial_ended(self, trial: int, outcome: str, row: Mapping[str, Any]) -> None:
        """Not shown."""

    def campaign_ended(self, line: str) -> None:
        """Not shown."""
