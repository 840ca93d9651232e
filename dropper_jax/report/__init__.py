"""`dropper report`: what an engineer asks of saved runs; docs/report.md says what each number means."""

from dropper_jax.report.build import report_run, report_runs
from dropper_jax.report.settings import Settings
from dropper_jax.report.vtk import write_vtk
from dropper_jax.report.write import write_report

__all__ = ["Settings", "report_run", "report_runs", "write_report", "write_vtk"]
