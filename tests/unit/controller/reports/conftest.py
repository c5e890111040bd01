import pytest

from controller.reports.figures import Figures


@pytest.fixture
def undrawn(monkeypatch):
    """For tests that read the page's text alone: drawing every figure thrice takes seconds."""
    monkeypatch.setattr(Figures, "save", lambda self, figure, name: "<svg></svg>")
