"""Flight performance of one vehicle (generates docs/results/validation.md), and the benchmark of its step."""
