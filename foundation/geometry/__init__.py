"""Rotations and geodesy: pure functions on numbers, some of them compiled.

Import `rotations` for quaternions and `geodesy` for positions on the Earth. Frames of PyBullet are left to
`harness.world.physics`.
"""
