"""Pure traffic: the road (axis, lanes), the queue at one instant, its state over time."""
