"""Geometry of the feet that sensors and tasks share."""

from __future__ import annotations

SOLE_DEPTH = 0.009
"""The sole's lowest point below the foot site, m. The rigid foot's contact spheres reach 0.034 below the ankle's roll
axis, the site 0.025."""

STANCE = ((-0.0707, 0.1075), (-0.0707, -0.1075))
"""Where the foot sites (left, right) are when STAND has come to rest on the ground: forward and left of the pelvis, in
the heading frame, m. The motors give a little, and the robot leans forward by 3 degrees."""
