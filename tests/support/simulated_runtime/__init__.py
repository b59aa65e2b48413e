"""The runtime in one process under one seed: both processes, the line, the host, clocks and disk, in simulated time."""
