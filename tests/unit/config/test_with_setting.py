"""A setting is written into a profile's text; nothing else there changes."""

import tomllib

import pytest

from config.source import ProfileError, with_setting
from tests.refusals import refused

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
