"""Rotations and geodesy: pure functions, some of them compiled.

Import `rotations` for quaternions and `geodesy` for positions on the Earth. PyBullet's frames are handled in
`harness.world.physics`.
"""
