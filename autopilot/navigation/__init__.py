"""Navigation: setpoints of each flight mode, missions and plans, and geodetic positions."""
