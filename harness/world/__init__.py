"""The physical world: rigid bodies in PyBullet, sensors, wind, motor controllers, injected faults.

Import `physics.world`, `sensors.suite`, `wind` or `faults`. No sockets. `harness.simulator` steps them.
"""
