"""How right the antenna's solvers are, measured: against closed forms, NEC2 twice, and reference numbers."""
