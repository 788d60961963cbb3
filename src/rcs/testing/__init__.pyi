from rcs.testing.arm_contract import ArmContract as ArmContract
from rcs.testing.camera_contract import CameraContract as CameraContract
from rcs.testing.description_contract import DescriptionContract as DescriptionContract
from rcs.testing.env_contract import EnvContract as EnvContract
from rcs.testing.gripper_contract import GripperContract as GripperContract
from rcs.testing.hand_contract import HandContract as HandContract
from rcs.testing.tactile_contract import TactileContract as TactileContract
