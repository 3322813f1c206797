"""What the vehicle knows of its own motion: an error-state Kalman filter in the manner of PX4's EKF2.

``estimator.Estimator`` is the door; ``rotation`` and ``atmosphere`` stand alone and serve others too.
"""
