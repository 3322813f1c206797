"""Flight performance of one vehicle (generates docs/validation.md), and the benchmark of its step."""
