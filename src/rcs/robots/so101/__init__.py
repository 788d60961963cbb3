"""The SO101 follower arm, without its gripper."""
