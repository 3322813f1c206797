"""What the vehicle is allowed to do: arming, modes, failsafes, and whether it stands on the ground."""
