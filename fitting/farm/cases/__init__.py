"""Load cases of a site: resumable runs, utilisation of parts and anchors, and a one-page report."""

from fitting.farm.cases.assess import assess
from fitting.farm.cases.case_store import CasesStopped
from fitting.farm.cases.page import write_page
from fitting.farm.cases.run import run_cases

__all__ = ["CasesStopped", "assess", "run_cases", "write_page"]
