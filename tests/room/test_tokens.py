"""Tokens: what opens a room and what does not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("asimov_gym.room", exc_type=ImportError)

import jwt

from asimov_gym.room import Grants, RoomError, RoomKeys, TokenError

KEYS = RoomKeys.generate()


def test_a_token_says_what_was_granted() -> None:
    token = KEYS.issue("lab", "robot", Grants(can_publish=False, can_update_own_metadata=True), name="Robot 1")
    admission = KEYS.verify(token)
    assert (admission.room, admission.identity, admission.name) == ("lab", "robot", "Robot 1")
    assert admission.grants == Grants(can_publish=False, can_update_own_metadata=True)


def test_grants_left_out_are_those_of_livekit() -> None:
    claims = {"iss": KEYS.api_key, "sub": "x", "exp": 2**33, "video": {"roomJoin": True, "room": "lab"}}
    assert KEYS.verify(jwt.encode(claims, KEYS.secret, "HS256")).grants == Grants()


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"iss": "somebody"}, "not one of this server"),
        ({"exp": 1_000_000_000}, "expired"),
        ({"exp": None}, "not one of this server"),
        ({"nbf": 2**33}, "not one of this server"),
        ({"sub": None}, "not one of this server"),
        ({"sub": " robot "}, "identity"),
        ({"sub": "a\nb"}, "identity"),
        ({"sub": "x" * 129}, "identity"),
        ({"video": None}, "no grant"),
        ({"video": {"room": "lab"}}, "no grant"),
        ({"video": {"roomJoin": "yes", "room": "lab"}}, "no grant"),
        ({"video": {"roomJoin": True}}, "room"),
        ({"video": {"roomJoin": True, "room": "lab", "canPublish": 1}}, "neither true nor false"),
        ({"name": 3}, "not text"),
        ({"attributes": {"a": 1}}, "not text"),
    ],
)
def test_other_claims_open_nothing(change: dict[str, object], reason: str) -> None:
    claims = {"iss": KEYS.api_key, "sub": "x", "exp": 2**33, "video": {"roomJoin": True, "room": "lab"}} | change
    token = jwt.encode({key: value for key, value in claims.items() if value is not None}, KEYS.secret, "HS256")
    with pytest.raises(TokenError, match=reason) as caught:
        KEYS.verify(token)
    assert token not in str(caught.value)


def test_another_secret_no_signature_and_nonsense_open_nothing() -> None:
    claims = {"iss": KEYS.api_key, "sub": "x", "exp": 2**33, "video": {"roomJoin": True, "room": "lab"}}
    forged = [
        jwt.encode(claims, "another secret that is long enough", "HS256"),
        jwt.encode(claims, None, "none"),
        jwt.encode(claims, KEYS.secret * 2, "HS512"),
        "",
        "a.b.c",
        "é",
    ]
    for token in forged:
        with pytest.raises(TokenError):
            KEYS.verify(token)


def test_an_old_token_expires() -> None:
    with pytest.raises(TokenError, match="expired"):
        KEYS.verify(KEYS.issue("lab", "x", lifetime_s=60, now=1_700_000_000))


def test_secrets_are_not_shown() -> None:
    assert KEYS.secret not in repr(KEYS)
    assert KEYS.credential not in repr(KEYS)


def test_short_secrets_are_refused_without_being_repeated() -> None:
    with pytest.raises(ValueError, match="secret is not allowed: at least 32") as caught:
        RoomKeys(secret="hunter2", credential="c" * 16)
    assert "hunter2" not in str(caught.value)


def test_a_key_file_is_made_for_its_owner_alone_and_read_again(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    made = RoomKeys.from_file(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert RoomKeys.from_file(path) == made


def test_a_key_file_that_others_can_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "keys.json"
    RoomKeys.from_file(path)
    os.chmod(path, 0o644)
    with pytest.raises(RoomError, match="others can read"):
        RoomKeys.from_file(path)


@pytest.mark.parametrize("content", ["", "[]", '{"secret": "s3cr3t"}', '{"secret": 1, "credential": 2}'])
def test_another_file_is_refused_without_quoting_it(tmp_path: Path, content: str) -> None:
    path = tmp_path / "keys.json"
    path.write_text(content)
    os.chmod(path, 0o600)
    with pytest.raises(RoomError, match="not a key file") as caught:
        RoomKeys.from_file(path)
    assert "s3cr3t" not in str(caught.value)


def test_a_key_file_in_no_folder_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(RoomError, match="cannot write the key file"):
        RoomKeys.from_file(tmp_path / "absent" / "keys.json")
