"""Arrays of a configuration's numbers, made without compiling anything."""

from typing import Any

import jax
import numpy as np
from jax import Array
from jax.typing import DTypeLike


def host_array(values: Any, dtype: DTypeLike) -> Array:
    """Numbers of a configuration; `jnp.asarray` would compile a program for each shape."""
    return jax.device_put(np.asarray(values, dtype))
