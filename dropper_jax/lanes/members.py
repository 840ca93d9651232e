"""Which values of a traced function have a member axis, found without evaluating it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jax.extend import core

Atom = core.Var | core.Literal

#: Operations that call a function once, and which parameter holds it.
CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "checkpoint": "jaxpr",
    "remat2": "jaxpr",
}


def close_jaxpr(program: core.Jaxpr | core.ClosedJaxpr) -> core.ClosedJaxpr:
    """The function of a call, with its constants."""
    return program if hasattr(program, "consts") else core.ClosedJaxpr(program, ())


def _which(program: core.ClosedJaxpr, many: Sequence[bool]) -> list[bool]:
    jaxpr = program.jaxpr
    known = dict.fromkeys(jaxpr.constvars, False) | dict(zip(jaxpr.invars, many, strict=True))

    def read(atom: Atom) -> bool:
        return not isinstance(atom, core.Literal) and known[atom]

    for eqn in jaxpr.eqns:
        known.update(zip(eqn.outvars, _which_of(eqn, [read(a) for a in eqn.invars]), strict=True))
    return [read(a) for a in jaxpr.outvars]


def _which_of(eqn: core.JaxprEqn, many: list[bool]) -> list[bool]:
    name, p = eqn.primitive.name, eqn.params
    if not any(many):
        return [False] * len(eqn.outvars)
    if name in CALLS:
        return _which(close_jaxpr(p[CALLS[name]]), many)
    if name == "scan":
        return which_scanned(p, many)
    if name == "while":
        return which_looped(p, many)[0]
    if name == "cond" and not many[0]:
        return which_branched(p, many[1:])
    return [True] * len(eqn.outvars)


def scan_parts(p: dict[str, Any]) -> tuple[int, int]:
    """Number of constants and of carried values among the inputs of a scan."""
    if "num_consts" in p:
        return p["num_consts"], p["num_carry"]
    consts, carry, _ = p["ft_in"].unpack()  # JAX 0.12
    return len(consts), len(carry)


def which_scanned(p: dict[str, Any], many: list[bool]) -> list[bool]:
    """For the carry and the saved values: a carry that gets members in one iteration has them from the start."""
    consts, carried = scan_parts(p)
    carry = many[consts : consts + carried]
    while True:
        out = _which(p["jaxpr"], [*many[:consts], *carry, *many[consts + carried :]])
        grown = [a or b for a, b in zip(carry, out, strict=False)]
        if grown == carry:
            return [*carry, *out[carried:]]
        carry = grown


def which_looped(p: dict[str, Any], many: list[bool]) -> tuple[list[bool], bool]:
    """For the carry and the test: if members disagree on when to stop, the whole carry has members."""
    tests, bodies = p["cond_nconsts"], p["body_nconsts"]
    carry = many[tests + bodies :]
    while True:
        test = _which(p["cond_jaxpr"], [*many[:tests], *carry])[0]
        out = _which(p["body_jaxpr"], [*many[tests : tests + bodies], *carry])
        grown = [test or a or b for a, b in zip(carry, out, strict=True)]
        if grown == carry:
            return carry, test
        carry = grown


def which_branched(p: dict[str, Any], many: list[bool]) -> list[bool]:
    """For the results: those for which any branch has members."""
    return [any(found) for found in zip(*(_which(b, many) for b in p["branches"]), strict=True)]
