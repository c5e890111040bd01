"""The slip profiles: what they ask for is what the paper prints, and the three benches ask for the same."""

import pytest

from config.assemble import Table
from config.profile import load_profile
from config.source import ProfileError, read_source

PRINTED_SLIP_S = {
    "fingertip": [3.6],  # 6.20 to 9.8 s
    "flexible_finger": [1.41, 1.05],  # 3.24 to 4.65 s, and back from 5.01 to 6.06 s
    "barrett_finger": [0.75],  # 5.50 to 6.25 s
    "wrist": [2.02],  # 1.53 to 3.55 s
    "dsa": [3.0],  # 4 to 7 s
}
"""Fernandez et al., 4.3 and 5.1 to 5.4."""


def loaded(name="mock/slip", overrides=None):
    return load_profile(name, overrides, table=Table())


@pytest.mark.parametrize("sensor", PRINTED_SLIP_S)
def test_each_sensor_slips_for_as_long_as_the_papers_did(sensor):
    steps = loaded().behavior.sensors[sensor].steps
    assert [step.duration_s for step in steps if step.do == "slip"] == PRINTED_SLIP_S[sensor]


def test_the_wrist_rolls_after_it_slips_and_the_fingertip_before_as_in_the_paper():
    sensors = loaded().behavior.sensors
    assert [step.do for step in sensors["wrist"].steps] == ["hold", "slip", "hold", "roll", "hold"]
    assert [step.do for step in sensors["fingertip"].steps] == ["hold", "roll", "load", "slip", "hold"]


def test_the_papers_detector_has_the_papers_blocks_and_thresholds():
    detectors = loaded().detectors
    assert detectors["fingertip_paper"].settings.threshold == 10.0
    assert detectors["flexible_paper"].settings.threshold == 0.25
    assert detectors["dsa_paper"].settings.block_s == 0.16
    assert {entry.kind for name, entry in detectors.items() if name.endswith("_paper")} == {"slip.paper"}


@pytest.mark.parametrize("bench", ["emulated", "hardware"])
def test_other_benches_ask_the_same_of_sensors_detectors_and_limits(bench):
    mock, other = read_source("mock/slip").data, read_source(f"{bench}/slip").data
    for section in ("experiment", "signals", "detectors", "limits"):
        assert other[section] == mock[section]
    assert other["behavior"]["sensors"] == mock["behavior"]["sensors"]


def test_over_the_wire_the_arm_stops_on_slip_and_every_device_talks():
    behavior = loaded("emulated/slip").behavior
    assert behavior.stop_on_slip
    assert {stream.partition(".")[0] for stream in behavior.measures} == {"hand", "matrix"}


def test_with_bumps_nothing_else_changes():
    calm, bumpy = read_source("mock/slip").data, read_source("mock/slip_bumps").data
    assert {**bumpy, "plant": calm["plant"], "title": calm["title"]} == calm
    assert bumpy["plant"]["bumps_hz"] == 1.0


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("behavior.sensors.fingertip.ours", "fingertip_our", "no detector 'fingertip_our'; did you mean"),
        ("behavior.sensors.dsa.stream", "matric.taxels", "no device 'matric'; did you mean 'matrix'"),
        ("behavior.sensors.fingertip.forces_stream", "signals.tap", "no signal 'tap'; did you mean 'tip'"),
    ],
)
def test_a_name_that_is_not_there_is_told_with_its_place(key, value, said):
    with pytest.raises(ProfileError) as refusal:
        loaded(overrides={key: value})
    assert said in str(refusal.value)
    assert key.rpartition(".")[0] in str(refusal.value)
