"""Profiles as files and text: what joins them, hints at what was meant, values that are given and printed."""

import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from config.hints import did_you_mean, near_or_all, unknown_key
from config.profile import load_profile
from config.source import ProfileError, profile_names, read_source, to_toml, with_setting
from tests.refusals import check_refusal, refused


def refusal(name, overrides=None):
    with pytest.raises(ProfileError) as caught:
        read_source(name, overrides)
    return str(caught.value)


def test_tables_are_joined_key_by_key_and_a_device_that_is_none_is_taken_off_the_bench(write):
    write("base.toml", "[a]\nx = 1\ny = [1, 2]\n[a.deep]\nz = 1")
    write("top.toml", 'extends = "base"\n[a]\ny = [3]\n[a.deep]\nw = 2')
    assert read_source("top.toml").data == {"a": {"x": 1, "y": [3], "deep": {"z": 1, "w": 2}}}
    write("arm.toml", 'extends = "touch"\n[devices]\nstage = "none"\n[devices.arm]\nport = "mock"')
    assert read_source("arm.toml").data["devices"] == {"arm": {"port": "mock"}}
    assert read_source("touch.toml", {"devices.stage": "none"}).data["devices"] == {}


def test_a_name_means_the_file_under_profiles_and_one_that_two_parents_share_is_applied_once_before_both(
    write,
):
    assert "mock/transient" in profile_names()
    assert read_source("mock/transient").name == "mock/transient"
    assert read_source("touch.toml").name == "touch.toml"
    write("base.toml", "limit = 1")
    write("left.toml", 'extends = "base"\nlimit = 2')
    write("right.toml", 'extends = "base"\nport = "right"')
    write("both.toml", 'extends = ["left", "right"]')
    assert read_source("both.toml").data == {"limit": 2, "port": "right"}


def test_a_circle_of_extends_and_a_missing_profile_are_named(write):
    write("a.toml", 'extends = "b"')
    write("b.toml", 'extends = "a"')
    assert refusal("a.toml") == "b.toml: extends goes in a circle: a.toml -> b.toml -> a.toml"
    assert refusal("mock/transiet").startswith("no profile 'mock/transiet'; did you mean 'mock/transient'")
    assert refusal("zzz") == "no profile 'zzz'; see: run.py list"


def test_a_table_starts_afresh_where_a_later_file_names_another_kind_and_goes_on_where_the_same(write):
    for kind, kept in (("level", {}), ("resonance.paper", {"threshold_sigma": 3.0})):
        write("top.toml", f'extends = "touch"\n[detectors.contact]\nkind = "{kind}"\ngamma = 2.0')
        contact = read_source("top.toml").data["detectors"]["contact"]
        assert contact == {"kind": kind, "gamma": 2.0, **kept}


def test_overrides_are_toml_values_or_plain_text_come_last_and_bring_in_no_second_key(write):
    source = read_source("touch.toml", {"limits.force_n": "1.5", "title": "another one", "trials.list": "[]"})
    assert source.data["limits"] == {"force_n": 1.5}
    assert source.data["title"] == "another one"
    assert source.data["trials"] == {"list": []}
    assert read_source("touch.toml", {"title": "1\nexperiment = 2"}).data["experiment"] == "touch"


def test_each_value_knows_the_file_that_gave_it_and_each_line_ends_with_it(write):
    source = read_source("touch.toml", {"limits.force_n": "1"})
    assert source.origin(("devices", "stage", "port")) == "bench.toml"
    assert source.origin(("detectors", "contact", "kind")) == "touch.toml"
    assert source.origin(("limits", "force_n")) == "--set"
    assert source.origin(("nothing", "like", "it")) == "touch.toml"
    profile = load_profile("touch.toml", {"limits.force_n": "1.5"})
    origins = profile.source.origins
    lines = to_toml(profile.resolved, lambda path: origins.get(path, "default")).splitlines()
    ends = {line.split(" = ")[0]: line.split("  # ")[-1] for line in lines if " = " in line and "# " in line}
    assert ends["force_n"] == "--set"
    assert ends["driver"] == "bench.toml"
    assert ends["threshold_sigma"] == "touch.toml"
    assert ends["average_samples"] == "default"


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


def test_a_file_that_is_no_text_is_named_and_one_with_a_byte_order_mark_is_read(write, tmp_path):
    (tmp_path / "noise.toml").write_bytes(b"a = 1\n\xff\xfe")
    check_refusal(refusal("noise.toml"), "noise.toml: ", "UTF-8", "position 6")
    write("marked.toml", "\ufeffa = 1")
    assert read_source("marked.toml").data == {"a": 1}


def test_an_override_without_a_proper_key_or_through_another_is_refused(write):
    for key in ("", "a..b", ".a", "limits."):
        check_refusal(refusal("touch.toml", {key: "1"}), "--set", f"'{key}'", "write for example")
    check_refusal(refusal("touch.toml", {"a": "1", "a.b": "2"}), "--set", "a.b", "'a'")


@pytest.mark.parametrize(
    ("key", "value", "known", "hint"),
    [
        ("speed_mm_s", 4.843, ["speed_m_s", "location"], "SI is meant: speed_m_s = 0.004843"),
        ("settle_min", 1.5, ["settle_s"], "SI is meant: settle_s = 90"),
        ("sample_khz", 1, ["sample_hz"], "SI is meant: sample_hz = 1000"),
        ("force_lbf", 5, ["force_n"], "SI is meant: force_n = 22.2411"),
        ("tilt_deg", 180, ["tilt_rad"], "SI is meant: tilt_rad = 3.14159"),
        ("force_g", 100, ["force_n"], "SI is meant: force_n"),
        ("force_mm", 2, ["force_n"], "SI is meant: force_n"),
        ("speed_mm_s", "fast", ["speed_m_s"], "SI is meant: speed_m_s"),
        ("speed_mm_s", True, ["speed_m_s"], "SI is meant: speed_m_s"),
        ("speed", 4, ["speed_m_s"], "did you mean 'speed_m_s'?"),
        ("averge_samples", 4, ["average_samples", "input"], "did you mean 'average_samples'?"),
        ("colour", 4, ["input", "gamma"], "known: gamma, input"),
        ("colour", 4, [], "known: none"),
    ],
)
def test_an_unknown_key_is_answered_with_what_was_probably_meant(key, value, known, hint):
    assert unknown_key(key, value, known) == hint


def test_nothing_near_gives_no_hint_and_many_names_are_not_listed_in_full():
    assert did_you_mean("zzz", ["alpha", "beta"]) == ""
    assert near_or_all("zzz", [f"name{i:02}" for i in range(40)]).endswith("name11, …")


text = st.text(st.characters(codec="utf-8"))
numbers = st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False)
values = st.recursive(
    st.booleans() | numbers | text,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(text, inner, min_size=1),
    max_leaves=12,
)


@settings(max_examples=40)
@given(table=st.dictionaries(text, values))
def test_any_table_reads_back_as_it_was(table):
    assert tomllib.loads(to_toml(table, lambda path: "somewhere")) == table


def test_a_printed_profile_is_a_profile_with_the_same_hash(write):
    near = {"signals.near.kind": "scaled"}
    write("far.toml", 'extends = "touch"\n[signals]\nnear.kind = "scaled"')
    for profile in (
        load_profile("touch.toml", near),
        load_profile("far.toml", {"signals.near": "none"}),  # one that is taken off is named
    ):
        write("printed.toml", to_toml(profile.resolved, lambda path: "printed"))
        assert load_profile("printed.toml").hash == profile.hash


PATH = ("detectors", "touch", "threshold")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('extends = "x"  # why\n', 'extends = "x"  # why\n\n[detectors.touch]\nthreshold = 0.3  # new\n'),
        (
            "[detectors.touch]  # ours\nkind = 'a'\nthreshold = 1.0 # old\n[limits]\n",
            "[detectors.touch]  # ours\nkind = 'a'\nthreshold = 0.3  # new\n[limits]\n",
        ),
        (
            "[detectors.touch]\nkind = 'a'\n\n[limits]\nthreshold = 2\n",
            "[detectors.touch]\nthreshold = 0.3  # new\nkind = 'a'\n\n[limits]\nthreshold = 2\n",
        ),
        (
            "[detectors]\nother.threshold = 1\ntouch.threshold = '? how'\n",
            "[detectors]\nother.threshold = 1\ntouch.threshold = 0.3  # new\n",
        ),
        ("detectors.touch.threshold = 1\n", "detectors.touch.threshold = 0.3  # new\n"),
        ("[detectors.'touch']\nthreshold = 1", "[detectors.'touch']\nthreshold = 0.3  # new\n"),
    ],
)
def test_it_is_given_where_it_stands_or_in_its_table(before, after):
    assert with_setting(before, PATH, 0.3, "new") == after
    assert tomllib.loads(after)["detectors"]["touch"]["threshold"] == 0.3


@pytest.mark.parametrize(
    "text",
    [
        "[detectors]\ntouch = { threshold = 1.0 }\n",
        "[detectors]\ntouch.kind = 'a'\n",
        "title = '''\n[detectors.touch]\nthreshold = 1\n'''\n",
    ],
)
def test_where_it_cannot_be_it_says_what_to_write(text):
    with refused(ProfileError, "[detectors.touch]", "threshold = 0.3  # new"):
        with_setting(text, PATH, 0.3, "new")
