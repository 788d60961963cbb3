from rcs.calibration.board import Board as Board
from rcs.calibration.detection import Detections as Detections
from rcs.calibration.detection import detect as detect
from rcs.calibration.hand_eye import HandEye as HandEye
from rcs.calibration.hand_eye import hand_eye as hand_eye
from rcs.calibration.rig import Rig as Rig
from rcs.calibration.rig import View as View
