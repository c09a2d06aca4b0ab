"""Joint orders of other projects."""

import numpy as np

LEFT_FIRST = np.array((3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8))
"""Index in `renet.interface.JOINTS` of each joint of legs FL, FR, RL, RR, the order of Isaac Gym
and of MuJoCo Menagerie's Go2. The permutation is its own inverse."""
