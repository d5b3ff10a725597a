"""Devices side by side."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxalign.study.devices import placed

# A study on two devices; how often its two large programs are compiled.
STUDY = """
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", 2)
from jaxalign.simulate import scenario
from jaxalign.study import Study, run
compiled = []
def heard(event, seconds, fun_name="", **more):
    if "backend_compile" in event:
        compiled.append(fun_name)
jax.monitoring.register_event_duration_secs_listener(heard)
run(Study(scenario("dvl-sturn", duration=20.0), ["oba", "centred_oba"], 100))
print(len(jax.devices()), compiled.count("jit(_draw)"), compiled.count("jit(_reduce)"))
"""


def test_what_is_placed_stays():
    device = jax.devices()[0]
    tree = {"a": np.arange(3.0), "b": jnp.arange(2.0), "c": np.float64(1.0), "d": "no array"}
    once = placed(tree, device)
    assert all(once[name].committed for name in "abc")
    assert once["d"] is tree["d"]
    again = placed(once, device)
    assert all(again[name] is once[name] for name in "abcd")
    np.testing.assert_array_equal(once["a"], tree["a"])


@pytest.mark.slow
@pytest.mark.uncached
def test_devices_share_their_programs():
    """Each is compiled once: two devices want the same kinds of arguments."""
    done = subprocess.run([sys.executable, "-c", STUDY], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["2", "1", "2"]
