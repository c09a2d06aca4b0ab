"""One module for each robot that the tasks are registered for."""
