"""Simulated sensors of the vehicles: noise, biases, rates and delays. No I/O.

Import `suite.SensorSuite`, and `config` for the profiles. Sensor messages are encoded in
`harness.simulator.hil`.
"""
