from rcs_data.convert.lerobot import export_lerobot as export_lerobot
from rcs_data.convert.lerobot_import import import_lerobot as import_lerobot
from rcs_data.convert.options import ExportOptions as ExportOptions
from rcs_data.convert.options import ExportReport as ExportReport
from rcs_data.convert.options import ImportOptions as ImportOptions
from rcs_data.convert.rlds import export_rlds as export_rlds
from rcs_data.convert.robomimic import export_robomimic as export_robomimic
from rcs_data.convert.robomimic_import import import_robomimic as import_robomimic
