"""What a benchmark prints of what it saves."""

import json

from benchmarks import results


def test_rows_are_printed_as_tables_and_numbers_as_lines_whatever_holds_them():
    found = {
        "wall_s": 1.23456,
        "rows": [{"detector": "ours", "missed": 0, "delays_s": [0.1, 0.2]}],
        "rooms": {"empty": {"ours": {"seen": {"share": 0.98765}}}},
    }
    output = "\n".join(results.shown(found))
    assert "wall_s: 1.235" in output
    assert "ours" in output and "missed" in output and "delays_s" not in output
    assert "rooms: empty" in output and "0.9877" in output


def test_a_quick_run_leaves_the_kept_results_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    results.save("chain", {"n": 1}, quick=True)
    assert (tmp_path / "build" / "quick" / "chain.json").is_file()
    assert "n: 1" in capsys.readouterr().out


def test_what_a_study_measures_no_more_stays_under_earlier(tmp_path, monkeypatch):
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    for found in ({"n": 1, "waits": 2}, {"n": 3}, {"n": 4, "other": 5}):
        results.save("study", found)
    kept = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert {**kept, "machine": None} == {"machine": None, "n": 4, "other": 5, "earlier": {"waits": 2}}
