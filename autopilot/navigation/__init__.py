"""Where the vehicle is on the globe, and where each mode takes it."""
