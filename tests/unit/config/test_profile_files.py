"""Finding profile files and joining what they extend."""

import pytest

from config.source import ProfileError, bench_of, nest, profile_names, read_source
from tests.refusals import check_refusal


def refusal(name, overrides=None):
    with pytest.raises(ProfileError) as caught:
        read_source(name, overrides)
    return str(caught.value)


def test_tables_are_joined_key_by_key_and_other_values_replaced(write):
    write("base.toml", "[a]\nx = 1\ny = [1, 2]\n[a.deep]\nz = 1")
    write("top.toml", 'extends = "base"\n[a]\ny = [3]\n[a.deep]\nw = 2')
    assert read_source("top.toml").data == {"a": {"x": 1, "y": [3], "deep": {"z": 1, "w": 2}}}


def test_a_name_means_the_file_under_profiles_and_a_path_the_file_itself(write):
    assert "mock/transient" in profile_names()
    assert read_source("mock/transient").name == "mock/transient"
    assert read_source("touch.toml").name == "touch.toml"


def test_a_file_that_two_parents_share_is_applied_once_before_both(write):
    write("base.toml", "limit = 1")
    write("left.toml", 'extends = "base"\nlimit = 2')
    write("right.toml", 'extends = "base"\nport = "right"')
    write("both.toml", 'extends = ["left", "right"]')
    assert read_source("both.toml").data == {"limit": 2, "port": "right"}


def test_a_circle_of_extends_is_named(write):
    write("a.toml", 'extends = "b"')
    write("b.toml", 'extends = "a"')
    assert refusal("a.toml") == "b.toml: extends goes in a circle: a.toml -> b.toml -> a.toml"


def test_a_table_starts_afresh_where_a_later_file_names_another_kind(write):
    write("top.toml", 'extends = "touch"\n[detectors.contact]\nkind = "level"\ngamma = 2.0')
    assert read_source("top.toml").data["detectors"]["contact"] == {"kind": "level", "gamma": 2.0}


def test_a_table_goes_on_where_a_later_file_names_the_same_kind(write):
    write("top.toml", 'extends = "touch"\n[detectors.contact]\nkind = "resonance.paper"')
    assert read_source("top.toml").data["detectors"]["contact"]["threshold_sigma"] == 3.0


def test_a_device_that_is_none_is_taken_off_the_bench(write):
    write("arm.toml", 'extends = "touch"\n[devices]\nstage = "none"\n[devices.arm]\nport = "mock"')
    assert read_source("arm.toml").data["devices"] == {"arm": {"port": "mock"}}
    assert read_source("touch.toml", {"devices.stage": "none"}).data["devices"] == {}


def test_overrides_are_toml_values_or_plain_text_and_come_last(write):
    source = read_source("touch.toml", {"limits.force_n": "1.5", "title": "another one", "trials.list": "[]"})
    assert source.data["limits"] == {"force_n": 1.5}
    assert source.data["title"] == "another one"
    assert source.data["trials"] == {"list": []}


def test_an_override_cannot_bring_in_a_second_key(write):
    assert read_source("touch.toml", {"title": "1\nexperiment = 2"}).data["experiment"] == "touch"


def test_each_value_knows_the_file_that_gave_it(write):
    source = read_source("touch.toml", {"limits.force_n": "1"})
    assert source.origin(("devices", "stage", "port")) == "bench.toml"
    assert source.origin(("detectors", "contact", "kind")) == "touch.toml"
    assert source.origin(("limits", "force_n")) == "--set"
    assert source.origin(("nothing", "like", "it")) == "touch.toml"


def test_a_missing_profile_is_named_with_a_near_one(write):
    assert refusal("mock/transiet").startswith("no profile 'mock/transiet'; did you mean 'mock/transient'")
    assert refusal("zzz") == "no profile 'zzz'; see: run.py list"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('extends = "bensh"', ["extends = 'bensh'", "see: run.py list"]),
        ("extends = 3", ["extends = 3", 'write extends = "mock/transient"']),
        ("[limits]\nforce_n 2.0\n", ["line 2, column 9"]),
        ('[limits]\nforce = "2', ["no TOML"]),
        ("a = " + "[" * 3000, ["nested too deep"]),
    ],
)
def test_a_file_that_cannot_be_read_is_named_with_the_place(write, text, named):
    write("broken.toml", text)
    check_refusal(refusal("broken.toml"), "broken.toml: ", *named)


def test_a_file_that_is_no_text_is_named(write, tmp_path):
    (tmp_path / "noise.toml").write_bytes(b"a = 1\n\xff\xfe")
    check_refusal(refusal("noise.toml"), "noise.toml: ", "UTF-8", "position 6")


def test_a_file_with_a_byte_order_mark_is_read(write):
    write("marked.toml", "\ufeffa = 1")
    assert read_source("marked.toml").data == {"a": 1}


@pytest.mark.parametrize("key", ["", "a..b", ".a", "limits."])
def test_an_override_without_a_proper_key_is_refused(write, key):
    check_refusal(refusal("touch.toml", {key: "1"}), "--set", f"'{key}'", "write for example")


def test_an_override_through_another_overrides_plain_value_is_refused(write):
    check_refusal(refusal("touch.toml", {"a": "1", "a.b": "2"}), "--set", "a.b", "'a'")


@pytest.mark.parametrize(
    ("ports", "bench"),
    [
        (["mock", "mock"], "mock"),
        (["emulated", "emulated"], "emulated"),
        (["emulated", "/dev/ttyUSB0"], "emulated"),
        (["/dev/ttyUSB0", "/dev/ttyUSB1"], "hardware"),
        ([], "hardware"),
    ],
)
def test_the_ports_make_the_bench(ports, bench):
    assert bench_of({"devices": {f"d{i}": {"port": port} for i, port in enumerate(ports)}}) == bench


def test_dotted_keys_become_nested_tables():
    assert nest([("a.b", 1), ("a.c.d", 2), ("e", 3)]) == {"a": {"b": 1, "c": {"d": 2}}, "e": 3}
