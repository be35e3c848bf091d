"""Roll-outs: an FMU simulated over samples at candidate parameters, in processes of its own."""
