"""Expressions of numbers and names in a scene: `= loops * spacing`."""

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
FUNCTIONS: dict[str, Callable[..., Number]] = {f.__name__: f for f in (abs, min, max, round, math.floor, math.ceil)}
FUNCTIONS |= {f.__name__: f for f in (math.sqrt, math.exp, math.log, math.sin, math.cos, math.tan, math.radians)}
CONSTANTS = {"pi": math.pi}
#: Maximum length of an expression [characters].
MAX_LENGTH = 500
ALLOWED = f"numbers, names, + - * / // % **, brackets and {', '.join(FUNCTIONS)}"


def evaluate(text: str, names: Mapping[str, Number], path: str) -> Number:
    """The value of an expression.

    Args:
        names: values of its names; looked up when they occur.
        path: its path in the scene, for errors.

    Raises:
        SceneError: not an arithmetic expression, an unknown name (with the nearest), or a result that is not finite.
    """
    tree = _parse(text, path)
    try:
        found = _value(tree, names, path)
        finite = math.isfinite(found)
    except SceneError:  # is a ValueError, and has its reason
        raise
    except (ZeroDivisionError, OverflowError, ValueError, TypeError, RecursionError) as error:
        raise SceneError(f"{path}: {text.strip()!r} has no value ({error}); allowed: a finite number") from None
    if not finite:
        raise SceneError(f"{path}: {text.strip()!r} is {found}; allowed: a finite number")
    return found


def names_in(text: str, path: str) -> list[str]:
    """Names of the numbers in an expression, without those of functions.

    Args:
        path: its path in the scene, for errors.

    Raises:
        SceneError: not a valid expression.
    """
    nodes = list(ast.walk(_parse(text, path)))
    functions = {node.func for node in nodes if isinstance(node, ast.Call)}
    return [node.id for node in nodes if isinstance(node, ast.Name) and node not in functions]


def _parse(text: str, path: str) -> ast.expr:
    if len(text) > MAX_LENGTH:
        raise SceneError(f"{path}: an expression of {len(text)} characters; allowed: at most {MAX_LENGTH}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # such as `1if`: rejected below
            return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise SceneError(f"{path}: {text.strip()!r} is not a valid expression; allowed: {ALLOWED}") from None


def _value(node: ast.expr, names: Mapping[str, Number], path: str) -> Number:
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return number
        case ast.Name(id=name) if name in names:
            return names[name]
        case ast.Name(id=name) if name in CONSTANTS:
            return CONSTANTS[name]
        case ast.Name(id=name):
            raise SceneError(f"{path}: {name!r} is unknown; {nearest(name, [*names, *CONSTANTS, *FUNCTIONS])}")
        case ast.BinOp(left=left, op=operation, right=right) if type(operation) in BINARY:
            return BINARY[type(operation)](_value(left, names, path), _value(right, names, path))
        case ast.UnaryOp(op=operation, operand=operand) if type(operation) in UNARY:
            return UNARY[type(operation)](_value(operand, names, path))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            return FUNCTIONS[name](*(_value(argument, names, path) for argument in arguments))
        case ast.Call(func=ast.Name(id=name), keywords=[]):
            raise SceneError(f"{path}: {name}() is unknown; {nearest(name, FUNCTIONS)}")
    raise SceneError(f"{path}: {ast.unparse(node)!r} is not allowed in an expression; allowed: {ALLOWED}")
