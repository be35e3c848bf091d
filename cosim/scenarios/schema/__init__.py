"""Tables of a scenario file, each validated when built."""
