"""Physics as pure JAX functions over batches of robots: MJX on its jax and warp backends, and C MuJoCo by callback.

Everything here needs JAX (`pip install 'asimov-gym[mjx]'`). Importing this package before JAX starts up prepares JAX
for machines with few cores; see `asimov_gym.physics.functional.runtime`.
"""

from asimov_gym.physics.functional import runtime as _runtime

_runtime.prepare()  # before the imports below bring JAX

from asimov_gym.physics.functional.c_engine import CEngine  # noqa: E402
from asimov_gym.physics.functional.engine import Engine, Simulation, make_engine  # noqa: E402
from asimov_gym.physics.functional.mjx_engine import MjxEngine  # noqa: E402
from asimov_gym.physics.functional.runtime import enable_compile_cache  # noqa: E402

__all__ = ["CEngine", "Engine", "MjxEngine", "Simulation", "enable_compile_cache", "make_engine"]
