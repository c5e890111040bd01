"""The live page in a real browser: Chromium without a window, which finds no network."""

import json
import math
import os
import signal

import pytest

from controller.watching.page import Door, PageProcess
from tests.browser.conftest import SOON_MS
from tests.stub_run import StubRun

CAPITAL = """(element) => {
  const pen = document.createElement("canvas").getContext("2d");
  const {fontWeight, fontSize, fontFamily} = getComputedStyle(element);
  pen.font = `${fontWeight} ${fontSize} ${fontFamily}`;
  return pen.measureText("H").actualBoundingBoxAscent;
}"""
"""Height of an element's capitals, px."""


class Watching:
    """A run, the process that serves its page, and browsers that look at it."""

    def __init__(self, browser, root):
        self._browser = browser
        self._pages = []
        self.errors, self.asked = [], []
        door = Door.open()
        self.link = door.link
        self.process = PageProcess(door)
        self.run = StubRun(root / "run", self.process.began)

    def look(self, link=None):
        page = self._browser.new_page()
        self._pages.append(page)
        page.set_default_timeout(SOON_MS)
        page.on("request", lambda request: self.asked.append(request.url))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.goto(link or self.link)
        page.wait_for_selector("body[data-state]")
        return page

    def look_away(self):
        while self._pages:
            self._pages.pop().close()

    def end(self):
        self.look_away()
        self.run.end()
        self.process.close()


def watched(browser, root):
    watching = Watching(browser, root)
    yield watching
    watching.end()
    hosts = ("http://127.0.0.1:", "ws://127.0.0.1:", "data:", "blob:")
    assert [url for url in watching.asked if not url.startswith(hosts)] == [], (
        "it sends requests to this process alone"
    )
    assert watching.errors == []


@pytest.fixture(scope="module")
def endless(browser, tmp_path_factory):
    yield from watched(browser, tmp_path_factory.mktemp("watched"))


@pytest.fixture
def watching(endless):
    """Of a run that no operator ends."""
    yield endless
    endless.look_away()


@pytest.fixture
def ending(browser, tmp_path):
    """Of a run that the test ends, or whose page it does."""
    yield from watched(browser, tmp_path)


def test_it_shows_the_state_the_signals_the_margins_the_trials_and_the_events(watching):
    page = watching.look()
    assert page.locator("#now").inner_text().startswith("Now trial 3, location f, speed 3.785 mm/s: ")
    assert page.locator("#state").inner_text() == "APPROACH"
    assert page.locator("#verdict").inner_text() == "1 of 42 done: none failed"
    assert page.locator("#counts").inner_text() == "So far, contact: 1"
    assert "left" in page.locator("#now").inner_text()
    assert "contact 2" in page.locator("#thresholds").inner_text()
    assert page.locator("#thresholds .bar.idle").count() == 1, (
        "full or not, it is no alarm: HOMING acts on none"
    )
    assert page.locator("#diagram .here").text_content() == "APPROACH"
    for stream in ("detector.contact", "board.period", "board.load_cell", "stage.position"):
        page.wait_for_selector(f'[data-stream="{stream}"] path.signal')
    assert page.locator('[data-stream="detector.contact"] path.threshold').count() == 1
    assert "force 0.0" in page.locator("#margins").inner_text()
    assert "board.load_cell" in page.locator("#streams").inner_text()
    assert page.locator("#rows tr").inner_text().split() == ["2", "contact", "f", "3.785", "0.212", "0.04"]
    assert "contact: contact, value" in page.locator("#events").inner_text()


LONGEST = "SEEKING_BACKWARD"
"""Of all states of the shipped behaviors."""

CAP_PX = 2000.0 * math.tan(math.radians(20.0 / 60.0)) / (216.0 / 1280.0)
"""Height of a capital that subtends 20 minutes of arc at 2 m, on a tablet of 10.1 inches, 216 mm and 1280 dots wide."""


def test_state_verdict_and_stop_are_read_from_two_metres(watching, monkeypatch):
    """By the capitals that the browser's own font draws; whatever stands below is scrolled."""
    page = watching.look()
    page.set_viewport_size({"width": 1280, "height": 800})
    console = watching.run.console
    monkeypatch.setattr(console, "present", console.present._replace(state=LONGEST))
    page.wait_for_selector(f'body[data-state="{LONGEST}"]')
    page.mouse.wheel(0, 3000)
    for name in ("#state", "#verdict", "#stop"):
        high = page.locator(name).evaluate(CAPITAL)
        assert high >= CAP_PX, f"{name}: {high} px"
        box = page.locator(name).bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= 1280
        assert box["y"] >= 0 and box["y"] + box["height"] <= 300, "in the upper part, the rest is for signals"
    stop, state = (page.locator(name).bounding_box() for name in ("#stop", "#state"))
    assert state["x"] + state["width"] <= stop["x"], "the longest state is narrower, not cut"


def test_two_who_watch_see_the_same_and_each_can_pause_and_go_on(watching):
    one, other = watching.look(), watching.look()
    one.get_by_role("button", name="Pause").click()
    other.wait_for_selector('body[data-state="PAUSED"]')
    assert "PAUSED by a click on the live page: nothing moves" in other.locator("#banner").inner_text()
    assert "On Resume this trial goes on in HOMING" in other.locator("#banner").inner_text(), (
        "as the behavior's table says"
    )
    assert other.locator("#diagram .next").text_content() == "HOMING"
    assert "Detected in this trial: contact at " in other.locator("#banner").inner_text()
    other.get_by_role("button", name="Resume").click()
    one.wait_for_selector('body[data-state="APPROACH"]')
    assert watching.run.received() == ["pause", "resume"]


def test_one_click_stops_and_the_stop_is_latched_over_a_reload(ending):
    page = ending.look()
    page.get_by_role("button", name="Stop").click()
    page.wait_for_selector('#stop[aria-pressed="true"]')
    assert ending.run.received() == ["abort"]
    page.reload()
    page.wait_for_selector('#stop[aria-pressed="true"]')
    assert page.get_by_role("button", name="Stopped").is_visible()
    assert "not a safety function" in page.locator("#stopping").inner_text()


def test_after_the_end_it_stays_says_who_ended_it_and_leads_to_the_report_and_on(ending):
    page = ending.look()
    ended = {"exit": {"status": "aborted", "code": 130, "reason": "interrupted"}}
    (ending.run.folder / "manifest.json").write_text(json.dumps(ended))
    said = '<meta name="description" content="2 of 42 trials succeeded &amp; more.">'
    (ending.run.folder / "report.html").write_text(f"{said}<title>what came out</title>")
    ending.run.end()
    page.wait_for_selector('body[data-state="ended"]')
    page.get_by_text("stopped by the test").wait_for()
    page.get_by_text("2 of 42 trials succeeded & more.").wait_for()
    page.get_by_text(f"run.py resume {ending.run.folder}").wait_for()
    assert page.locator("#state").inner_text() == "STOPPED"
    assert page.locator("#diagram .here, #diagram .next").count() == 0, "no state is entered any more"
    assert page.locator("#diagram .last").text_content() == "STOPPING", "where it ended"
    page.wait_for_selector("#stop:disabled")
    page.reload()
    with page.expect_popup() as report:
        page.get_by_role("link", name="Open the report").click()
    report.value.wait_for_load_state()
    assert report.value.title() == "what came out"
    report.value.close()


def test_a_click_on_a_trial_shows_its_signals_and_gaps_as_gaps(watching):
    page = watching.look()
    signals = {"board.period": {"t": [0, 1, 2, 2, 3], "y": [1, 2, None, 3, 4], "label": "the period"}}
    page.route("**/trial?**", lambda route: route.fulfill(json={"trial": 2, "signals": signals}))
    page.locator("#rows tr").click()
    page.get_by_text("Signals of trial 2").wait_for()
    page.wait_for_selector('#panels [aria-label="the period"] path.signal')
    assert page.locator("#panels [data-stream]").count() == 1
    page.get_by_role("button", name="Back to the present").click()
    page.wait_for_selector('[data-stream="detector.contact"] path.signal')


def test_held_between_trials_it_offers_home_and_tare_and_shows_a_refusal(watching, monkeypatch):
    page = watching.look()
    between = watching.run.watched.between
    monkeypatch.setattr(between, "possible", True)
    page.get_by_role("button", name="Hold after this trial").click()
    page.get_by_role("button", name="Holds after this trial").wait_for()
    assert between.hold
    monkeypatch.setattr(between, "_offer", {"home": ["stage"], "tare": ["board.load_cell"]})
    page.get_by_role("button", name="home stage").click()
    page.get_by_text("home stage …").wait_for()
    assert between.ask("tare", "board.load_cell") == "tare: home stage is still being done"
    assert "HELD between two trials" in page.locator("#banner").inner_text()
    monkeypatch.setattr(between, "_asked", None)
    monkeypatch.setattr(between, "ask", lambda do, target, on: f"{do} {target}: not now")
    page.get_by_role("button", name="tare board.load_cell").click()
    page.get_by_text("Refused: tare board.load_cell: not now").wait_for()


def test_a_question_of_the_bench_is_answered(watching):
    page = watching.look()
    watching.run.ask("hang 0.50 N on bridge Fx")
    page.get_by_text("hang 0.50 N on bridge Fx").wait_for()
    page.get_by_role("button", name="Done", exact=True).click()
    page.wait_for_selector("#question", state="hidden")
    assert watching.run.asker.answers == [(7, True)]


def test_a_dead_page_says_that_it_stops_nothing_and_the_run_goes_on(ending):
    page = ending.look()
    os.kill(ending.process.pid, signal.SIGKILL)
    page.get_by_text("this page can stop nothing now").wait_for()
    assert page.get_by_role("button", name="Stop").is_disabled()
    before = ending.run.turns
    page.wait_for_timeout(100)
    assert ending.run.turns > before


@pytest.mark.parametrize("width", [420, 1280])
def test_it_is_light_and_dark_and_fits_a_small_screen(watching, width):
    page = watching.look()
    page.set_viewport_size({"width": width, "height": 800})
    page.emulate_media(color_scheme="dark")
    page.wait_for_selector('[data-stream="board.load_cell"] path.signal')
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(22, 24, 28)"
    page.get_by_role("button", name="Light", exact=True).click()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.mouse.wheel(0, 3000)
    box = page.locator("#stop").bounding_box()
    assert 0 <= box["x"] <= width - box["width"] and 0 <= box["y"] <= 800 - box["height"], "in its place"
    if os.environ.get("PICTURES"):
        page.mouse.wheel(0, -3000)
        page.wait_for_timeout(500)
        page.screenshot(path=f"{os.environ['PICTURES']}/light{width}.png", full_page=True)
        page.get_by_role("button", name="Dark", exact=True).click()
        page.wait_for_timeout(1000)
        page.screenshot(path=f"{os.environ['PICTURES']}/dark{width}.png", full_page=True)
