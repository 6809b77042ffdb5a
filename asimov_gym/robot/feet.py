"""Geometry of the feet that sensors and tasks share."""

from __future__ import annotations

SOLE_DEPTH = 0.009
"""The sole's lowest point below the foot site, m. The rigid foot's contact spheres reach 0.034 below the ankle's roll
axis, the site 0.025."""
