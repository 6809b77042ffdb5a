"""The rosbridge protocol, version 2, in JSON: what one client says and what it is answered. Knows no sockets.

Of the protocol: service calls, publishing to the robot's topics, listening to what others publish there, status
messages, and those services of `rosapi` by which clients look around. Fragments, compression and services or actions of
clients are not there.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from types import MappingProxyType
from typing import Any

from asimov_gym.edge.motion_modes_messages import SERVICES, TOPICS, MessageError, from_json, to_json
from asimov_gym.edge.motion_modes_service import MotionModes

_log = logging.getLogger(__name__)

LEVELS = ("error", "warning", "info", "none")
"""Of status messages a client gets those of its level and worse; ours are all errors."""


class ProtocolError(ValueError):
    """Something a client said that makes no sense; the message is for the client."""


class RosbridgeSession:
    """One client's side of the conversation.

    Args:
        modes: the service.
    """

    def __init__(self, modes: MotionModes) -> None:
        self.subscriptions: set[str] = set()
        """Topics that the client listens to."""
        self._modes = modes
        self._level = LEVELS[0]
        self._ops: dict[str, Callable[[dict[str, Any]], dict[str, Any] | None]] = {
            "call_service": self._call_service,
            "advertise": self._check_topic,
            "unadvertise": self._check_topic,
            "publish": self._publish,
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "set_level": self._set_level,
        }

    def take(self, text: str | bytes) -> dict[str, Any] | None:
        """Take one message of the client.

        Returns:
            What to answer, if anything. Nothing the client says raises an error.
        """
        message: Any = None
        try:
            message = _parse(text)
            op = message.get("op")
            if not isinstance(op, str) or op not in self._ops:
                raise ProtocolError(f"op must be one of {', '.join(self._ops)}, got {str(op)[:40]!r}")
            return self._ops[op](message)
        except ValueError as error:  # MessageError and ProtocolError are such
            return self._status(message, str(error))
        except Exception:  # a defect of ours
            _log.exception("rosbridge: a message was not taken")
            return self._status(message, "internal error")

    def _status(self, message: Any, text: str) -> dict[str, Any] | None:
        if self._level == "none":
            return None
        answer = {"op": "status", "level": "error", "msg": text}
        if isinstance(message, dict) and "id" in message:
            answer["id"] = message["id"]
        return answer

    # -- services ----------------------------------------------------------------------------------

    def _call_service(self, message: dict[str, Any]) -> dict[str, Any]:
        name = _name(message, "service")
        answer: dict[str, Any] = {"op": "service_response", "service": name}
        if "id" in message:
            answer["id"] = message["id"]
        args = message.get("args")
        try:
            values, result = self._values(name, {} if args is None else args, message.get("type")), True
        except ValueError as error:
            values, result = str(error), False
        except Exception:  # a defect of ours
            _log.exception("rosbridge: a call of %s failed", name)
            values, result = "internal error", False
        return {**answer, "values": values, "result": result}

    def _values(self, name: str, args: Any, kind: Any) -> dict[str, Any]:
        if name in ROSAPI:
            return ROSAPI[name](args)
        service = SERVICES.get(name)
        if service is None:
            raise ProtocolError(f"there is no service {name!r}; there are {', '.join(SERVICES)}")
        _check_type(kind, service.type_name)
        return to_json(self._modes.call(name, from_json(service.request, args)))

    # -- topics ------------------------------------------------------------------------------------

    def _check_topic(self, message: dict[str, Any]) -> None:
        _topic(message)  # there is nothing to remember: rosbridge, too, takes messages on topics whose type it knows

    def _publish(self, message: dict[str, Any]) -> None:
        topic = _topic(message)
        self._modes.publish(topic, from_json(TOPICS[topic], message.get("msg", {})))

    def _subscribe(self, message: dict[str, Any]) -> None:
        self.subscriptions.add(_topic(message))

    def _unsubscribe(self, message: dict[str, Any]) -> None:
        self.subscriptions.discard(_topic(message))

    def _set_level(self, message: dict[str, Any]) -> None:
        level = message.get("level")
        if level not in LEVELS:
            raise ProtocolError(f"level must be one of {', '.join(LEVELS)}")
        self._level = level


def _parse(text: str | bytes) -> dict[str, Any]:
    if isinstance(text, bytes):
        raise ProtocolError("only JSON text is spoken here, no binary messages")
    try:
        message = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"this is no JSON: {error}") from None
    if not isinstance(message, dict):
        raise ProtocolError("a message must be a JSON object")
    return message


def _name(message: dict[str, Any], key: str) -> str:
    """A service or topic by its full name: what comes without the leading slash is taken to be in the root."""
    name = message.get(key)
    if not isinstance(name, str) or not name:
        raise ProtocolError(f"{key} must be a name")
    return name if name.startswith("/") else f"/{name}"


def _topic(message: dict[str, Any]) -> str:
    topic = _name(message, "topic")
    if topic not in TOPICS:
        raise ProtocolError(f"there is no topic {topic!r}; there is {', '.join(TOPICS)}")
    _check_type(message.get("type"), _topic_type(topic))
    return topic


def _check_type(given: Any, expected: str) -> None:
    """A type may be left out, or be named as in ROS 1, without its middle part."""
    package, _, name = expected.split("/")
    if given not in (None, "", expected, f"{package}/{name}"):
        raise ProtocolError(f"the type is {expected}, not {str(given)[:100]}")


def _topic_type(topic: str) -> str:
    return TOPICS[topic].type_name  # type: ignore[attr-defined]


# -- rosapi ----------------------------------------------------------------------------------------


def _string(args: Any, key: str) -> str:
    value = args.get(key) if isinstance(args, dict) else None
    if not isinstance(value, str):
        raise MessageError(f"{key} must be a string")
    return value


def _services(args: Any) -> dict[str, Any]:
    return {"services": [*SERVICES, *ROSAPI]}


def _service_type(args: Any) -> dict[str, Any]:
    name = _string(args, "service")
    if name in ROSAPI:
        return {"type": _rosapi_type(name)}
    return {"type": SERVICES[name].type_name if name in SERVICES else ""}


def _services_for_type(args: Any) -> dict[str, Any]:
    wanted = _string(args, "type")
    types = {name: service.type_name for name, service in SERVICES.items()} | {n: _rosapi_type(n) for n in ROSAPI}
    return {"services": [name for name, kind in types.items() if kind == wanted]}


def _topics(args: Any) -> dict[str, Any]:
    return {"topics": list(TOPICS), "types": [_topic_type(topic) for topic in TOPICS]}


def _one_topic_type(args: Any) -> dict[str, Any]:
    topic = _string(args, "topic")
    return {"type": _topic_type(topic) if topic in TOPICS else ""}


def _topics_for_type(args: Any) -> dict[str, Any]:
    wanted = _string(args, "type")
    return {"topics": [topic for topic in TOPICS if _topic_type(topic) == wanted]}


def _rosapi_type(name: str) -> str:
    words = name.removeprefix("/rosapi/").split("_")
    return "rosapi_msgs/srv/" + "".join(word.capitalize() for word in words)


ROSAPI = MappingProxyType(
    {
        "/rosapi/services": _services,
        "/rosapi/service_type": _service_type,
        "/rosapi/services_for_type": _services_for_type,
        "/rosapi/topics": _topics,
        "/rosapi/topic_type": _one_topic_type,
        "/rosapi/topics_for_type": _topics_for_type,
    }
)
"""Services by which clients look around, by name."""
