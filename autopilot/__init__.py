"""One UAV: estimator, control, modes, MAVLink services, and the on-board application beside them."""
