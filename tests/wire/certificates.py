"""The certificates of the benches that take too long beside other tests: `make certificates`."""

import pytest

from tests.wire.test_certificates_wire import MORE, test_every_limit_of_an_emulated_bench_acts

test_every_limit_of_an_emulated_bench_acts.pytestmark = [pytest.mark.parametrize("name", MORE)]
