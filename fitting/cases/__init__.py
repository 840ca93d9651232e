"""Load cases of a site: runs kept one by one and resumed, utilisation of parts and anchors, a report of one page."""

from fitting.cases.assess import assess
from fitting.cases.page import write_page
from fitting.cases.run import CasesStopped, run_cases

__all__ = ["CasesStopped", "assess", "run_cases", "write_page"]
