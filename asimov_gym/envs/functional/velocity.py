"""`Asimov-Velocity-v0` as pure functions: steer the walking robot through waypoints, its network inside the graph."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from asimov_gym.envs.functional.env import Advance, Draws, FunctionalEnv
from asimov_gym.envs.spaces import velocity_spaces
from asimov_gym.envs.velocity_batch import check_policy, shipped_policy
from asimov_gym.physics import DECIMATION, BodyParameters, JointTarget, PhysicsProfile
from asimov_gym.physics.functional import Engine, Simulation
from asimov_gym.physics.functional.engine import register
from asimov_gym.policy import PolicyContract, PolicyState, joint_gains
from asimov_gym.policy.driver import PolicyLaw
from asimov_gym.policy.network import read_network
from asimov_gym.robot.joints import POLICY_JOINT_NAMES
from asimov_gym.tasks.ground_truth import critic_view, ground_truth
from asimov_gym.tasks.velocity import VelocityConfig, VelocityState, VelocityTask
from asimov_gym.tasks.velocity.task import COMMAND_LIMIT, DT, POLICY_STEPS


class Network(Protocol):
    """A network that JAX can trace: `asimov_gym.policy.network.PolicyNetwork`, or one of your own."""

    contract: PolicyContract

    def infer(self, observation: Any) -> Any:
        """Raw outputs (n, 23) for observations (n, width)."""
        ...


@dataclass(frozen=True)
class VelocityWorld:
    """N robots that walk by a policy, between two steps."""

    simulation: Simulation
    task: VelocityState
    policy: PolicyState
    """What the walking network remembers."""


for _cls in (VelocityState, PolicyState, VelocityWorld):
    register(_cls)


class FunctionalVelocity(FunctionalEnv):
    """The waypoint task; see `asimov_gym.envs.velocity.VelocityEnv` for what it asks.

    Args:
        config: the task.
        policy: the walking network: path to an ONNX file, or one that JAX can trace; the shipped one when None.
        physics: `c`, `mjx`, `warp`, or an engine.
        profile: physics profile of a named engine.
        threads: size of the thread pool of C physics.
        autoreset: whether episodes follow each other.
        dump_dir: where the state of diverged copies is written.

    Raises:
        FileNotFoundError: there is no such policy file.
        PolicyFileError: its network cannot be read into a compiled graph.
        ValueError: the policy is not one that this robot can walk by.
    """

    step_draws: dict[str, int] = {}  # noqa: RUF012
    dt = DT

    def __init__(
        self,
        config: VelocityConfig | None = None,
        policy: str | Path | Network | None = None,
        physics: str | Engine = "mjx",
        profile: str | PhysicsProfile = "training",
        threads: int | None = None,
        *,
        autoreset: bool = True,
        dump_dir: Path | None = None,
    ) -> None:
        super().__init__(physics, profile, threads, autoreset, dump_dir)
        self.task = VelocityTask(config)
        self.start_draws = {"state": self.task.start_draws}
        self.observation_space, self.action_space = velocity_spaces()
        policy = shipped_policy() if policy is None else policy
        network = read_network(policy) if isinstance(policy, str | Path) else policy
        self._network: Network = check_policy(network)
        self._law = PolicyLaw(self._network.contract)

    def begin(self, draws: Draws, before: VelocityWorld | None) -> VelocityWorld:
        state, heading = self.task.initial_state(draws["state"])
        n = heading.shape[0]
        zero = jnp.zeros_like(heading)
        quat = jnp.stack([jnp.cos(0.5 * heading), zero, zero, jnp.sin(0.5 * heading)], axis=-1)
        standing = self.engine.stand(n)
        simulation = self.engine.start(standing.qpos.at[:, 3:7].set(quat), standing.qvel)
        action = jnp.zeros((n, len(POLICY_JOINT_NAMES)), dtype=jnp.float32)
        return VelocityWorld(simulation, state, PolicyState(action, zero))

    def advance(self, world: VelocityWorld, action: Any, draws: Draws) -> Advance:
        action = action.astype(jnp.float32)
        state = self.task.push_command(world.task, action)
        n, command = action.shape[0], state.command[:, 0]
        nobody = jnp.zeros(n, dtype=bool)
        gains = BodyParameters.with_gains(*joint_gains(self._network.contract), 1)
        body = None if gains is None else jax.tree.map(lambda a: jnp.tile(jnp.asarray(a, jnp.float32), (n, 1)), gains)

        def walk(carry: tuple[Any, ...], _: None) -> tuple[tuple[Any, ...], Any]:
            simulation, policy, fallen, diverged = carry
            r = self.engine.read(simulation)
            s = self._law.step(
                policy,
                self._network.infer,
                gyro=r.gyro,
                gravity=r.gravity,
                command=command,
                joint_position=r.joint_position,
                joint_velocity=r.joint_velocity,
            )
            simulation, broken = self.engine.step(simulation, JointTarget(s.targets), DECIMATION, body)
            fallen = fallen | self.task.fallen(self.engine.read(simulation))
            return (simulation, s.state, fallen, diverged | broken), s.command

        start = (world.simulation, world.policy, nobody, nobody)
        (simulation, policy, fallen, diverged), applied = jax.lax.scan(walk, start, None, POLICY_STEPS)
        before, after = self.engine.read(world.simulation), self.engine.read(simulation)
        outcome = self.task.conclude(state, before, after, fallen, diverged)
        report = {
            "reward_terms": dict(outcome.shares),
            "clipped": jnp.sum(jnp.abs(action) > jnp.asarray(COMMAND_LIMIT, dtype=jnp.float32), axis=-1),
            "applied_command": applied[-1],
            "success": self.task.finished(outcome.state),
        }
        return Advance(VelocityWorld(simulation, outcome.state, policy), outcome, diverged, report)

    def observe(self, world: VelocityWorld, draws: Draws) -> dict[str, Any]:
        reading = self.engine.read(world.simulation)
        state = self.task.observe(world.task, reading)
        return {"state": state, "privileged_state": critic_view(state, list(ground_truth(reading).values()))}

    def figures(self, world: VelocityWorld) -> dict[str, Any]:
        reading = self.engine.read(world.simulation)
        return {"waypoints_reached": world.task.aim, "distance": self.task.distance(world.task, reading)}

    def blank_report(self, copies: int) -> dict[str, Any]:
        zero = jnp.zeros(copies, dtype=jnp.float32)
        return {
            "reward_terms": dict.fromkeys(self.task.config.rewards, zero),
            "clipped": jnp.zeros(copies, dtype=jnp.int32),
            "applied_command": jnp.zeros((copies, 3), dtype=jnp.float32),
            "success": jnp.zeros(copies, dtype=bool),
        }
