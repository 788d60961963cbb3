from rcs_data.check.dataset import check as check
from rcs_data.check.report import CheckReport as CheckReport
from rcs_data.check.report import Finding as Finding
from rcs_data.check.report import Severity as Severity
