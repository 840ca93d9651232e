"""Wave numbers: linear dispersion in finite depth, at rest and on a current.

    s^2 = g k tanh(k d),    s = w - k U_e,    U_e = 2k/sinh(2kd) * integral of U(z) cosh(2k(z + d)) over the depth

(Kirby and Chen 1989 for U_e). All functions are elementwise, differentiable and free of overflow at any k d.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from dropper_jax.backend.programs import cached_jit
from dropper_jax.base.constants import GRAVITY
from dropper_jax.sea.current import Scalar


def fenton(omega: Array, depth: Scalar, gravity: Scalar = GRAVITY) -> Array:
    """Wave number [rad/m] of omega [rad/s] at depth [m], Fenton's explicit approximation, within 0.052 %.

    `k d = (a + b^2 sech^2 b)/(tanh b + b sech^2 b)`, `a = w^2 d/g`, `b = a/sqrt(tanh a)` (Fenton 1988, which the paper
    uses in its section 3.2.3; not the cruder one of Fenton and McKee 1990).
    """
    a = omega**2 * depth / gravity
    b = a / jnp.sqrt(jnp.tanh(a))
    sech2 = 1.0 - jnp.tanh(b) ** 2
    return (a + b**2 * sech2) / (jnp.tanh(b) + b * sech2) / depth


@cached_jit()
def wave_number(omega: Array, depth: Scalar, gravity: Scalar = GRAVITY) -> Array:
    """Wave number [rad/m] that satisfies `w^2 = g k tanh(k d)` to rounding, for omega [rad/s] and depth [m]."""
    a = omega**2 * depth / gravity
    kd = fenton(omega, depth, gravity) * depth
    # Newton steps from Fenton's approximation, whose relative error is below 5.2e-4: two reach rounding, the third is a
    # margin
    for _ in range(3):
        tanh = jnp.tanh(kd)
        kd = kd - (kd * tanh - a) / (tanh + kd * (1.0 - tanh**2))
    return kd / depth


def frequency(k: Array, depth: Scalar, gravity: Scalar = GRAVITY) -> Array:
    """Intrinsic frequency `sqrt(g k tanh(k d))` [rad/s]."""
    return jnp.sqrt(gravity * k * jnp.tanh(k * depth))


def group_velocity(k: Array, depth: Scalar, gravity: Scalar = GRAVITY) -> Array:
    """Group velocity in still water `(s/2k) (1 + 2kd/sinh 2kd)` [m/s]."""
    return 0.5 * frequency(k, depth, gravity) / k * (1.0 + ratio_sinh(2.0 * k * depth))


def ratio_sinh(x: Array) -> Array:
    """x/sinh(x) for x > 0 without overflow."""
    return -2.0 * x * jnp.exp(-x) / jnp.expm1(-2.0 * x)


def effective_current(k: Array, depth: Array, profile: Callable[[Array], Array]) -> Array:
    """U_e [m/s] per wave number k (c,): `profile(z)` gives U (c, points) along each wave at heights z (c, points).

    Exact for uniform and, to first order in the shear, for linear profiles: `U - O tanh(kd)/(2k)` for `U + O z`.
    """
    x, weight = np.polynomial.legendre.leggauss(64)
    height = jnp.minimum(depth, 20.0 / k)[:, None]  # the kernel below is e^-40, which is rounding
    z = height * (0.5 * (x - 1.0))
    k2 = 2.0 * k[:, None]
    kernel = -k2 * (jnp.exp(k2 * z) + jnp.exp(-k2 * (z + 2.0 * depth))) / jnp.expm1(-2.0 * k2 * depth)
    return jnp.sum(profile(z) * kernel * (0.5 * weight) * height, axis=1)


#: Newton steps on a current; monotone towards the root, slow only next to blocking.
CURRENT_STEPS = 60


def on_current(
    omega: Array, depth: Array, gravity: Array, profile: Callable[[Array], Array]
) -> tuple[Array, Array, Array]:
    """Wave number, intrinsic frequency s and U_e of waves of absolute frequency omega (c,) on a current.

    Newton on `f(k) = sqrt(g k tanh kd) + k U_e(k) - w`, which is concave for a uniform current: from the root without
    current it converges to the smaller root, which is that of a wave train coming from still water. If the current
    stops the waves no root exists, and the wave number is NaN.
    """

    def excess(k: Array) -> Array:
        return frequency(k, depth, gravity) + k * effective_current(k, depth, profile) - omega

    def correct(k: Array) -> Array:
        value, slope = jax.jvp(excess, (k,), (jnp.ones_like(k),))
        return k - value / jnp.where(slope > 0, slope, jnp.nan)

    start = jax.lax.stop_gradient(wave_number(omega, depth, gravity))
    k = jax.lax.stop_gradient(jax.lax.fori_loop(0, CURRENT_STEPS, lambda _, k: correct(k), start))
    k = correct(k)  # carries the derivative: a Newton step at the root is the implicit function theorem
    k = jnp.where(jnp.abs(excess(k)) < 1e-6 * omega, k, jnp.nan)
    return k, frequency(k, depth, gravity), effective_current(k, depth, profile)


def action_factor(omega: Array, k: Array, current: Array, depth: Array, gravity: Array) -> Array:
    """Amplitude on the current over that in still water: `E (c_g + U_e)/s` is conserved along the wave path.

    In deep water `E/E0 = 4/(s (1 + s)^2)`, `s = sqrt(1 + 4 U w/g)` (Longuet-Higgins and Stewart 1961).
    """
    before = group_velocity(wave_number(omega, depth, gravity), depth, gravity) / omega
    after = (group_velocity(k, depth, gravity) + current) / frequency(k, depth, gravity)
    return jnp.sqrt(before / after)
