"""A robot of metal: a process of its own sends its commands, and brakes without new ones."""
