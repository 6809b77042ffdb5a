"""What the robot is: joints, orders, limits, gains, ankle linkage, symmetry and what a policy sees."""
