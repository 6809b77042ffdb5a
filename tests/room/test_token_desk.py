"""The token endpoint, over HTTP."""

from __future__ import annotations

import json
import logging
import time
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest

pytest.importorskip("asimov_gym.room", exc_type=ImportError)

from asimov_gym.room import RoomLimits, RoomThread


@pytest.fixture(scope="module")
def room() -> Iterator[RoomThread]:
    with RoomThread(limits=RoomLimits(token_lifetime_s=600)) as room:
        yield room


def ask(
    room: RoomThread, body: bytes = b"", credential: str | None = None, scheme: str = "Bearer"
) -> tuple[int, dict[str, object]]:
    """Status and reply of a request for a token."""
    credential = room.server.keys.credential if credential is None else credential
    request = urllib.request.Request(room.token_url, data=body, method="POST")
    request.add_header("Authorization", f"{scheme} {credential}")
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(request, timeout=5) as reply:
            return reply.status, json.load(reply)
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)


def test_a_label_is_enough(room: RoomThread) -> None:
    status, reply = ask(room, b'{"label": "my laptop"}')
    assert status == 200
    assert reply["url"] == room.url
    assert reply["room"] == "robot-sim"
    assert reply["role"] == "control"
    assert str(reply["identity"]).startswith("my-laptop-")
    assert reply["expires_at"] == pytest.approx(time.time() + 600, abs=5)
    admission = room.server.keys.verify(str(reply["token"]))
    assert admission.identity == reply["identity"]
    assert admission.grants.can_publish_data
    assert not admission.grants.can_update_own_metadata


def test_no_body_is_a_request_too(room: RoomThread) -> None:
    status, reply = ask(room)
    assert status == 200
    assert ask(room)[1]["identity"] != reply["identity"]


def test_an_observer_may_only_receive(room: RoomThread) -> None:
    _, reply = ask(room, b'{"role": "observe", "identity": "eye", "room": "other"}')
    admission = room.server.keys.verify(str(reply["token"]))
    assert (admission.room, admission.identity) == ("other", "eye")
    assert admission.grants.can_subscribe
    assert not admission.grants.can_publish
    assert not admission.grants.can_publish_data


def test_a_robot_may_set_its_attributes(room: RoomThread) -> None:
    _, reply = ask(room, b'{"role": "robot"}')
    assert room.server.keys.verify(str(reply["token"])).grants.can_update_own_metadata


@pytest.mark.parametrize("credential", ["", "wrong", "é"])
def test_without_the_credential_there_is_no_token(room: RoomThread, credential: str) -> None:
    status, reply = ask(room, credential=credential.encode().decode("latin-1"))
    assert (status, list(reply)) == (401, ["error"])


def test_the_credential_counts_as_bearer_only(room: RoomThread) -> None:
    assert ask(room, scheme="Basic")[0] == 401


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        (b"{", 400, "not JSON"),
        (b"\xff\xfe", 400, "not JSON"),
        (b"[" * 3000, 400, "not JSON"),
        (b"[]", 400, "not a JSON object"),
        (b'{"label": 3}', 400, "label is not a text"),
        (b'{"role": "king"}', 400, "allowed: control, observe, robot"),
        (b'{"identity": " "}', 400, "identity"),
        (b'{"room": "a\\nb"}', 400, "room"),
        (b'{"label": "' + b"x" * 5000 + b'"}', 413, "larger than 4096 bytes"),
    ],
)
def test_a_request_that_cannot_be_used_is_told_why(room: RoomThread, body: bytes, status: int, words: str) -> None:
    got, reply = ask(room, body)
    assert got == status
    assert words in str(reply["error"])


def test_nothing_of_it_is_logged(room: RoomThread, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG):
        _, reply = ask(room, b'{"label": "x"}')
        ask(room, credential="wrong-credential")
    for secret in (str(reply["token"]), room.server.keys.credential, room.server.keys.secret, "wrong-credential"):
        assert secret not in caplog.text
