"""The Unitree Go2 over DDS: messages, network, mode switch, link, driver, and a simulated one."""
