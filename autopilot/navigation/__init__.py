"""Navigation: setpoints of each flight mode, missions and plans.

Import `setpoints.Navigator`; `mission`, `return_home`, `orbit`, `manual` and `landing` are modes, `plan_*`
the plans of ground stations. Following setpoints is left to `autopilot.control`.
"""
