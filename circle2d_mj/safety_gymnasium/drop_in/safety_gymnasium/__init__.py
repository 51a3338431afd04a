"""`import safety_gymnasium` imports `circle2d_mj.safety_gymnasium`."""

from circle2d_mj.safety_gymnasium.naming import take_the_name

take_the_name()
