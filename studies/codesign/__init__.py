"""Studies of ranging and localisation together: how near the estimate comes to what is possible."""
