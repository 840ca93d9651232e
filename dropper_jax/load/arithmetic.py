"""Arithmetic in scenes: `= loops * spacing + 1`. Numbers, names and a few functions; no code is executed."""

from __future__ import annotations

import ast
import math
import operator
import warnings
from collections.abc import Callable, Mapping

from dropper_jax.base.errors import SceneError, nearest

Number = int | float

BINARY: dict[type[ast.operator], Callable[[Number, Number], Number]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: math.pow,  # for floats: prevents powers of whole numbers that exhaust the memory
}
UNARY: dict[type[ast.unaryop], Callable[[Number], Number]] = {ast.UAdd: operator.pos, ast.USub: operator.neg}
#: Angles are in radians; `radians` turns degrees into them.
FUNCTIONS: dict[str, Callable[..., Number]] = {
    "abs": abs,
    "min": min,
    "max": max,
    "round": round,
    "floor": math.floor,
    "ceil": math.ceil,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "log": math.log,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "radians": math.radians,
}
CONSTANTS = {"pi": math.pi}
#: Maximum length of an expression [characters].
LONGEST = 500
ALLOWED = f"numbers, names, + - * / // % **, brackets and {', '.join(FUNCTIONS)}"


def evaluate(text: str, names: Mapping[str, Number], path: str) -> Number:
    """The value of an expression.

    Args:
        names: values of its names; looked up when they occur.
        path: its path in the scene, for errors.

    Raises:
        SceneError: not an arithmetic expression, an unknown name (with the nearest), or a result that is not finite.
    """
    if len(text) > LONGEST:
        raise SceneError(f"{path}: an expression of {len(text)} characters; allowed: at most {LONGEST}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # such as `1if`: rejected below
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise SceneError(f"{path}: {text.strip()!r} is not a valid expression; allowed: {ALLOWED}") from None
    try:
        found = _value(tree, names, path)
    except (ZeroDivisionError, OverflowError, ValueError, TypeError, RecursionError) as error:
        raise SceneError(f"{path}: {text.strip()!r} has no value ({error}); allowed: a finite number") from None
    if isinstance(found, float) and not math.isfinite(found):
        raise SceneError(f"{path}: {text.strip()!r} is {found}; allowed: a finite number")
    return found


def _value(node: ast.expr, names: Mapping[str, Number], path: str) -> Number:
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return node.value
    if isinstance(node, ast.Name):
        if node.id in names:
            return names[node.id]
        if node.id in CONSTANTS:
            return CONSTANTS[node.id]
        raise SceneError(f"{path}: {node.id!r} is unknown; {nearest(node.id, [*names, *CONSTANTS, *FUNCTIONS])}")
    if isinstance(node, ast.BinOp) and type(node.op) in BINARY:
        return BINARY[type(node.op)](_value(node.left, names, path), _value(node.right, names, path))
    if isinstance(node, ast.UnaryOp) and type(node.op) in UNARY:
        return UNARY[type(node.op)](_value(node.operand, names, path))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        if node.func.id not in FUNCTIONS:
            raise SceneError(f"{path}: {node.func.id}() is unknown; {nearest(node.func.id, FUNCTIONS)}")
        return FUNCTIONS[node.func.id](*(_value(a, names, path) for a in node.args))
    raise SceneError(f"{path}: {ast.unparse(node)!r} is not allowed in an expression; allowed: {ALLOWED}")
