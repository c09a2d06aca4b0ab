"""DDS of a Go2 and of ROS 2: message types, network, and what both need of this computer."""
