"""Which values of a traced function have members: those that depend on a mapped argument.

Each function takes, for every input of an operation or a function, whether it has members, and returns the same for
every output. Loops and branches are followed into their own traced functions.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

from jax import Array

from dropper_jax.backend.primitives import CALLS
from dropper_jax.lanes.parameters import Parameters, Unreadable

#: Parts of a result of `jax.make_jaxpr`: a traced function, an operation of it, an input of an operation.
Program = Any
Operation = Any
Atom = Any
#: Whether each of several values has members.
Mapped = list[bool]


def split_constants(program: Program) -> tuple[Program, Sequence[Array]]:
    """A traced function and its constants; the function of a call may come without a list of them."""
    if hasattr(program, "consts"):
        return program.jaxpr, program.consts
    return program, ()


def is_literal(atom: Atom) -> bool:
    """Whether it is a number in the program, not a variable."""
    return hasattr(atom, "val")


def _mapped_results(program: Program, has_members: Mapped) -> Mapped:
    """Which results of a traced function have members, given which of its arguments have them."""
    jaxpr, _ = split_constants(program)
    known = dict.fromkeys(jaxpr.constvars, False) | dict(zip(jaxpr.invars, has_members, strict=True))

    def read(atom: Atom) -> bool:
        return not is_literal(atom) and known[atom]

    for eqn in jaxpr.eqns:
        inputs = [read(atom) for atom in eqn.invars]
        known.update(zip(eqn.outvars, _mapped_outputs(eqn, inputs), strict=True))
    return [read(a) for a in jaxpr.outvars]


def _mapped_outputs(eqn: Operation, has_members: Mapped) -> Mapped:
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
    """Numbers of constants and of carried values, the first inputs of a scan; its rows follow them."""
    if "num_consts" in p:
        return p["num_consts"], p["num_carry"]
    inputs = p["ft_in"]  # JAX 0.12
    if not hasattr(inputs, "unpack"):
        raise Unreadable(p.operation)
    consts, carry, _ = inputs.unpack()
    return len(consts), len(carry)


def _grow_carry(carry: Mapped, next_carry: Callable[[Mapped], Mapped]) -> Mapped:
    """Which carried values of a loop have members: one that gets them in an iteration has them from the start.

    Args:
        carry: which of them have members before the first iteration.
        next_carry: which have them after an iteration that starts with these.
    """
    while True:
        grown = list(map(operator.or_, carry, next_carry(carry)))
        if grown == carry:
            return carry
        carry = grown


def mapped_by_scan(p: Parameters, has_members: Mapped) -> Mapped:
    """Which values of the carry, and after them which saved values, of a scan have members."""
    consts, carried = scan_parts(p)
    bodies = has_members[:consts]
    rows = has_members[consts + carried :]

    def outputs(carry: Mapped) -> Mapped:
        return _mapped_results(p["jaxpr"], [*bodies, *carry, *rows])

    carry = _grow_carry(has_members[consts : consts + carried], lambda carry: outputs(carry)[:carried])
    return [*carry, *outputs(carry)[carried:]]


def mapped_by_while(p: Parameters, has_members: Mapped) -> tuple[Mapped, bool]:
    """Which values of the carry of a loop have members, and whether members disagree on when to stop.

    If they disagree, the whole carry has members.
    """
    tests = p["cond_nconsts"]
    bodies = tests + p["body_nconsts"]

    def disagree(carry: Mapped) -> bool:
        return _mapped_results(p["cond_jaxpr"], [*has_members[:tests], *carry])[0]

    def next_carry(carry: Mapped) -> Mapped:
        if disagree(carry):
            return [True] * len(carry)
        return _mapped_results(p["body_jaxpr"], [*has_members[tests:bodies], *carry])

    carry = _grow_carry(has_members[bodies:], next_carry)
    return carry, disagree(carry)


def mapped_by_cond(p: Parameters, has_members: Mapped) -> Mapped:
    """Which results of a branch on a shared index have members: those that have them in any branch."""
    branches = [_mapped_results(branch, has_members) for branch in p["branches"]]
    return [any(of_branches) for of_branches in zip(*branches, strict=True)]
