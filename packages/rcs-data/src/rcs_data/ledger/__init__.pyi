from rcs_data.ledger.comparison import Pairs as Pairs
from rcs_data.ledger.comparison import holm as holm
from rcs_data.ledger.comparison import mean_maximum_rank_violation as mean_maximum_rank_violation
from rcs_data.ledger.comparison import pearson as pearson
from rcs_data.ledger.condition import Condition as Condition
from rcs_data.ledger.ledger import Ledger as Ledger
from rcs_data.ledger.page import write_ledger_page as write_ledger_page
from rcs_data.ledger.row import Row as Row
