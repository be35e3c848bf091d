"""Running FMUs: slave, host process and child, and the channel between them; supervision/ guards the processes."""
