"""The terminal: options, signals, streams, progress and exit codes of the command line."""
