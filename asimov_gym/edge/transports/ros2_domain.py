"""A DDS domain that stays on this machine, or on one address of it.

Cyclone DDS sends from the chosen interface only, but receives on all of them, whatever its configuration says. So on
loopback the receiving sockets are tied to the loopback device as well, where the system can do that.
"""

from __future__ import annotations

import ipaddress
import logging
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from xml.sax.saxutils import quoteattr

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain

from asimov_gym.edge.transports import TransportError
from asimov_gym.edge.transports.udp import is_loopback

MAX_DOMAIN_ID = 232
"""Beyond it, the ports that go with the number do not exist."""
MAX_PARTICIPANTS = 33
"""Programs on one machine that find each other without multicast: what a ROS 2 node on localhost looks for."""

_LOOPBACK_DEVICE = b"lo"
_log = logging.getLogger(__name__)


def environment_domain_id() -> int:
    """The number that ROS 2 nodes of this environment take: `ROS_DOMAIN_ID`, 0 where that is not set.

    Raises:
        TransportError: it is no number from 0 to 232.
    """
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not (text.isascii() and text.isdecimal() and int(text) <= MAX_DOMAIN_ID):
        raise TransportError(f"ROS_DOMAIN_ID must be a whole number from 0 to {MAX_DOMAIN_ID}, got {text!r}")
    return int(text)


def open_domain(domain_id: int, listen: str) -> Domain:
    """Open a domain on one address.

    Args:
        domain_id: from 0 to 232.
        listen: IP address, or `localhost`; 0.0.0.0 for whatever interface Cyclone DDS prefers.

    Raises:
        TransportError: this process has that domain open already, or the address is none of this machine's.
    """
    try:
        address = ipaddress.ip_address("127.0.0.1" if listen == "localhost" else listen)
    except ValueError:
        raise TransportError(f"--listen must be an IP address where ROS 2 is served, got {listen!r}") from None
    try:
        domain = Domain(domain_id, _configuration(address))
    except DDSException as problem:
        raise TransportError(
            f"cannot open ROS 2 domain {domain_id} on {address}: {problem.msg or problem}; is it open in this process "
            f"already, are {MAX_PARTICIPANTS} programs in it, or is the address not this machine's?"
        ) from None
    return domain


def confine(domain_id: int, listen: str) -> bool:
    """Tie the domain's receiving sockets to the loopback device, if the domain is on a loopback address.

    Returns:
        Whether nothing from elsewhere can reach them; a warning was logged if not.
    """
    if not is_loopback(listen):
        _log.warning(
            "ROS 2 domain %d is open on %s, which is not loopback: nothing in it is authenticated, anyone who reaches "
            "it can drive the robot",
            domain_id,
            listen,
        )
        return False
    opened = list(_receiving_sockets(domain_id))
    try:
        if not opened:
            raise OSError("its sockets were not found")
        for each in opened:
            each.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, _LOOPBACK_DEVICE)
    except (AttributeError, OSError) as problem:  # no Linux, or an old one
        _log.warning(
            "ROS 2 domain %d sends on loopback only, but its ports receive on every interface (%s): keep them behind a "
            "firewall",
            domain_id,
            problem,
        )
        return False
    finally:
        for each in opened:
            each.close()  # of the copies; the originals are Cyclone's
    return True


def _configuration(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> str:
    """Cyclone DDS's configuration. Being given here, it replaces what the environment's CYCLONEDDS_URI says."""
    if address.is_unspecified:
        interface, discovery = '<NetworkInterface autodetermine="true"/>', ""
    else:
        interface, discovery = f"<NetworkInterface address={quoteattr(str(address))}/>", ""
    general = f"<Interfaces>{interface}</Interfaces>"
    if address.is_loopback:
        general += "<AllowMulticast>false</AllowMulticast>"
        discovery = (
            "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
            f"<MaxAutoParticipantIndex>{MAX_PARTICIPANTS - 1}</MaxAutoParticipantIndex>"
            f"<Peers><Peer Address={quoteattr(str(address))}/></Peers></Discovery>"
        )
    transport = "<Transport>udp6</Transport>" if address.version == 6 else ""
    return f'<CycloneDDS><Domain Id="any"><General>{transport}{general}</General>{discovery}</Domain></CycloneDDS>'


def _receiving_sockets(domain_id: int) -> Iterator[socket.socket]:
    """Copies of this process's UDP sockets on the domain's ports that are open on every address."""
    base = 7400 + 250 * domain_id
    ports = range(base, base + 12 + 2 * MAX_PARTICIPANTS)
    folder = Path("/proc/self/fd")
    for entry in folder.iterdir() if folder.is_dir() else ():
        try:
            if not os.readlink(entry).startswith("socket:"):
                continue
            copy = socket.socket(fileno=os.dup(int(entry.name)))
        except OSError:  # closed meanwhile
            continue
        if copy.type is socket.SOCK_DGRAM and _is_open_on(copy, ports):
            yield copy
        else:
            copy.close()


def _is_open_on(opened: socket.socket, ports: range) -> bool:
    if opened.family not in (socket.AF_INET, socket.AF_INET6):
        return False
    host, port = opened.getsockname()[:2]
    return port in ports and host in ("0.0.0.0", "::")
