"""Programs that are traced once: `asimov_gym.envs.functional.kept_program`."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

jax = pytest.importorskip("jax", reason="needs JAX and MJX: pip install 'asimov-gym[mjx]'")
pytest.importorskip("asimov_gym.physics.functional", reason="needs JAX and MJX: pip install 'asimov-gym[mjx]'")

from asimov_gym.envs.functional import FunctionalVelocity, FunctionalWalk, kept_program  # noqa: E402
from asimov_gym.envs.functional.kept_program import KeptProgram, identity  # noqa: E402
from asimov_gym.envs.velocity_batch import shipped_policy  # noqa: E402
from asimov_gym.physics.functional import MjxEngine  # noqa: E402
from asimov_gym.physics.functional.runtime import enable_compile_cache, keep_what_is_compiled  # noqa: E402
from asimov_gym.tasks.walk import WalkConfig  # noqa: E402


@pytest.fixture(autouse=True)
def folder(tmp_path: Path) -> Iterator[Path]:
    """Where programs are kept."""
    before = jax.config.values["jax_compilation_cache_dir"]
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "programs"
    jax.config.update("jax_compilation_cache_dir", before)


class Doubling:
    """A function that counts how often it is traced."""

    def __init__(self) -> None:
        self.traced = 0

        def double(x: Any) -> Any:
            self.traced += 1
            return {"twice": 2.0 * x}

        self.compiled = jax.jit(double)

    def kept(self, name: str = "double", identity: str | None = "someone") -> KeptProgram:
        return KeptProgram(self.compiled, name, identity)


X = np.array([1.0, -2.5], np.float32)


def test_a_program_is_traced_once_and_read_the_next_time(folder: Path) -> None:
    first, second = Doubling(), Doubling()
    np.testing.assert_array_equal(first.kept()(X)["twice"], 2 * X)
    assert first.traced == 1 and [path.suffix for path in folder.iterdir()] == [".jax"]
    program = second.kept()
    for x in (X, 3 * X):
        np.testing.assert_array_equal(program(x)["twice"], 2 * x)
    assert second.traced == 0


@pytest.mark.parametrize(
    ("name", "whose", "x"),
    [
        ("other", "someone", X),
        ("double", "someone else", X),
        ("double", "someone", X[:1]),
        ("double", "someone", X > 0),
    ],
    ids=["name", "identity", "shape", "type"],
)
def test_what_differs_is_traced_anew(name: str, whose: str, x: np.ndarray) -> None:
    Doubling().kept()(X)
    other = Doubling()
    np.testing.assert_array_equal(other.kept(name, whose)(x)["twice"], 2 * x)
    assert other.traced == 1


@pytest.mark.parametrize("content", [b"", b"not a program", None], ids=["empty", "text", "half"])
def test_a_damaged_file_is_made_anew(folder: Path, content: bytes | None, caplog: pytest.LogCaptureFixture) -> None:
    Doubling().kept()(X)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if content is None else content)
    after, later = Doubling(), Doubling()
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(after.kept()(X)["twice"], 2 * X)
    assert "cannot be read and is made anew" in caplog.text and after.traced == 1
    assert later.kept()(X)["twice"].shape == X.shape and later.traced == 0


def test_a_folder_that_cannot_be_written_is_no_obstacle(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder.write_text("in the way")
    with caplog.at_level(logging.WARNING):
        np.testing.assert_array_equal(Doubling().kept()(X)["twice"], 2 * X)
    assert "is made anew" in caplog.text or "cannot be written" in caplog.text
    assert folder.read_text() == "in the way"


def test_without_an_identity_nothing_is_written(folder: Path) -> None:
    np.testing.assert_array_equal(Doubling().kept(identity=None)(X)["twice"], 2 * X)
    assert not folder.exists()


def test_what_cannot_be_kept_runs_all_the_same(folder: Path) -> None:
    def asked(x: Any) -> Any:
        return jax.pure_callback(lambda y: 2 * np.asarray(y), jax.ShapeDtypeStruct(x.shape, x.dtype), x)

    np.testing.assert_array_equal(KeptProgram(jax.jit(asked), "asked", "someone")(X), 2 * X)
    assert not folder.exists()


def test_programs_not_used_for_longest_are_removed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept_program, "KEPT", 2)
    for age, name in enumerate(("oldest", "middle", "newest")):
        Doubling().kept(name)(X)
        for path in folder.glob(f"{name}-*"):
            os.utime(path, (1000 + age, 1000 + age))
    Doubling().kept("middle")(X)  # used again, so no longer the oldest
    Doubling().kept("last")(X)
    assert sorted(path.name.partition("-")[0] for path in folder.iterdir()) == ["last", "middle"]


_FACTOR = """
import sys
import jax, numpy
from asimov_gym.envs.functional.kept_program import KeptProgram
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
def factor(a):
    assert sys.argv[2] == "first", "traced again"
    return jax.numpy.linalg.cholesky(a)
program = KeptProgram(jax.jit(factor), "factor", "someone")
print(numpy.asarray(program(numpy.diag([4.0, 9.0]).astype("float32"))).tolist())
"""


def test_linear_algebra_runs_in_a_process_that_has_not_traced_it(tmp_path: Path) -> None:
    for start in ("first", "second"):
        command = [sys.executable, "-c", _FACTOR, str(tmp_path), start]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert done.stdout.splitlines()[-1] == "[[2.0, 0.0], [0.0, 3.0]]"


# -- identity ----------------------------------------------------------------------------------------------------------


class Foreign(FunctionalWalk):
    """An environment whose source is not this package's."""


def walk(config: WalkConfig | None = None, physics: Any = "mjx", **arguments: Any) -> FunctionalWalk:
    return FunctionalWalk(config, physics, **arguments)


def test_equal_environments_are_the_same_also_when_used() -> None:
    used = walk()
    before = identity(used)
    used.shapes()
    assert before is not None and identity(walk()) == before
    _ = used.compiled_step
    assert identity(used) == before


def test_whatever_tracing_may_depend_on_makes_another() -> None:
    environments = [
        walk(),
        walk(WalkConfig(episode_s=7.0)),
        walk(noise=False),
        walk(autoreset=False),
        walk(command=np.array([0.2, 0, 0], np.float32)),
        walk(command=np.array([0.3, 0, 0], np.float32)),
        walk(WalkConfig(terrain="slope:3")),
        FunctionalVelocity(),
    ]
    identities = [identity(env) for env in environments]
    assert None not in identities and len(set(identities)) == len(environments)


def test_the_weights_of_a_network_count(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx")
    model = onnx.load(shipped_policy())
    weights = next(tensor for tensor in model.graph.initializer if len(tensor.dims) == 2)
    changed = onnx.numpy_helper.to_array(weights).copy()
    changed[0, 0] += 1e-3
    weights.CopyFrom(onnx.numpy_helper.from_array(changed, weights.name))
    onnx.save(model, tmp_path / "other.onnx")
    identities = {identity(FunctionalVelocity(policy=path)) for path in (shipped_policy(), tmp_path / "other.onnx")}
    assert None not in identities and len(identities) == 2


def test_settings_of_jax_count() -> None:
    before = identity(walk())
    jax.config.update("jax_default_matmul_precision", "highest")
    try:
        assert identity(walk()) not in (None, before)
    finally:
        jax.config.update("jax_default_matmul_precision", None)


def test_the_source_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    env = walk()
    before = identity(env)
    monkeypatch.setattr(kept_program, "_code", lambda: "another version")
    assert identity(env) not in (None, before)


def test_code_from_outside_is_not_kept(tmp_path: Path) -> None:
    def own_robot() -> Any:
        from asimov_gym.robot.model import robot_spec

        return robot_spec(visuals=False)

    assert identity(walk(physics=MjxEngine(trail=walk().engine.trail))) == identity(walk())
    assert identity(Foreign()) is None
    assert identity(walk(physics=MjxEngine(spec=own_robot, trail=walk().engine.trail))) is None
    assert identity(walk(dump_dir=tmp_path)) is None
    assert identity(walk(physics="c")) is None


# -- the cache ---------------------------------------------------------------------------------------------------------


def test_the_compile_cache_is_on_unless_told_otherwise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert keep_what_is_compiled() == tmp_path, "a folder that was chosen stays"
    jax.config.update("jax_compilation_cache_dir", "gs://bucket/cache")
    assert keep_what_is_compiled() is None
    jax.config.update("jax_compilation_cache_dir", None)
    assert keep_what_is_compiled() == tmp_path / "home" / "asimov-gym" / "xla"
    assert jax.config.values["jax_compilation_cache_dir"] == str(tmp_path / "home" / "asimov-gym" / "xla")
    jax.config.update("jax_enable_compilation_cache", False)
    try:
        assert keep_what_is_compiled() is None
    finally:
        jax.config.update("jax_enable_compilation_cache", True)


def test_a_version_of_jax_that_reads_its_cache_wrongly_keeps_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "__version_info__", (0, 5, 3))
    assert keep_what_is_compiled() is None and identity(walk()) is None
    with pytest.raises(RuntimeError, match=r"needs 0\.6\.2 or newer"):
        enable_compile_cache()


def test_a_home_that_cannot_be_written_is_no_obstacle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    jax.config.update("jax_compilation_cache_dir", None)
    with caplog.at_level(logging.WARNING):
        assert keep_what_is_compiled() is None
    assert "not kept for the next start" in caplog.text


_START = """
import json, sys, time
import gymnasium, numpy, asimov_gym
began = time.perf_counter()
envs = gymnasium.make_vec(sys.argv[1], num_envs=2, physics="mjx")
envs.reset(seed=3)
seconds = None
total = numpy.zeros(2)
for _ in range(5):
    observation, reward, *_ = envs.step(numpy.full(envs.action_space.shape, 0.1, numpy.float32))
    seconds = seconds or time.perf_counter() - began
    total += reward
leaves = observation.values() if isinstance(observation, dict) else [observation]
print(json.dumps([seconds, total.tolist(), [numpy.asarray(leaf).tolist() for leaf in leaves]]))
"""


@pytest.mark.slow
def test_a_second_start_is_fast_and_does_the_same(env_id: str, tmp_path: Path) -> None:
    chosen = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}

    def start(**more: str) -> Any:
        variables = chosen | {"XDG_CACHE_HOME": str(tmp_path)} | more
        done = subprocess.run(
            [sys.executable, "-c", _START, env_id], env=variables, capture_output=True, text=True, check=True
        )
        return json.loads(done.stdout.splitlines()[-1])

    first, second = start(), start()
    assert second[1:] == first[1:]
    assert len(list((tmp_path / "asimov-gym" / "xla" / "programs").glob("*.jax"))) == 2
    # 20 % is the goal on a quiet machine (`asimov bench env`); this is a test of every machine.
    assert second[0] < 0.4 * first[0]
    # Nothing is lost on the way through the file.
    plain = start(JAX_ENABLE_COMPILATION_CACHE="false")
    np.testing.assert_allclose(plain[1], first[1], rtol=1e-5, atol=1e-6)
    for ours, theirs in zip(plain[2], first[2], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)
