import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with the frozen cases and the real logs; tests that need it skip where it is absent."""
    path = Path(os.environ.get("JAXALIGN_SHARED", ROOT.parent / "shared"))
    if not (path / "cases").is_dir():
        pytest.skip("no shared cases and logs here (set JAXALIGN_SHARED to their folder)")
    return path
