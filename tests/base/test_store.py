"""Requests on disk are resumed by the same request."""

import json

from dropper_jax.base.store import request_differences


def test_requests_with_numbers_that_do_not_exist_are_equal_to_themselves_and_to_no_other_number():
    request = {"table": [1.0, float("nan")], "limit": float("inf"), "steps": 3}
    stored = json.loads(json.dumps(request))
    assert request_differences(request, stored) == []
    assert request_differences({**request, "limit": float("nan")}, stored) == ["limit = Infinity there, NaN here"]
    assert request_differences({**request, "steps": 3.0}, stored) == []
