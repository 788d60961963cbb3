from rcs.data.check.dataset import check as check
from rcs.data.check.report import CheckReport as CheckReport
from rcs.data.check.report import Finding as Finding
from rcs.data.check.report import Severity as Severity
