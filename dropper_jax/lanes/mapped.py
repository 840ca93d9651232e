"""Which values of a traced function have members: those that depend on a mapped argument."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from jax import Array

from dropper_jax.backend.primitives import CALLS
from dropper_jax.lanes.parameters import Parameters, Unreadable

#: Parts of a result of `jax.make_jaxpr`: a traced function, an operation of it, an input of an operation.
Program = Any
Operation = Any
Atom = Any


def split_constants(program: Program) -> tuple[Program, Sequence[Array]]:
    """A traced function, and its constants: that of a call may have none."""
    if hasattr(program, "consts"):
        return program.jaxpr, program.consts
    return program, ()


def is_literal(atom: Atom) -> bool:
    """Whether it is a number in the program, not a variable."""
    return hasattr(atom, "val")


def _mapped_results(program: Program, has_members: Sequence[bool]) -> list[bool]:
    """Which results of a traced function have members, given which of its arguments have them."""
    jaxpr, _ = split_constants(program)
    known = dict.fromkeys(jaxpr.constvars, False) | dict(zip(jaxpr.invars, has_members, strict=True))

    def read(atom: Atom) -> bool:
        return not is_literal(atom) and known[atom]

    for eqn in jaxpr.eqns:
        inputs = [read(atom) for atom in eqn.invars]
        known.update(zip(eqn.outvars, _mapped_outputs(eqn, inputs), strict=True))
    return [read(a) for a in jaxpr.outvars]


def _mapped_outputs(eqn: Operation, has_members: list[bool]) -> list[bool]:
    """Which outputs of an operation have members, given which of its inputs have them."""
    name = eqn.primitive.name
    p = Parameters(eqn)
    if not any(has_members):
        return [False] * len(eqn.outvars)
    if name in CALLS:
        return _mapped_results(p[CALLS[name]], has_members)
    if name == "scan":
        return mapped_by_scan(p, has_members)
    if name == "while":
        return mapped_by_while(p, has_members)[0]
    if name == "cond" and not has_members[0]:
        return mapped_by_cond(p, has_members[1:])
    return [True] * len(eqn.outvars)


def scan_parts(p: Parameters) -> tuple[int, int]:
    """Number of constants and of carried values among the inputs of a scan."""
    if "num_consts" in p:
        return p["num_consts"], p["num_carry"]
    inputs = p["ft_in"]  # JAX 0.12
    if not hasattr(inputs, "unpack"):
        raise Unreadable(p.operation)
    consts, carry, _ = inputs.unpack()
    return len(consts), len(carry)


def _mapped_carry(carry: list[bool], next_carry: Callable[[list[bool]], list[bool]]) -> list[bool]:
    """Which carried values have members: one that gets them in an iteration has them from the start."""
    while True:
        grown = [a or b for a, b in zip(carry, next_carry(carry), strict=False)]
        if grown == carry:
            return carry
        carry = grown


def mapped_by_scan(p: Parameters, has_members: list[bool]) -> list[bool]:
    """Which values of the carry and which saved values of a scan have members."""
    consts, carried = scan_parts(p)

    def next_carry(carry: list[bool]) -> list[bool]:
        return _mapped_results(p["jaxpr"], [*has_members[:consts], *carry, *has_members[consts + carried :]])

    carry = _mapped_carry(has_members[consts : consts + carried], next_carry)
    return [*carry, *next_carry(carry)[carried:]]


def mapped_by_while(p: Parameters, has_members: list[bool]) -> tuple[list[bool], bool]:
    """Which values of the carry of a loop have members, and whether members disagree on when to stop.

    If they disagree, the whole carry has members.
    """
    tests = p["cond_nconsts"]
    bodies = tests + p["body_nconsts"]

    def stops(carry: list[bool]) -> bool:
        return _mapped_results(p["cond_jaxpr"], [*has_members[:tests], *carry])[0]

    def next_carry(carry: list[bool]) -> list[bool]:
        if stops(carry):
            return [True] * len(carry)
        return _mapped_results(p["body_jaxpr"], [*has_members[tests:bodies], *carry])

    carry = _mapped_carry(has_members[bodies:], next_carry)
    return carry, stops(carry)


def mapped_by_cond(p: Parameters, has_members: list[bool]) -> list[bool]:
    """Which results of a branch on a shared index have members: those that have them in any branch."""
    branches = [_mapped_results(branch, has_members) for branch in p["branches"]]
    return [any(found) for found in zip(*branches, strict=True)]
