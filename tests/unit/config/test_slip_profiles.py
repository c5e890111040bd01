"""The slip profiles: what they ask for is what the paper prints, and the three benches ask for the same."""

import re

import pytest

from config.profile import load_profile, load_resolved
from config.source import PROFILES, ProfileError, read_source
from tests.refusals import refused

PRINTED_SLIP_S = {
    "fingertip": [3.6],  # 6.20 to 9.8 s
    "flexible_finger": [1.41, 1.05],  # 3.24 to 4.65 s, and back from 5.01 to 6.06 s
    "barrett_finger": [0.75],  # 5.50 to 6.25 s
    "wrist": [2.02],  # 1.53 to 3.55 s
    "dsa": [3.0],  # 4 to 7 s
}
"""Fernandez et al., 4.3 and 5.1 to 5.4."""


def loaded(name="mock/slip", overrides=None):
    return load_profile(name, overrides)


@pytest.mark.parametrize("sensor", PRINTED_SLIP_S)
def test_each_sensor_slips_for_as_long_as_the_papers_did(sensor):
    steps = loaded().behavior.sensors[sensor].steps
    assert [step.duration_s for step in steps if step.do == "slip"] == PRINTED_SLIP_S[sensor]


def test_each_sensor_rolls_and_slips_in_the_papers_order_with_the_papers_blocks_and_thresholds():
    sensors = loaded().behavior.sensors
    assert [step.do for step in sensors["wrist"].steps] == ["hold", "slip", "hold", "roll", "hold"]
    assert [step.do for step in sensors["fingertip"].steps] == ["hold", "roll", "load", "slip", "hold"]
    detectors = loaded().detectors
    assert detectors["fingertip_paper"].settings.threshold == 10.0
    assert detectors["flexible_paper"].settings.threshold == 0.25
    assert detectors["dsa_paper"].settings.block_s == 0.16
    assert {entry.kind for name, entry in detectors.items() if name.endswith("_paper")} == {"slip.paper"}


def test_the_line_that_the_real_benchs_profile_gives_runs_another_sensor():
    text = (PROFILES / "hardware" / "slip.toml").read_text()
    ((key, value),) = re.findall(r'--set "(trials\.list)=(.*)"', text)
    assert {trial.factors["sensor"] for trial in loaded("hardware/slip", {key: value}).trials(0)} == {"wrist"}


def test_with_bumps_nothing_else_changes():
    calm, bumpy = read_source("mock/slip").data, read_source("mock/slip_bumps").data
    assert {**bumpy, "plant": calm["plant"], "title": calm["title"]} == calm
    assert bumpy["plant"]["bumps_hz"] == 1.0


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("behavior.sensors.fingertip.ours", "fingertip_our", "no detector 'fingertip_our'; did you mean"),
        ("behavior.sensors.dsa.stream", "matric.taxels", "no device 'matric'; did you mean 'matrix'"),
        ("behavior.sensors.fingertip.forces_stream", "signals.tap", "no signal 'tap'; did you mean 'tip'"),
    ],
)
def test_a_name_that_is_not_there_is_reported_with_its_place(key, value, message):
    with refused(ProfileError, message, key.rpartition(".")[0]):
        loaded(overrides={key: value})


LIFT = {"limits.movers.arm.travel_m": "0.1", "limits.movers.arm.speed_m_s": "0.03"}


def test_limits_of_another_mover_are_in_the_resolved_profile_and_load_again():
    profile = loaded(overrides=LIFT)
    assert profile.limits.movers["arm"].speed_m_s == 0.03
    assert "position_stream" not in profile.resolved["limits"]["movers"]["arm"]
    again = load_resolved("again", profile.resolved)
    assert again.limits == profile.limits
    assert again.hash == profile.hash


def test_a_home_is_held_to_the_limits_of_its_own_mover_in_each_trial_and_that_must_be_there():
    with pytest.raises(ProfileError, match=r"home_speed_m_s = 0.031: faster than"):
        loaded(overrides={**LIFT, "devices.arm.home_speed_m_s": "0.031"})
    loaded(overrides={**LIFT, "devices.arm.home_speed_m_s": "0.029"})
    rows = '[{ sensor = "wrist" }, { sensor = "wrist", limits.speed_m_s = 0.01 }]'
    with pytest.raises(ProfileError, match=r"home_speed_m_s = 0.02: faster than .* = 0.01"):
        loaded(overrides={"trials.list": rows})
    with pytest.raises(ProfileError, match=r"\[limits\] movers = .lift.: no device 'lift'; known: "):
        loaded(overrides={"limits.movers.lift.travel_m": "0.1"})
