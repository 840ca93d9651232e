"""Load cases of a site: resumable runs, utilisation of parts and anchors, and a one-page report."""

from fitting.cases.assess import assess
from fitting.cases.page import write_page
from fitting.cases.run import CasesStopped, run_cases

__all__ = ["CasesStopped", "assess", "run_cases", "write_page"]
