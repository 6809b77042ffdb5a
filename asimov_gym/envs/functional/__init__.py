"""The environments as pure JAX functions over batches of robots: `reset(key)` and `step(state, action)`.

The tasks are those of the Gymnasium environments, and so are their functions; only the random numbers differ. Physics
is MJX or C MuJoCo (`asimov_gym.physics.functional`). `gym.make_vec(id, num_envs=N, physics="mjx")` gives a Gymnasium
vector environment over them. Needs JAX: `pip install 'asimov-gym[mjx]'`.
"""

from asimov_gym.physics import functional as _physics  # first: it prepares JAX before anything imports it

enable_compile_cache = _physics.enable_compile_cache

from asimov_gym.envs.functional.env import FunctionalEnv  # noqa: E402
from asimov_gym.envs.functional.state import EnvState  # noqa: E402
from asimov_gym.envs.functional.trajectory import FunctionalTrajectory  # noqa: E402
from asimov_gym.envs.functional.velocity import FunctionalVelocity  # noqa: E402
from asimov_gym.envs.functional.walk import FunctionalWalk  # noqa: E402

__all__ = [
    "EnvState",
    "FunctionalEnv",
    "FunctionalTrajectory",
    "FunctionalVelocity",
    "FunctionalWalk",
    "enable_compile_cache",
]
