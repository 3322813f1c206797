"""The physical world: rigid bodies in PyBullet, sensors, wind, motor controllers, injected faults.

Import `physics.world`, `sensors.suite`, `wind`, `faults`, and `user_models` for code of users. No sockets.
`harness.simulator` steps them.
"""
