"""Shorter waits for XLA: compiled programs are kept on disk, and small loops run as one call.

    from jaxalign import compilation
    compilation.configure()

Nothing of this happens on import: the command line calls :func:`configure`, and so may any program, before it runs
anything of JAX.
"""

from __future__ import annotations

from jaxalign.compilation.settings import configure, reloads

__all__ = ["configure", "reloads"]
