"""What identifies the user's own effects in stored results: the content of their files."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

from dropper_jax.effects import EFFECTS, REGISTERED_FILES
from dropper_jax.load.scene import Scene


def effect_digests(scene: Scene) -> list[str]:
    """SHA-256 of each registered file (`--effects FILE.py`) with an effect of the scene, in their order."""
    modules = {sys.modules[EFFECTS[name].__module__] for name in scene.effects}
    used = {str(Path(module.__file__).resolve()) for module in modules if module.__file__ is not None}
    return [hashlib.sha256(Path(file).read_bytes()).hexdigest() for file in REGISTERED_FILES if file in used]
