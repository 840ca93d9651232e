"""A differentiable simulator of mussel droppers: chains of links, hanging, looped, damped, driven.

Scene -> model -> effects -> residual -> step -> solution. Importing the package turns on float64 in JAX (set
`JAX_ENABLE_X64` beforehand to prevent that); a scene may still choose float32. JAX itself and the names below are
imported on first use, so that the command line can reject a typing error at once.
"""

import ast
import os
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from dropper_jax.base.renamed import OldModules, old_names

#: Public names and their modules, as given by the stub next to this file, which editors read.
_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_HOME_OF = {name.name: node.module for node in _STUB.body[1:] for name in node.names}

__all__ = sorted(_HOME_OF)

sys.meta_path.append(OldModules())

if "JAX_ENABLE_X64" not in os.environ:
    if "jax" in sys.modules:
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        # JAX reads it when it is imported, possibly by the user. Child processes of this one inherit it and
        # compute in float64 as well, as they would with the package imported.
        os.environ["JAX_ENABLE_X64"] = "1"


def __getattr__(name: str) -> object:
    if name in _HOME_OF:
        found = getattr(import_module(_HOME_OF[name]), name)
        globals()[name] = found
        return found
    if not name.startswith("_") and find_spec(f"{__name__}.{name}") is not None:
        return import_module(f"{__name__}.{name}")
    return old_names(__name__, above=1)(name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
