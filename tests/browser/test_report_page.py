"""The report in a real browser: Chromium without a window, which finds no network."""

import pytest

from controller.comparing import side_by_side
from controller.reports.report import PAGE, build_report
from tests.browser.conftest import SOON_MS
from tests.unit.controller.reports.synthetic_runs import Given, write_transient

LIMIT_BYTES = 3_000_000

DELAYS_S = (0.20, 0.40, 0.36, 0.30)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    root = tmp_path_factory.mktemp("report")
    given = [Given("d", 0.004487, delay_s, 0.05) for delay_s in DELAYS_S]
    runs = [
        write_transient(root, [*given, Given("f", 0.004843, outcome="false_contact")]),
        write_transient(root, given[:2]),
    ]
    return build_report(runs, root)


@pytest.fixture
def page(browser, report):
    page = browser.new_page()
    page.set_default_timeout(SOON_MS)
    asked, errors = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(report.as_uri())
    yield page
    page.close()
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:"))] == [], (
        "it sends no request"
    )
    assert errors == []


def shown(page):
    return page.locator("table.trials tbody tr:visible td:first-child").all_inner_texts()


def test_the_signal_of_the_longest_delay_is_three_clicks_away(page):
    page.set_viewport_size({"width": 1280, "height": 900})
    page.get_by_role("link", name="Trials", exact=True).click()
    head = page.get_by_role("button", name="delay, ms", exact=True)
    assert head.bounding_box()["x"] + head.bounding_box()["width"] < 1280, "seen without scrolling"
    head.click()
    assert page.locator("th[data-name=delay_s]").get_attribute("aria-sort") == "descending"
    row = page.locator("table.trials tbody tr").first
    assert row.locator("td").nth(0).inner_text() == "2", "of 0.40 s"
    row.click()
    key = row.get_attribute("data-trial")
    page.wait_for_selector(f'#signals-shown[data-ready="{key}"]')
    text = page.locator("#trial").inner_text()
    assert "Trial 2: location d" in text
    assert "contact: contact" in text
    assert "threshold of contact" in text
    assert "APPROACH" in text
    assert "decision" in text
    assert page.locator(".signals svg path.signal").count() >= 2


def test_a_drag_zooms_all_plots_of_a_trial_and_the_pointer_reads_them(page):
    page.locator("table.trials tbody tr").first.click()
    plots = page.locator(".signals div > svg")
    times = plots.first.locator("text.x")
    before = times.all_text_contents()
    box = plots.first.bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 50)
    assert page.locator(".signals svg path.cursor").count() == plots.count(), "one cursor over all"
    assert "board.period, Hz 28.0" in page.locator(".readout").inner_text()
    page.mouse.down()
    page.mouse.move(box["x"] + 300, box["y"] + 60)
    page.mouse.up()
    assert times.all_text_contents() != before
    assert plots.last.locator("text.x").all_text_contents() == times.all_text_contents(), "one axis of time"
    page.mouse.dblclick(box["x"] + 300, box["y"] + 60)
    assert times.all_text_contents() == before


def test_the_table_is_filtered_by_text_and_by_comparisons(page):
    assert len(shown(page)) == 7
    field = page.get_by_role("searchbox", name="Filter")
    field.fill("false_contact")
    assert shown(page) == ["5"]
    field.fill("delay_s>0.35")
    assert sorted(shown(page)) == ["2", "2", "3"]
    field.fill("")
    assert len(shown(page)) == 7


def test_a_number_leads_to_its_rows(page):
    page.locator("#part1 td a", has_text="pad f").click()
    assert shown(page) == ["5"], "the one trial of that place and speed"


def test_a_trial_has_an_address_and_the_arrow_keys_lead_to_its_neighbours(page, report):
    page.goto(f"{report.as_uri()}?trial=2")
    page.wait_for_selector('#signals-shown[data-ready="r0t2"]')
    assert "Trial 2: " in page.locator("#trial").inner_text()
    page.keyboard.press("ArrowRight")
    page.wait_for_selector('#signals-shown[data-ready="r0t3"]')
    assert page.url.endswith("?trial=3")
    page.keyboard.press("ArrowLeft")
    page.wait_for_selector('#signals-shown[data-ready="r0t2"]')


def test_two_trials_stand_side_by_side(page):
    page.set_viewport_size({"width": 1400, "height": 900})
    rows = page.locator("table.trials tbody tr")
    rows.nth(0).click()
    page.get_by_role("button", name="Hold this one").click()
    rows.nth(5).click()
    page.wait_for_selector('#signals-shown[data-ready="r0t1 r1t1"]')
    left, right = (page.locator(".signals").nth(n).bounding_box() for n in (0, 1))
    assert left["y"] == right["y"]
    assert left["x"] + left["width"] <= right["x"]


def test_it_is_dark_where_the_system_is_and_where_the_switch_says_so(page):
    def paper():
        return page.evaluate("getComputedStyle(document.body).backgroundColor")

    page.emulate_media(color_scheme="dark")
    dark = paper()
    page.get_by_role("button", name="Light", exact=True).click()
    light = paper()
    assert (dark, light) == ("rgb(22, 24, 28)", "rgb(255, 255, 255)")
    page.get_by_role("button", name="Dark", exact=True).click()
    assert paper() == dark


def test_nothing_runs_over_the_edge_of_a_small_screen(page):
    page.set_viewport_size({"width": 420, "height": 800})
    page.locator("table.trials tbody tr").first.click()
    page.wait_for_selector('#signals-shown[data-ready="r0t1"]')
    assert page.evaluate("document.documentElement.scrollWidth") <= 420


def test_text_in_the_figures_is_text(page):
    assert page.locator("figure svg text", has_text="force").count() >= 1
    assert page.locator("figure svg[aria-label]").count() == page.locator("figure svg").count()


def test_the_page_is_small_enough_to_be_mailed(report):
    assert report.stat().st_size + LIMIT_BYTES > PAGE
    assert report.stat().st_size <= LIMIT_BYTES


def test_every_column_of_a_comparison_is_within_reach(browser, tmp_path):
    first, second = (write_transient(tmp_path, [Given("d", 0.004487, delay_s)]) for delay_s in DELAYS_S[:2])
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.goto(side_by_side(first, second, [])[0].as_uri())
    page.get_by_text("Every trial", exact=True).click()
    for table in page.locator(".scroll:visible").all():
        assert table.evaluate("table => table.getBoundingClientRect().x") >= 0.0, (
            "no page scrolls to the left of 0"
        )
    page.close()
