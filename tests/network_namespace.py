"""Runs tests with the LiveKit client library in a network namespace of their own.

The client library offers no loopback addresses to WebRTC: it needs another interface. The namespace has one that leads
nowhere (`lo` up and a veth pair whose far end nobody holds), so that nothing a test sends leaves it. Room server and
clients run inside the same namespace.

    from tests.network_namespace import in_namespace

    @in_namespace(timeout=20)
    async def test_two_clients_meet() -> None:
        ...
"""

from __future__ import annotations

import asyncio
import functools
import inspect
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

ADDRESS = "192.0.2.1"
"""Address of the dead-end interface: from a block that is reserved for documentation and routed nowhere."""
_INSIDE = "ASIMOV_TEST_NAMESPACE"
_ROOT = Path(__file__).resolve().parents[1]
_SET_UP = f"""
set -e
ip link set lo up
ip link add end0 type veth peer name end1
ip addr add {ADDRESS}/24 dev end0
ip link set end0 up
ip link set end1 up
exec "$@"
"""


def run_in_namespace(
    argv: Sequence[str], timeout: float = 30.0, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command in a new network namespace that ends with it.

    Args:
        argv: program and arguments.
        timeout: seconds after which the command and what it started are killed.
        env: additions to this process's environment.

    Returns:
        The finished command, with its standard output and error as text.

    Raises:
        subprocess.TimeoutExpired: with what it had written.
    """
    process = subprocess.Popen(
        [*_unshare(), "sh", "-c", _SET_UP, "sh", *argv],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PATH": _search_path(), "PYTHONPATH": str(_ROOT), **(env or {}), _INSIDE: "1"},
        start_new_session=True,
    )
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired as late:
        os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
        raise subprocess.TimeoutExpired(list(argv), timeout, out, err) from late
    except BaseException:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        raise
    return subprocess.CompletedProcess(list(argv), process.returncode, out, err)


@functools.cache
def skip_reason() -> str | None:
    """Why no namespace can be made here; None if one can."""
    for tool in ("unshare", "ip"):
        if shutil.which(tool, path=_search_path()) is None:
            return f"no network namespace: the program `{tool}` is missing"
    try:
        made = run_in_namespace(["true"], timeout=10.0)
    except subprocess.TimeoutExpired:
        return "no network namespace: making one took more than 10 s"
    if made.returncode != 0:
        return f"no network namespace: {(made.stderr.strip().splitlines() or ['no permission'])[-1]}"
    return None


def in_namespace(timeout: float = 30.0, packages: Sequence[str] = ("livekit", "aiohttp", "aiortc")) -> Callable:
    """Decorator of a test, plain or async: it runs in a namespace, or is skipped with the reason.

    The decorated tests of a file that were selected run together in one pytest of their own: starting one costs more
    than most of them. Fixtures work as usual.

    Args:
        timeout: seconds for this test.
        packages: modules that the test needs; where one is missing, it is skipped.
    """

    def decorate(test: Callable[..., Any]) -> Callable[..., None]:
        signature = inspect.signature(test)
        wants_request = "request" in signature.parameters

        @functools.wraps(test)
        def run(request: pytest.FixtureRequest, **fixtures: Any) -> None:
            for package in packages:
                pytest.importorskip(package)
            if os.environ.get(_INSIDE):
                outcome = test(**fixtures, **({"request": request} if wants_request else {}))
                if inspect.iscoroutine(outcome):
                    asyncio.run(asyncio.wait_for(outcome, timeout))
                return
            if (reason := skip_reason()) is not None:
                pytest.skip(reason)
            _report(request.node)

        own = [*signature.parameters.values()]
        request = inspect.Parameter("request", inspect.Parameter.POSITIONAL_OR_KEYWORD)
        run.__signature__ = signature.replace(parameters=own if wants_request else [request, *own])  # type: ignore
        run.namespace_timeout = timeout  # type: ignore
        return run

    return decorate


_outcomes: dict[str, tuple[str, str]] = {}
"""What became of a test in its namespace, by node: `passed`, `failed` or `skipped`, and the text."""


def _report(node: pytest.Item) -> None:
    """Pass, fail or skip as the test did in its namespace, running it and its fellows first if that is to be done."""
    if node.nodeid not in _outcomes:
        fellows = [
            item
            for item in node.session.items
            if item.path == node.path and hasattr(getattr(item, "function", None), "namespace_timeout")
        ]
        _outcomes.update(_run([item for item in fellows if item.nodeid not in _outcomes]))
    outcome, text = _outcomes[node.nodeid]
    if outcome == "failed":
        pytest.fail(text, pytrace=False)
    if outcome == "skipped":
        pytest.skip(text)


def _run(items: Sequence[Any]) -> dict[str, tuple[str, str]]:
    """Run tests of one file in a namespace."""
    root = items[0].config.rootpath
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "results.xml"
        nodes = [str(root / item.nodeid) for item in items]
        options = ["-q", "--no-header", "-p", "no:cacheprovider", "--tb=short", f"--junitxml={results}"]
        limit = 30.0 + sum(item.function.namespace_timeout for item in items)
        try:
            done = run_in_namespace([sys.executable, "-m", "pytest", *options, *nodes], limit)
            said = f"{done.stdout}\n{done.stderr}"
        except subprocess.TimeoutExpired as late:
            said = f"not done after {limit:g} s\n{late.stdout}\n{late.stderr}"
        cases = list(ElementTree.parse(results).iter("testcase")) if results.is_file() else []
    found: dict[str, tuple[str, str]] = {
        item.nodeid: ("failed", f"it did not run to its end\n{said}") for item in items
    }
    nodeids = {item.name: item.nodeid for item in items}
    for case in cases:
        parts = {part.tag: part for part in case}
        if "failure" in parts or "error" in parts:
            outcome = "failed", "\n".join(part.text or "" for part in case)
        elif "skipped" in parts:
            outcome = "skipped", parts["skipped"].get("message", "")
        else:
            outcome = "passed", ""
        if (nodeid := nodeids.get(case.get("name", ""))) is not None:
            found[nodeid] = outcome
    return found


def _unshare() -> list[str]:
    unshare = shutil.which("unshare", path=_search_path()) or "unshare"
    return [unshare, "--net"] if os.geteuid() == 0 else [unshare, "--map-root-user", "--net"]


def _search_path() -> str:
    """PATH with the folders where `ip` is found and that users often lack."""
    return os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"])
