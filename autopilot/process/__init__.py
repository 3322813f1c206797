"""Processes of one UAV: the prefork server, the companion beside a PX4, the warm-up of compiled kernels.

``python -m autopilot`` is `autopilot.__main__`. The vehicle's step is in `autopilot.vehicle`.
"""
