"""The run: scenario, physics, sensors, lockstep, supervision, recording and analysis."""
