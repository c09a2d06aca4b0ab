"""The Unitree Go2 over DDS: messages, mode switch, link, driver, and a simulated one."""
