"""Thresholds from a bench at rest, over the wire."""

import tomllib

from config.quiet import quieted

LAB = """extends = "emulated/transient"  # ours

[detectors]
ours.threshold = "? run.py quiet"
"""


def test_an_emulated_bench_at_rest_sets_the_threshold_of_its_finger(tmp_path, capsys):
    lab = tmp_path / "lab.toml"
    lab.write_text(LAB)
    code = quieted(str(lab), {}, None, (), None, seconds=12.0, interval_s=3600.0, named=(), dry_run=False)
    out, _ = capsys.readouterr()
    assert code == 0
    assert "contact: no threshold from rest" in out
    # of a free finger the least of a normal deviate is 3.5, and 500 simulated approaches asked for 4.6
    assert 3.5 < tomllib.loads(lab.read_text())["detectors"]["ours"]["threshold"] < 15.0
    assert lab.read_text().startswith(LAB.partition("[")[0])
