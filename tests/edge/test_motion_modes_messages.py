"""The messages of the motion-mode interface as JSON."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asimov_gym.edge.motion_modes_messages import (
    SERVICES,
    TOPICS,
    McLocomotionVelocity,
    MessageError,
    from_json,
    to_json,
)

_json = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=10,
)
_MESSAGES = [*TOPICS.values(), *(part for each in SERVICES.values() for part in (each.request, each.response))]


@settings(max_examples=150, deadline=None)
@given(message=st.sampled_from(_MESSAGES), value=_json)
def test_whatever_json_holds(message: type, value: Any) -> None:
    try:
        read = from_json(message, value)
    except MessageError:
        return
    assert from_json(message, to_json(read)) is not None


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_messages_survive_json(data: st.DataObject) -> None:
    text = st.text(st.characters(exclude_categories=["Cs"]), max_size=10)
    message = McLocomotionVelocity(
        source=data.draw(text),
        forward_velocity=data.draw(st.floats(allow_nan=False, allow_infinity=False)),
        angular_velocity=data.draw(st.floats(allow_nan=False, allow_infinity=False)),
    )
    assert from_json(McLocomotionVelocity, to_json(message)) == message


@pytest.mark.parametrize(
    "value, words",
    [
        ([0] * 9, "must be an object"),
        ({"sourse": "pnc"}, "has no field 'sourse'"),
        ({"source": 5}, "source must be a string"),
        ({"source": "\ud800"}, "surrogates"),
        ({"forward_velocity": "1"}, "forward_velocity must be a number"),
        ({"forward_velocity": True}, "forward_velocity must be a number"),
        ({"header": {"sequence": -1}}, r"header\.sequence must be an integer from 0 to 4294967295"),
        ({"header": {"stamp": {"sec": 1.0}}}, r"header\.stamp\.sec must be an integer"),
    ],
)
def test_wrong_json_is_named(value: Any, words: str) -> None:
    with pytest.raises(MessageError, match=words):
        from_json(McLocomotionVelocity, value)
