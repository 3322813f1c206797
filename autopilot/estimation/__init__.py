"""State estimation: an error-state Kalman filter after PX4's EKF2.

The entry point is ``estimator.Estimator``. ``atmosphere`` is independent and is also used by other packages.
"""
