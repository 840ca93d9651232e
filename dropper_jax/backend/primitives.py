"""JAX's operations by name: those that act on each element alone, and those that XLA compiles inline."""

from __future__ import annotations

ARITHMETIC = ["add", "add_any", "sub", "mul", "div", "rem", "neg", "abs", "sign", "max", "min", "clamp", "nextafter"]
POWERS = ["square", "sqrt", "rsqrt", "cbrt", "integer_pow", "pow"]
EXPONENTIALS = ["exp", "exp2", "expm1", "log", "log1p", "logistic", "erf"]
TRIGONOMETRY = ["sin", "cos", "tan", "asin", "acos", "atan", "atan2"]
HYPERBOLIC = ["sinh", "cosh", "tanh", "asinh", "acosh", "atanh"]
ROUNDING = ["floor", "ceil", "round", "is_finite"]
LOGIC = ["and", "or", "xor", "not", "eq", "ne", "lt", "le", "gt", "ge", "lt_to", "le_to", "select_n"]
COPIES = ["convert_element_type", "copy", "stop_gradient"]
#: Operations that act on each element alone.
ELEMENTWISE = frozenset(ARITHMETIC + POWERS + EXPONENTIALS + TRIGONOMETRY + HYPERBOLIC + ROUNDING + LOGIC + COPIES)

SHAPES = ["broadcast_in_dim", "reshape", "squeeze", "transpose", "rev", "tile", "pad", "iota"]
PARTS = ["slice", "dynamic_slice", "dynamic_update_slice", "gather", "concatenate", "split", "stack", "unstack"]
REDUCTIONS = ["reduce_sum", "reduce_prod", "reduce_max", "reduce_min", "reduce_and", "reduce_or", "argmax", "argmin"]
BITS = ["bitcast_convert_type", "reduce_precision", "shift_left", "shift_right_logical", "shift_right_arithmetic"]
LOOPS = ["scan", "while", "cond", "custom_linear_solve"]
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
MARKERS = ["optimization_barrier", "pvary"]
#: Operations of JAX that XLA compiles inline, without a call of a library.
INLINE = ELEMENTWISE.union(SHAPES, PARTS, REDUCTIONS, BITS, LOOPS, CALLS, MARKERS)
