"""Whether drive and converter share a clock: measured on request, kept in the manifest, reported where they do not."""

from config.script import run_trials
from controller.campaign import EXIT_DONE
from controller.reports.run_account import facts_of


def one_approach(out, clocks="watched"):
    row = {"side": "normal", "speed_m_s": 0.03, "object": "pipe"}
    settings = {"signals.right.clocks": clocks}
    return run_trials("mock/pretouch", [row], settings=settings, seed=1, out=out, say=lambda line: None)


def test_one_clock_stands_in_manifest_and_report_and_in_no_warning(tmp_path):
    outcome, run = one_approach(tmp_path)
    assert outcome.exit_code == EXIT_DONE
    assert run.manifest["signals"].keys() == {"right"}
    assert abs(run.manifest["signals"]["right"]["drift_ppm"]) < 0.01
    assert "ppm" not in outcome.line
    assert any("drift_ppm" in text for _, text in facts_of(run))


def test_two_clocks_that_were_taken_for_one_are_reported_in_the_last_line(tmp_path, monkeypatch):
    monkeypatch.setattr("controller.signals.iq.DRIFT_MAX_PPM", 0.0)
    outcome, run = one_approach(tmp_path)
    assert outcome.exit_code == EXIT_DONE
    assert 'set clocks = "tracked", or use one card for both' in outcome.line
    assert outcome.line.count("ppm apart") == 1
    assert run.manifest["signals"]["right"]["warning"] in outcome.line


def test_without_a_request_nothing_is_reported(tmp_path):
    _, run = one_approach(tmp_path, "locked")
    assert run.manifest["signals"] == {}
