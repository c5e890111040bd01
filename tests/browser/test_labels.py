"""No label of a report is clipped or stands over another: checked by the boxes that a browser gives them."""

from pathlib import Path

import pytest

from config import assemble
from config.profile import load_profile
from controller.campaign import Campaign
from controller.recording.reader import open_run
from controller.registry import EXPERIMENTS
from controller.reports.report import build_report
from tests.browser.conftest import SOON_MS
from tests.scenarios.conftest import SHORTER, Script

LABELS = (Path(__file__).parent / "labels.js").read_text("utf-8")

OF = {"aura": "touch"}
"""The profile of an experiment where it has another name."""

PAPER_PX = 794
"""Width of an A4 page, in the page's dots."""


@pytest.fixture(scope="module")
def wrong(browser):
    """What is wrong with a page: on a desk and on a telephone, light, dark and printed."""

    def check(path):
        page = browser.new_page()
        page.set_default_timeout(SOON_MS)
        page.goto(path.as_uri())
        found: dict[object, list[str]] = {}
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            for width in (1280, 420):
                page.set_viewport_size({"width": width, "height": 800})
                found[scheme, width] = page.evaluate(LABELS)
        page.set_viewport_size({"width": PAPER_PX, "height": 1123})
        page.emulate_media(media="print")
        found["printed"] = page.evaluate(LABELS)
        page.close()
        return {where: labels for where, labels in found.items() if labels}

    return check


@pytest.mark.parametrize("experiment", sorted(EXPERIMENTS))
def test_no_label_of_a_report_is_clipped_or_over_another(experiment, wrong, tmp_path):
    """Of each experiment, whose profiles share one section: a trial in virtual time, shortened."""
    name = f"mock/{OF.get(experiment, experiment)}"
    profile = load_profile(name, SHORTER.get(name, {}) | {"loop.rate_hz": "50.0"})
    plan = assemble.plan_campaign(profile, profile.trials(1)[:1], 1)
    outcome = Campaign(plan, assemble.build_rig(profile), Script(), tmp_path).run()
    assert wrong(build_report([open_run(outcome.folder)])) == {}


def test_a_label_that_is_clipped_and_one_over_another_are_found(wrong, tmp_path):
    page = tmp_path / "page.html"
    text = '<text x="{}" y="40">frequency</text>'
    svg = "".join(text.format(x) for x in (10, 40, 180))
    page.write_text(f"<figure><svg width=200 height=80>{svg}</svg></figure><p>{'x' * 400}", "utf-8")
    labels = wrong(page)["light", 1280]
    assert "clipped: frequency" in labels
    assert "over one another: frequency | frequency" in labels
    assert any(label.startswith("wider than its place: xxx") for label in labels)
    assert any(label.startswith("the page is ") for label in labels)
