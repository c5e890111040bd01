"""A resolved profile as text: every value with its source, and it loads as the same profile."""

import tomllib

from hypothesis import given, settings
from hypothesis import strategies as st

from config.profile import load_profile
from config.source import to_toml

leaves = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(codec="utf-8")),
)
values = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(st.characters(codec="utf-8")), inner, min_size=1)
    ),
    max_leaves=12,
)


@settings(max_examples=40)
@given(table=st.dictionaries(st.text(st.characters(codec="utf-8")), values))
def test_any_table_reads_back_as_it_was(table):
    assert tomllib.loads(to_toml(table, lambda path: "somewhere")) == table


def test_each_line_ends_with_where_its_value_came_from(write):
    profile = load_profile("touch.toml", {"limits.force_n": "1.5"})
    origins = profile.source.origins
    lines = to_toml(profile.resolved, lambda path: origins.get(path, "default")).splitlines()
    ends = {line.split(" = ")[0]: line.split("  # ")[-1] for line in lines if " = " in line and "# " in line}
    assert ends["force_n"] == "--set"
    assert ends["driver"] == "bench.toml"
    assert ends["threshold_sigma"] == "touch.toml"
    assert ends["average_samples"] == "default"


def test_a_printed_profile_is_a_profile_with_the_same_hash(write):
    profile = load_profile("touch.toml")
    write("printed.toml", to_toml(profile.resolved, lambda path: "printed"))
    assert load_profile("printed.toml").hash == profile.hash
