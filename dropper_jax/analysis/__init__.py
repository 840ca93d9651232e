"""Analysis of a motion: link angles, spectra, phase space, energy balance. Plain numpy, after the run."""

from dropper_jax.analysis.angles import angle_rates, angles_to_links, link_angles, phase_curve
from dropper_jax.analysis.energy import balance_drift, effect_power, energy_table
from dropper_jax.analysis.spectrum import amplitude_spectrum
from dropper_jax.analysis.writhe import writhe

__all__ = [
    "amplitude_spectrum",
    "angle_rates",
    "angles_to_links",
    "balance_drift",
    "effect_power",
    "energy_table",
    "link_angles",
    "phase_curve",
    "writhe",
]
